"""`mpc_solver=riccati`: the structured solver of `zoac.mpc.riccati` (`docs/solver.md`)."""

from functools import lru_cache
from typing import ClassVar

import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.problem import LinearisedProblem, Solution, Sparsity
from zoac.mpc.riccati import Pattern, pattern, solve_about


@lru_cache(maxsize=32)
def _pattern(sparsity: Sparsity) -> Pattern:
    return pattern(np.hstack([sparsity.a, sparsity.b]))


class Riccati:
    """Solve box-constrained linear-quadratic problems of any size by Riccati recursions.

    Cost grows linearly with the horizon and cubically with states and inputs. An environment's plan
    depends on that environment's data alone, to the bit. The first solve with new numbers of states
    and inputs, or a new pattern of zeros, compiles for up to half a minute; the result is kept
    on disk.
    """

    screens: ClassVar[bool] = True
    bounds_states: ClassVar[bool] = False

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        """Solve the n problems; see `zoac.mpc.riccati.solve_about` for what is promised.

        Args:
            problem: What to solve. Input bounds may be infinite, or equal to pin an input.
            robust: Leave out the sweeps: interior point and active set at once.

        Raises:
            ConfigError: If a bound is NaN or the lower bound of an input exceeds the upper.
        """
        try:
            found = solve_about(
                *(*problem.data, *problem.box),
                nonzero=None if problem.sparsity is None else _pattern(problem.sparsity),
                robust=robust,
            )
        except ValueError as error:
            raise ConfigError(str(error)) from None
        return Solution(*found)
