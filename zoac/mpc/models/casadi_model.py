"""A model whose Jacobians CasADi derives."""

import warnings
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.models.dynamics import Dynamics
from zoac.mpc.problem import Sparsity


class CasadiModel(Dynamics):
    """A model from a function of (x, u, p), with exact Jacobians and their zeros, by CasADi.

        def derivative(x, u, p):
            return x.rate, -p.gravity * np.sin(x.angle) + u.torque

        model = CasadiModel(["angle", "rate"], ["torque"], {"gravity": 9.81},
                            derivative=derivative, sample_time=0.05)

    The function may use arithmetic, NumPy's functions of one number, and CasADi's. It is called
    with CasADi's symbols, once: no `if` on their values. Needs `pip install zoac[casadi]`.
    """

    def __init__(self, states: Any, inputs: Any, parameters: Any = None, **options: Any) -> None:
        """
        Args:
            states: Names.
            inputs: Names.
            parameters: Values by name.
            options: `step` or `derivative`, `sample_time`, `substeps`: see
                `zoac.mpc.models.dynamics.Dynamics`.

        Raises:
            ConfigError: If a part of it cannot be used, or CasADi is not installed.
        """
        super().__init__(states, inputs, parameters, **options)
        try:
            import casadi
        except ImportError as error:
            raise ConfigError(
                f"CasadiModel needs CasADi ({error}): pip install 'zoac[casadi]', or use "
                "zoac.mpc.FunctionModel"
            ) from None
        symbols = [
            [casadi.SX.sym(name) for name in names]
            for names in (self.states, self.inputs, self.parameters)
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # CasADi's, of its NumPy support
            try:
                after = casadi.vertcat(*self.advance()(*map(_column, symbols)))
            except Exception as error:  # whatever a user's function raises
                self.check()
                raise ConfigError(
                    f"model: with CasADi's symbols the function raised {type(error).__name__}: "
                    f"{error}; use arithmetic and functions of NumPy or CasADi, no `if` on values, "
                    "or zoac.mpc.FunctionModel"
                ) from error
        x, u, p = (casadi.vertcat(*column) for column in symbols)
        if after.shape != x.shape:
            self.check()
        a, b = casadi.jacobian(after, x), casadi.jacobian(after, u)
        self.sparsity = Sparsity(*(np.array(casadi.DM(j.sparsity(), 1)) != 0 for j in (a, b)))
        # Transposed, for CasADi stores columns and NumPy rows.
        outputs = [after, casadi.densify(a.T), casadi.densify(b.T)]
        self.function = casadi.Function("step", [x, u, p], outputs)
        """The next state and both transposed Jacobians, of (x, u, p)."""
        self._rollouts: dict[int, _Rollout] = {}

    def linearise(
        self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `zoac.mpc.sqp.PredictiveModel`; theta (n, np) in the order of `parameters`."""
        n, horizon, nu = inputs.shape
        nx = start.shape[1]
        if horizon not in self._rollouts:
            self._rollouts[horizon] = _Rollout(self.function, horizon)
        rollout = self._rollouts[horizon]
        states = np.empty((n, horizon + 1, nx))
        a, b = np.empty((n, horizon, nx, nx)), np.empty((n, horizon, nx, nu))
        states[:, 0] = start
        for env_index in range(n):
            rollout(start[env_index], inputs[env_index], theta[env_index])
            states[env_index, 1:], a[env_index], b[env_index] = rollout.results
        return states, a, b

    def predict(self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return F_theta(states (n, nx), inputs (n, nu)) (n, nx)."""
        return self.linearise(theta, states, inputs[:, None])[0][:, 1]


def _column(symbols: list[Any]) -> np.ndarray:
    column = np.empty(len(symbols), dtype=object)
    column[:] = symbols
    return column


class _Rollout:
    """A model's function over a horizon, called through CasADi's buffers, without conversions."""

    def __init__(self, function: Any, horizon: int) -> None:
        nx, nu, count = (function.size1_in(i) for i in range(3))
        whole = function.mapaccum(horizon) if horizon > 1 else function
        self._start, self._inputs = np.empty(nx), np.empty((horizon, nu))
        self._theta = np.empty((horizon, count))
        self.results = (
            np.empty((horizon, nx)), np.empty((horizon, nx, nx)), np.empty((horizon, nx, nu)),
        )  # fmt: skip
        self._buffer, self._evaluate = whole.buffer()
        for i, array in enumerate((self._start, self._inputs, self._theta)):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]

    def __call__(self, start: np.ndarray, inputs: np.ndarray, theta: np.ndarray) -> None:
        """Write states x_1 .. x_N and both Jacobians into `results`."""
        self._start[:], self._inputs[:], self._theta[:] = start, inputs, theta
        self._evaluate()
