"""`zoac.mpc.Mpc` minimises the cost of its documentation, written once more by cvxpy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from zoac.mpc import CasadiModel, Mpc

A, B = np.array([[1.0, 0.1], [0.02, 1.0]]), np.array([0.005, 0.1])
HORIZON = 5


def step(x, u, p):
    """A mass on a weak spring, pushed for 0.1 s."""
    return x.a + 0.1 * x.b + 0.005 * u.t, 0.02 * x.a + x.b + 0.1 * u.t


def mpc(**options) -> Mpc:
    return Mpc(
        CasadiModel(["a", "b"], ["t"], step=step), HORIZON, **{"linearisations": 1} | options
    )


def first_input(controller: Mpc, start, params=None) -> float:
    params = {name: np.array([value]) for name, value in (params or {}).items()}
    return controller.act(params, np.array([start]), controller.init(1))[0][0, 0]


def by_cvxpy(start, states, weight, *, low=-1e3, high=1e3, reference=0.0) -> float:
    """Return the first input for the weight `states` (2, 2), of the last state too."""
    inputs, x, cost = cp.Variable(HORIZON), np.array(start), 0.0
    for k in range(HORIZON):
        cost += cp.quad_form(x, states) + weight * (inputs[k] - reference) ** 2
        x = A @ x + B * inputs[k]
    cost += cp.quad_form(x, states)
    cp.Problem(cp.Minimize(cost), [inputs >= low, inputs <= high]).solve(solver="CLARABEL")
    return inputs.value[0]


@pytest.mark.parametrize("solver", ["clarabel", "cvxpy"])
def test_the_last_state_has_the_weights_by_pair_too(solver) -> None:
    start, weights = [1.0, -0.3], {"a": 10.0, "b": 1.0, ("a", "b"): 2.0, "t": 0.01}
    wanted = by_cvxpy(start, np.array([[10.0, 2.0], [2.0, 1.0]]), 0.01)
    assert abs(first_input(mpc(weights=weights, solver=solver), start) - wanted) < 1e-4


@pytest.mark.parametrize(
    ("bounds", "options", "tuned", "reference", "start"),
    [
        ((0.5, 3.0), {}, {"high_t": 3.0}, 0.0, [-0.6, 0.05]),
        ((0.5, 3.0), {"weights": {("a", "t"): 1e-9}}, {}, 0.0, [-0.6, 0.05]),
        ((-5.0, 1.0), {"reference": {"t": 3.0}}, {}, 3.0, [0.15, 0.0]),
    ],
    ids=["tuned bound", "cross weight", "reference"],
)
def test_an_input_is_weighed_from_its_reference_outside_its_bounds(
    bounds, options, tuned, reference, start
) -> None:
    low, high = bounds
    wanted = by_cvxpy(start, np.diag([10.0, 1.0]), 1.0, low=low, high=high, reference=reference)
    weights = {"a": 10.0, "b": 1.0, "t": 1.0} | options.get("weights", {})
    built = mpc(**{**options, "weights": weights}, bounds={"t": bounds})
    assert abs(first_input(built, start, tuned) - wanted) < 1e-4
