"""Models from functions: alike whatever derives their Jacobians, and told apart from wrong ones."""

from __future__ import annotations

import pickle

import cloudpickle
import numba
import numpy as np
import pytest

from tests.mpc.systems import cart_pole_derivative
from zoac.config.fingerprint import described
from zoac.core.errors import ConfigError
from zoac.mpc import CasadiModel, FunctionModel

NAMES = {
    "states": ["position", "speed", "angle", "rate"],
    "inputs": ["force"],
    "parameters": {"cart": 1.0, "pole": 0.1, "half": 0.5},
}
CART_POLE = {**NAMES, "derivative": cart_pole_derivative, "sample_time": 0.02, "substeps": 2}
MODELS = {
    "casadi": CasadiModel(**CART_POLE),
    "complex": FunctionModel(**CART_POLE),
    "finite": FunctionModel(**CART_POLE, jacobians="finite"),
    "numba": FunctionModel(**CART_POLE | {"derivative": numba.njit(cart_pole_derivative)}),
}


def along(n: int = 3, horizon: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    theta = np.array([1.0, 0.1, 0.5]) * rng.uniform(0.8, 1.2, (n, 3))
    return theta, 0.3 * rng.normal(size=(n, 4)), rng.normal(size=(n, horizon, 1))


def by_hand(theta, start, inputs):
    """Roll one environment out by the same integrator, written anew, and difference it."""

    def rate(x, u):
        (cart, pole, half), (_, speed, angle, turn) = theta, x
        total, sin, cos = cart + pole, np.sin(angle), np.cos(angle)
        push = (u + pole * half * turn**2 * sin) / total
        second = (9.8 * sin - cos * push) / (half * (4 / 3 - pole * cos**2 / total))
        return np.array([speed, push - pole * half * second * cos / total, turn, second])

    def step(x, u, h=0.01):
        for _ in range(2):
            a = rate(x, u)
            b = rate(x + h / 2 * a, u)
            c = rate(x + h / 2 * b, u)
            d = rate(x + h * c, u)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
        return x

    states, jacobians, small = [start], [], 1e-5
    for (u,) in inputs:
        x = states[-1]
        columns = [(step(x + e, u) - step(x - e, u)) / (2 * small) for e in small * np.eye(4)]
        columns.append((step(x, u + small) - step(x, u - small)) / (2 * small))
        jacobians.append(np.array(columns).T)
        states.append(step(x, u))
    return np.array(states), np.array(jacobians)


@pytest.mark.parametrize("name", MODELS)
def test_rollout_and_jacobians_are_those_of_the_function(name) -> None:
    model, (theta, start, inputs) = MODELS[name], along()
    states, a, b = model.linearise(theta, start, inputs)
    for i in range(len(start)):
        expected, jacobians = by_hand(theta[i], start[i], inputs[i])
        np.testing.assert_allclose(states[i], expected, rtol=1e-12)
        np.testing.assert_allclose(a[i], jacobians[:, :, :4], atol=1e-8)
        np.testing.assert_allclose(b[i], jacobians[:, :, 4:], atol=1e-8)
    np.testing.assert_array_equal(model.predict(theta, start, inputs[:, 0]), states[:, 1])


@pytest.mark.parametrize("name", MODELS)
def test_an_environment_has_its_own_bits(name) -> None:
    model, (theta, start, inputs) = MODELS[name], along()
    together = model.linearise(theta, start, inputs)
    for i in range(len(start)):
        row = slice(i, i + 1)
        alone = model.linearise(theta[row], start[row], inputs[row])
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], all_of_them[i])


@pytest.mark.parametrize(
    "model",
    [
        MODELS["casadi"],
        MODELS["complex"],
        # By finite differences, as numba would take longer to compile a complex step.
        FunctionModel(
            ["a"], ["u"], {"c": 2.0}, jacobians="finite",
            step=numba.njit(lambda x, u, p: (x.a + p.c * u.u,)),
        ),
    ],
    ids=["casadi", "numpy", "numba"],
)  # fmt: skip
def test_a_copy_is_the_same_model(model) -> None:
    rng, nx, count = np.random.default_rng(0), len(model.states), len(model.parameters)
    arguments = rng.uniform(0.1, 1.0, (2, count)), rng.normal(size=(2, nx)), np.ones((2, 3, 1))
    copy = pickle.loads(cloudpickle.dumps(model))
    for one, other in zip(model.linearise(*arguments), copy.linearise(*arguments), strict=True):
        np.testing.assert_array_equal(one, other)
    assert described(copy) == described(model)


def test_another_function_is_another_model() -> None:
    def other(x, u, p):
        return x.speed, u.force, x.rate, 0.0

    model = FunctionModel(**{**CART_POLE, "derivative": other})
    assert described(model) != described(MODELS["complex"])


def test_casadi_knows_the_zeros() -> None:
    a, b = MODELS["casadi"].sparsity.a, MODELS["casadi"].sparsity.b
    np.testing.assert_array_equal(a, [[1, 1, 1, 1], [0, 1, 1, 1], [0, 0, 1, 1], [0, 0, 1, 1]])
    assert b.all()


def step(x, u, p):
    return 0.5 * x.a * u.u, x.b + p.c * u.u


def derivatives(x, u, p):
    return [[0.5 * u.u, 0.0], [0.0, 1.0]], [[0.5 * x.a], [p.c]]


def test_given_jacobians_are_used_and_checked() -> None:
    names = {"states": ["a", "b"], "inputs": ["u"], "parameters": {"c": 2.0}, "step": step}
    point = np.full((1, 1), 3.0), np.array([[2.0, 1.0]]), np.full((1, 2, 1), 4.0)
    _, a, b = FunctionModel(**names, jacobians=derivatives).linearise(*point)
    np.testing.assert_array_equal(a[0, 0], [[2.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(b[0, :, :, 0], [[1.0, 3.0], [4 * 0.5, 3.0]])
    wrong = FunctionModel(
        **names, jacobians=lambda x, u, p: ([[0.5 * u.u, 0.0], [0.0, 2.0]], [[0.5 * x.a], [p.c]])
    )
    with pytest.raises(ConfigError, match=r"the Jacobian of b in b is 2, by finite differences 1;"):
        wrong.linearise(*point)


def test_a_complex_step_through_abs_is_noticed() -> None:
    model = FunctionModel(["a"], ["u"], step=lambda x, u, p: (np.abs(x.a) + u.u,))
    with pytest.raises(ConfigError, match=r"of a in a is 0, by finite differences -1;.*'finite'"):
        model.linearise(np.empty((1, 0)), np.array([[-1.0]]), np.zeros((1, 1, 1)))


def car(x, u, p):
    """A car of 1,500 kg; the force is in N, so that its entry is small."""
    return x.x + 0.05 * x.v, x.v + 0.05 * u.f / 1500.0


@pytest.mark.parametrize(
    ("start", "speed", "force"),
    [([0.0, 10.0], 1.0, -0.05 / 1500.0), ([5000.0, 10.0], 0.5, 0.05 / 1500.0)],
    ids=["small entry", "large state"],
)
def test_a_wrong_entry_is_told_whatever_its_units(start, speed, force) -> None:
    jacobians = lambda x, u, p: ([[1.0, 0.05], [0.0, speed]], [[0.0], [force]])  # noqa: E731
    model = FunctionModel(["x", "v"], ["f"], step=car, jacobians=jacobians)
    with pytest.raises(ConfigError, match=r"the Jacobian of v in [vf] is .*, by finite differ"):
        model.linearise(np.empty((1, 0)), np.array([start]), np.zeros((1, 3, 1)))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_right_jacobians_pass_in_any_units(scale) -> None:
    """Curved, nearly cancelling, and beside states of another size."""

    def mixed(x, u, p):
        a, b = x.a / scale, x.b * scale
        return scale * (np.sin(a) * np.cos(b) + u.u**3), ((1e6 + a) - 1e6 + a * b**2) / scale

    for seed in range(20):
        model = FunctionModel(["a", "b"], ["u"], step=mixed)
        rng = np.random.default_rng(seed)
        start = rng.normal(size=(1, 2)) * [scale, 1.0 / scale]
        model.linearise(np.empty((1, 0)), start, rng.normal(size=(1, 1, 1)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": ["a", "a"]}, "states, inputs, parameters: a comes twice"),
        ({"inputs": ["2u"]}, "inputs: '2u' is no name; write it as a variable of Python's"),
        ({"inputs": []}, "inputs: expected one name or more"),
        (
            {"derivative": step},
            "a model needs step=..., the next state, or derivative=..., not",
        ),
        ({"step": None, "derivative": step}, "sample_time=None: derivative needs seconds"),
        ({"parameters": {"c": "x"}}, "parameters['c']='x': expected a finite number"),
        ({"substeps": 0}, "substeps=0: expected a whole number from 1"),
        ({"step": lambda x, u, p: (x.a,)}, "returned 1 entries, expected one for each of a, b"),
        ({"step": lambda x, u, p: (x.d,)}, "x, u and p are tuples with the names a, b, u, c"),
    ],
)
@pytest.mark.parametrize("kind", [CasadiModel, FunctionModel])
def test_what_is_wrong_is_named(kind, changes, message) -> None:
    names = {"states": ["a", "b"], "inputs": ["u"], "parameters": {"c": 2.0}, "step": step}
    with pytest.raises(ConfigError) as caught:
        kind(**{**names, **changes})
    assert message in str(caught.value)


def test_jacobians_are_checked_for_their_name() -> None:
    with pytest.raises(ConfigError, match=r"jacobians='complx': did you mean 'complex'\?"):
        FunctionModel(["a"], ["u"], step=lambda x, u, p: (x.a,), jacobians="complx")


def test_branches_need_another_model_than_casadis() -> None:
    with pytest.raises(ConfigError, match=r"no `if` on values, or zoac\.mpc\.FunctionModel"):
        CasadiModel(["a"], ["u"], step=lambda x, u, p: (x.a if x.a > 0 else u.u,))
