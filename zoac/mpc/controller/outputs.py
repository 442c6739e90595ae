"""A model with outputs: all that an MPC weighs or bounds beside states and inputs is a state.

The structured form of `LinearisedProblem` has diagonal weights, on states and inputs. Anything else
that is linear in them becomes a further state with a weight and bounds of its own:

    before_{k+1} = u_k                        inputs of the step before
    rate_{k+1}   = u_k - before_k             weight and bound on changes of an input
    copy_{k+1}   = u_k                        an input with a reference, or whose bounds are tuned
    stage_{k+1}  = V_s' (x_k, u_k)            a full weight on (x, u): V_s its eigenvectors, the
                                              eigenvalues are the weights
    end_{k+1}    = V_t' x_{k+1}               likewise a full terminal weight

So cross terms, rates and terminal matrices reach every solver in the same way.
"""

from typing import Any

import numpy as np

from zoac.mpc.problem import Sparsity


class ModelWithOutputs:
    """A predictive model whose state is (x, before, rate, copy, stage, end).

    Its parameters theta are those of the model, then V_s and V_t, row by row, where there are such.
    """

    def __init__(
        self,
        model: Any,
        box: tuple[np.ndarray, np.ndarray],
        rates: list[int],
        copies: list[int],
        stage: bool,
        end: bool,
    ) -> None:
        """
        Args:
            model: The model proper, as `zoac.mpc.Mpc` takes it.
            box: Lower and upper bounds of the inputs, (nu,) each.
            rates: Positions of the inputs whose rates are outputs.
            copies: Of those that are outputs themselves.
            stage: Whether there is a full weight on (x, u).
            end: Whether there is a full terminal weight.
        """
        self._model = model
        self._nx, self._nu = len(model.states), len(model.inputs)
        self._count = len(model.parameters)
        self.input_low, self.input_high = box
        self.rates, self.copies = rates, copies
        widths = (
            self._nx,
            len(self.rates),
            len(self.rates),
            len(self.copies),
            (self._nx + self._nu) * stage,
            self._nx * end,
        )
        ends = np.cumsum(widths).tolist()
        parts = map(slice, [0, *ends], ends)
        self.states, self.before, self.rate, self.copy, self.stage, self.end = parts
        self.size = ends[-1]
        """Number of states, outputs included."""
        self.sparsity = self._sparsity()

    def _sparsity(self) -> Sparsity | None:
        inner = self._model.sparsity
        if inner is None and self.size == self._nx:
            return None
        a, b = np.zeros((self.size, self.size), bool), np.zeros((self.size, self._nu), bool)
        a[self.states, self.states] = True if inner is None else inner.a
        b[self.states] = True if inner is None else inner.b
        self._write_inputs(a, b)
        for full in (self.stage, self.end):
            a[full, self.states] = b[full] = True
        return Sparsity(a, b)

    def _write_inputs(self, a: np.ndarray, b: np.ndarray) -> None:
        """Write the constant entries of Jacobians (..., nz, nz) and (..., nz, nu)."""
        for which, part in (
            (self.rates, self.before),
            (self.rates, self.rate),
            (self.copies, self.copy),
        ):
            for row, j in zip(range(part.start, part.stop), which, strict=True):
                b[..., row, j] = 1.0
        for i in range(len(self.rates)):
            a[..., self.rate.start + i, self.before.start + i] = -1.0

    def linearise(
        self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `zoac.mpc.sqp.PredictiveModel`; `start` (n, nz), of which outputs are not read."""
        nx, nu = self._nx, self._nu
        if self.size == nx:
            return self._model.linearise(theta, start, inputs)
        own, after = theta[:, : self._count], theta[:, self._count :]
        inner, a_inner, b_inner = self._model.linearise(own, start[:, :nx].copy(), inputs)
        n, horizon, _ = inputs.shape
        states = np.zeros((n, horizon + 1, self.size))
        a, b = np.zeros((n, horizon, self.size, self.size)), np.zeros((n, horizon, self.size, nu))
        states[:, :, self.states], states[:, 0, self.before] = inner, start[:, self.before]
        a[:, :, self.states, self.states], b[:, :, self.states] = a_inner, b_inner
        self._write_inputs(a, b)
        states[:, 1:, self.before] = inputs[:, :, self.rates]
        states[:, 1:, self.rate] = inputs[:, :, self.rates] - states[:, :-1, self.before]
        states[:, 1:, self.copy] = inputs[:, :, self.copies]
        if self.stage.stop > self.stage.start:
            rows = after[:, : (nx + nu) ** 2].reshape(n, 1, nx + nu, nx + nu)
            after = after[:, (nx + nu) ** 2 :]
            point = np.concatenate([inner[:, :-1], inputs], axis=2)
            states[:, 1:, self.stage] = np.matmul(rows, point[..., None])[..., 0]
            a[:, :, self.stage, self.states] = rows[..., :nx]
            b[:, :, self.stage] = rows[..., nx:]
        if self.end.stop > self.end.start:
            rows = after.reshape(n, 1, nx, nx)
            states[:, 1:, self.end] = np.matmul(rows, inner[:, 1:, :, None])[..., 0]
            a[:, :, self.end, self.states] = np.matmul(rows, a_inner)
            b[:, :, self.end] = np.matmul(rows, b_inner)
        return states, a, b
