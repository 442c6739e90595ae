"""A solve of n linearised problems, and a second, robust one where the first fails."""

import logging
import time

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem, Solution, Solver, Status

# As plain numbers: comparing an array with a member of an enum takes five times as long.
_SOLVED, _NOT_FINITE = int(Status.SOLVED), int(Status.NOT_FINITE)

_log = logging.getLogger(__name__)


class Attempt:
    """One solve of n problems; what failed is solved once more, carefully.

    Problems that are not finite never reach a solver that does not screen them itself.
    """

    def __init__(self, solver: Solver, problem: LinearisedProblem) -> None:
        self._solver = solver
        self._problem = problem
        self.seconds = 0.0
        finite = None if solver.screens else _finite(*(a.reshape(len(a), -1) for a in problem.data))
        if finite is None or finite.all():
            answer = self._timed(problem)
            self.inputs, self.status = answer.inputs, answer.status
        else:
            self.inputs = np.zeros_like(problem.inputs)
            self.status = np.full(len(finite), _NOT_FINITE, dtype=np.int8)
            self._solve_some(finite, robust=False)
        self.troubled = np.count_nonzero(self.status) > 0  # SOLVED is zero
        if self.troubled:
            self.retried = (self.status != _SOLVED) & (self.status != _NOT_FINITE)
            self._solve_some(self.retried, robust=True)
            for env_index in np.flatnonzero(self.status):
                sentence = Status(self.status[env_index]).sentence
                _log.info("row %d of %d: %s", env_index, len(self.status), sentence)

    def _solve_some(self, mask: np.ndarray, robust: bool) -> None:
        if mask.any():
            answer = self._timed(self._problem.take(mask), robust)
            self.inputs, self.status = self.inputs.copy(), self.status.copy()
            self.inputs[mask] = answer.inputs
            self.status[mask] = answer.status

    def _timed(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        began = time.perf_counter()
        answer = self._solver.solve(problem, robust)
        self.seconds += time.perf_counter() - began
        return answer


@compiled()
def _finite(*arrays: np.ndarray) -> np.ndarray:
    """Return for each row (n,) of all `arrays` (n, ...) whether its numbers are finite."""
    finite = np.ones(len(arrays[0]), dtype=np.bool_)
    for env_index in range(len(finite)):
        for array in arrays:
            bad = 0
            for i in range(array.shape[1]):
                bad += not np.isfinite(array[env_index, i])
            finite[env_index] &= bad == 0
    return finite
