"""A solve of n linearised problems, and a second, robust one where the first fails."""

import logging
import time

import numpy as np

from zoac.core.types import all_finite
from zoac.mpc.problem import LinearisedProblem, Solver, Status

# As plain numbers: comparing an array with a member of an enum takes five times as long.
_SOLVED, _NOT_FINITE = int(Status.SOLVED), int(Status.NOT_FINITE)

_log = logging.getLogger(__name__)


class Attempt:
    """One solve of n problems; what failed is solved once more, carefully.

    Problems that are not finite never reach a solver that does not screen them itself.
    """

    def __init__(self, solver: Solver, problem: LinearisedProblem) -> None:
        began, n = time.perf_counter(), len(problem.inputs)
        if solver.screens or all(map(all_finite, problem.data)):
            answer = solver.solve(problem)
            self.inputs, self.status = answer.inputs, answer.status
        else:
            finite = [np.isfinite(array.reshape(n, -1)).all(axis=1) for array in problem.data]
            self.inputs = np.zeros_like(problem.inputs)
            self.status = np.full(n, _NOT_FINITE, dtype=np.int8)
            self._solve_some(solver, problem, np.all(finite, axis=0), robust=False)
        self.troubled = np.count_nonzero(self.status) > 0  # SOLVED is zero
        if self.troubled:
            self.retried = (self.status != _SOLVED) & (self.status != _NOT_FINITE)
            self._solve_some(solver, problem, self.retried, robust=True)
            for env_index in np.flatnonzero(self.status):
                sentence = Status(self.status[env_index]).sentence
                _log.info("row %d of %d: %s", env_index, n, sentence)
        self.seconds = time.perf_counter() - began

    def _solve_some(
        self, solver: Solver, problem: LinearisedProblem, mask: np.ndarray, robust: bool
    ) -> None:
        if mask.any():
            answer = solver.solve(problem.take(mask), robust)
            self.inputs, self.status = self.inputs.copy(), self.status.copy()
            self.inputs[mask], self.status[mask] = answer.inputs, answer.status
