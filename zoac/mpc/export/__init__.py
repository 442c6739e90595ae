"""An MPC as C: one file without dependencies, whose functions CasADi generates."""
