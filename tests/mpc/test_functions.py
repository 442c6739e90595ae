"""A user's functions in an MPC: they change nothing of the engine's, and fail when it is built."""

from __future__ import annotations

import numpy as np
import pytest

from zoac.core.errors import ConfigError
from zoac.mpc import FunctionModel, Mpc

NAMES = ["a", "b"], ["t"]


def step(x, u, p):
    return x.a + 0.1 * x.b, x.b + 0.1 * u.t


def changes_in_place(x, u, p):
    rate = x.b
    rate -= 0.1
    return rate, u.t + x.b


def branches(x, u, p):
    return x.a if x.b > 0.0 else x.b, u.t


@pytest.mark.parametrize("function", [changes_in_place, branches])
@pytest.mark.parametrize("jacobians", ["complex", "finite"])
def test_what_a_plain_function_must_not_do_is_named(function, jacobians) -> None:
    with pytest.raises(ConfigError, match=r"no `if` on values and no change in place"):
        FunctionModel(*NAMES, step=function, jacobians=jacobians)


@pytest.mark.parametrize(
    "of",
    [
        lambda a: np.arctan2(a, 1.0),
        lambda a: np.hypot(a, 1.0),
        lambda a: a % 1.0,
        np.floor,
        np.cbrt,
        lambda a: np.interp(a, [0.0, 2.0], [0.0, 2.0]),
    ],
    ids=["arctan2", "hypot", "%", "floor", "cbrt", "interp"],
)
def test_functions_that_take_no_complex_numbers_need_finite_differences(of) -> None:
    def other(x, u, p):
        return x.b, u.t + of(x.a)

    with pytest.raises(ConfigError, match="with complex numbers .* give jacobians='finite'"):
        FunctionModel(*NAMES, step=other)
    model = FunctionModel(*NAMES, step=other, jacobians="finite")
    found = model.predict(np.empty((1, 0)), np.array([[1.5, 2.0]]), np.array([[3.0]]))
    np.testing.assert_array_equal(found, [[2.0, 3.0 + of(1.5)]])


@pytest.mark.parametrize("option", ["state", "reference"])
def test_functions_of_the_observation_get_their_own(option) -> None:
    def doubles(obs):
        obs *= 2.0
        return obs if option == "state" else obs[:, None]

    weights, obs = {"a": 1.0, "t": 0.1}, np.array([[0.5, -0.2]])
    mpc = Mpc(FunctionModel(*NAMES, step=step), 5, weights=weights, **{option: doubles})
    mpc.act({}, obs, mpc.init(1))
    np.testing.assert_array_equal(obs, [[0.5, -0.2]])
