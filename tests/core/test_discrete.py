"""Whole numbers and choices: the map, and ZOAC's gradient against enumeration."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

import zoac
from tests.envs.test_adapters import Drift
from zoac.algorithm.gradient import zeroth_order_gradient
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter, ParameterSpace, choice, integer
from zoac.tasks.user_space import parse_space

SPACE = ParameterSpace(
    [Parameter("k", 0.0, 1.0), integer("n", 2, 5), choice("mode", ("a", "b", "c")),
     choice("f", (10, 50))]
)  # fmt: skip
SIGMA = 0.3


def test_coordinates_are_one_a_number_and_one_an_option():
    assert SPACE.dimension == 7
    assert SPACE.coordinates == ("k", "n", "mode=a", "mode=b", "mode=c", "f=10", "f=50")
    assert SPACE.names == ("k", "n", "mode", "f")


@settings(max_examples=50)
@given(st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7))
def test_values_come_back_through_the_point_that_stands_for_them(z):
    values = SPACE.values(np.array(z))
    again = SPACE.values(SPACE.normalise(SPACE.named(np.array(z))))
    np.testing.assert_allclose(again, values, atol=1e-12)


@settings(max_examples=50)
@given(st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7))
def test_points_that_share_their_values_are_rounded_to_one(z):
    z = np.array(z)
    rounded = SPACE.rounded(z)
    assert np.array_equal(SPACE.values(rounded), SPACE.values(z))
    assert rounded[0] == np.clip(z[0], -1, 1)
    other = np.random.default_rng(0).uniform(-1, 1, (2000, 7))
    other[:, 0] = rounded[0]
    same = (SPACE.values(other) == SPACE.values(z)).all(axis=1)
    assert same.any()
    assert np.array_equal(SPACE.rounded(other)[same], np.tile(rounded, (same.sum(), 1)))


def test_every_whole_number_has_an_equal_part_of_the_box():
    z = np.zeros((4000, 7))
    z[:, 1] = np.linspace(-1, 1, 4000)
    assert np.unique(SPACE.values(z)[:, 1], return_counts=True)[1].tolist() == [1000] * 4
    assert SPACE.values(np.full(7, 9.0))[1] == 5


def test_plain_values_have_their_own_types():
    named = SPACE.named(np.array([0.0, 0.0, -0.2, 0.3, 0.1, -1.0, 1.0]))
    assert named == {"k": 0.5, "n": 4, "mode": "b", "f": 50}
    assert [type(v) for v in named.values()] == [float, int, str, int]
    assert SPACE.denormalise(np.zeros((2, 7)))["mode"].tolist() == ["a", "a"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: choice("m", ["a"]), "two or more different"),
        (lambda: choice("m", ["a", "a"]), "two or more different"),
        (lambda: integer("n", 1.5, 3), "must be whole"),
        (lambda: Parameter("n", 1, 3, "log", kind="integer"), "no log scale"),
        (lambda: choice("m", "abc"), "expected a list of options, got 'abc'"),
        (lambda: choice("m", {"a", "b"}), "expected a list of options"),
        (lambda: choice("m", ["a", None]), "the option None is neither text nor a finite number"),
        (lambda: choice("m", [(1, 2), (3, 4)]), r"the option \(1, 2\) is neither"),
        (lambda: choice("m", [1.0, np.nan]), "the option nan is neither"),
        (
            lambda: SPACE.normalise({"k": 0.5, "n": 3.7, "mode": "a", "f": 10}),
            "'n': 3.7 is not a whole",
        ),
        (
            lambda: SPACE.normalise({"k": "a", "n": 3, "mode": "a", "f": 10}),
            "number from 0.0 to 1.0",
        ),
        (lambda: SPACE.normalise({"k": 0.5, "n": 3, "mode": "d", "f": 10}), "unknown option 'd'"),
        (lambda: SPACE.normalise({"k": 0.5, "n": 9, "mode": "a", "f": 10}), "9 lies outside"),
    ],
)
def test_what_makes_no_sense_is_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_options_come_back_from_json_as_they_were():
    for options in (("a", "b"), (1, 2.5), (True, False), tuple(np.array([3, 4]))):
        kept = choice("m", options).options
        assert json.loads(json.dumps(kept)) == list(kept) == list(options)


def test_how_a_dict_describes_them():
    space, _, start = parse_space(
        {"n": (1, 9, "integer"), "mode": {"choices": ["fast", "safe"], "baseline": "safe"}},
        {"n": 2},
    )
    assert [p.kind for p in space.parameters] == ["integer", "choice"]
    assert start == {"mode": "safe", "n": 2}


def estimate(space, cost, theta, n=40_000):
    """Return eq. (10) with costs for advantages, and its standard error, (d,) each."""
    rng = np.random.default_rng(0)
    epsilon = rng.standard_normal((n // 2, len(theta)))
    epsilon = np.concatenate([epsilon, -epsilon])
    costs = cost(space.values(theta + SIGMA * epsilon))
    terms = costs[:, None] * epsilon / SIGMA
    gradient = zeroth_order_gradient(costs, epsilon, SIGMA)
    return gradient, terms.std(axis=0) / np.sqrt(n)


def numerically(function, theta, step=1e-4):
    rows = step * np.eye(len(theta))
    return np.array([(function(theta + r) - function(theta - r)) / (2 * step) for r in rows])


def test_the_gradient_over_a_whole_number_is_that_of_the_enumerated_mean():
    space = ParameterSpace([integer("n", 0, 4)])
    costs = np.array([3.0, 1.0, 0.0, 5.0, 2.0])
    edges = np.array([-np.inf, -0.6, -0.2, 0.2, 0.6, np.inf])

    def mean(theta):
        return float(np.diff(norm.cdf((edges - theta[0]) / SIGMA)) @ costs)

    for theta in (np.array([-0.5]), np.array([0.1]), np.array([0.9])):
        gradient, error = estimate(space, lambda v: costs[v[:, 0].astype(int)], theta)
        assert np.all(np.abs(gradient - numerically(mean, theta)) < 4 * error)


def test_the_gradient_over_a_choice_is_that_of_the_enumerated_mean():
    space = ParameterSpace([choice("mode", ("a", "b", "c"))])
    costs = np.array([2.0, -1.0, 4.0])

    def chance(theta, k):
        """P(theta_k + sigma eps_k is the largest)."""
        others = np.delete(theta, k)
        return quad(
            lambda x: norm.pdf(x) * np.prod(norm.cdf((theta[k] + SIGMA * x - others) / SIGMA)),
            -8, 8,
        )[0]  # fmt: skip

    def mean(theta):
        return sum(chance(theta, k) * costs[k] for k in range(3))

    theta = np.array([0.2, -0.1, 0.15])
    assert sum(chance(theta, k) for k in range(3)) == pytest.approx(1.0)
    gradient, error = estimate(space, lambda v: costs[v[:, 0].astype(int)], theta)
    assert np.all(np.abs(gradient - numerically(mean, theta)) < 4 * error)


def act(params, obs):
    gain = {"weak": 0.1, "right": 1.0, "wrong": -1.0}[params["law"]]
    return -gain * obs[0] + 0.3 * (params["n"] - 3)


@pytest.mark.parametrize("tuner", ["zoac", "random"])
def test_tuners_find_the_best_option_and_number(tuner):
    small = {
        "critic": {"hidden": [16], "epochs": 1},
        "exploration": {"segment_length": 5, "segments": 4},
    }
    options = small if tuner == "zoac" else {}
    result = zoac.tune(
        env=Drift, controller=act, tuner=tuner, budget=4000, num_envs=8, max_episode_steps=20,
        space={"n": (1, 5, "integer"), "law": {"choices": ["weak", "right", "wrong"]}},
        tuner_options=options, eval_every=4000, episodes=1, final_episodes=2, quiet=True, seed=0,
    )  # fmt: skip
    assert result.parameters == {"n": 3, "law": "right"}
