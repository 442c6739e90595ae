"""A PID for a linear plant: `zoac.tune_pid`, and the command for a plant's file."""
