"""`zoac.mpc.Mpc`: the programme that it says, whatever is in it, as a controller to tune."""

from __future__ import annotations

import pickle

import cloudpickle
import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import stress.mpc_against_ipopt as against_ipopt
import zoac
from tests.mpc.systems import SOLVER, SYSTEMS, cart_pole
from zoac.core.errors import ConfigError, ControllerError
from zoac.mpc import CasadiModel, FunctionModel, Mpc
from zoac.mpc.problem import Sparsity, Status


def step(x, u, p):
    """A mass [kg] on a line, pushed for 0.1 s."""
    return x.position + 0.1 * x.speed, x.speed + 0.1 * u.force / p.mass


MASS = FunctionModel(["position", "speed"], ["force"], {"mass": 2.0}, step=step)
WEIGHTS = {"position": 1.0, "speed": 0.1, "force": 0.01}


def mass(**options) -> Mpc:
    given = {"weights": WEIGHTS, "bounds": {"force": (-5.0, 5.0)}, "solver": SOLVER}
    return Mpc(MASS, 10, **{**given, **options})


def first_inputs(mpc: Mpc, observations, params=None, memory=None) -> np.ndarray:
    n = len(observations)
    params = {name: np.broadcast_to(value, n) for name, value in (params or {}).items()}
    return mpc.act(params, np.asarray(observations), memory or mpc.init(n))[0]


CHANGES = {
        "cart-pole": [
            {"rate_weights": None}, {"rate_bounds": None}, {"terminal": None}, {"reference": None},
            {"discount": 1.0}, {"penalty": 1.0},
            {"bounds": {"force": (-10.0, 10.0)}, "penalty": None},
            {"weights": {"position": 1, "speed": 0.1, "angle": 10, "rate": 0.1, "force": 0.02}},
        ],
        "reactor": [
            {"reference": {"a": 2.14, "b": 1.09, "reactor": 114.2}},
            {"terminal": {"b": 500.0, "reactor": 5e-3}},
        ],
        "vehicle": [{"bounds": {"delta": (-0.42, 0.42), "a": (-3, 3), "v": (-0.25, 0.25)},
                   "hard": ()}],
}  # fmt: skip


@pytest.mark.parametrize(("name", "count"), [("cart-pole", 4), ("vehicle", 2), ("reactor", 2)])
def test_the_first_input_is_ipopts_and_every_part_of_the_programme_counts(name, count) -> None:
    """All kinds of weights and bounds; without any one of them IPOPT's input is another one.

    In as few states as show all of it; stress/mpc_against_ipopt.py takes hundreds.
    """
    system = SYSTEMS[name](count, 0)
    by_ipopt = against_ipopt.first_inputs(system)
    off, alone = against_ipopt.differences(system, by_ipopt)
    assert not alone.any()
    assert np.isfinite(off).all()
    assert off.max() < 1e-4
    for change in CHANGES[name]:
        off, _ = against_ipopt.differences(SYSTEMS[name](count, 0, **change), by_ipopt)
        assert np.nanmax(off) > 1e-4, change


EVERYTHING = {
    "weights": {**WEIGHTS, ("position", "speed"): 0.1, ("speed", "force"): 0.01},
    "terminal": "riccati",
    "rate_weights": {"force": 0.02},
    "reference": {"position": 1.0, "force": 0.5},
    "discount": 0.95,
}


def tank(**options) -> Mpc:
    """A tank and a state that is always 0: with a rate of the pattern that `riccati` is tested on.

    Another one would take long to compile.
    """
    zeros = Sparsity(np.array([[1, 0], [0, 0]], bool), np.array([[1], [0]], bool))
    model = FunctionModel(
        ["level", "idle"], ["flow"], sparsity=zeros,
        step=lambda x, u, p: (0.9 * x.level + u.flow, 0.0 * x.level),
    )  # fmt: skip
    return Mpc(model, 10, weights={"level": 1.0}, rate_weights={"flow": 0.1}, discount=0.95,
               bounds={"flow": (-1.0, 1.0)}, reference={"level": 1.0}, **options)  # fmt: skip


@pytest.mark.parametrize(
    ("other", "build"), [("cvxpy", lambda **o: mass(**EVERYTHING, **o)), ("riccati", tank)]
)
def test_solvers_agree_on_what_both_take(other, build) -> None:
    observations = np.random.default_rng(0).normal(size=(5, 2))
    plain = first_inputs(build(solver=SOLVER), observations)
    assert np.ptp(plain) > 0.5
    found = first_inputs(build(solver=other), observations)
    np.testing.assert_allclose(found, plain, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"bounds": {"speed": (None, 1.0)}}, "bounds on states"),
        ({"rate_bounds": {"force": 1.0}}, "bounds on rates"),
        ({"bounds": {"speed": (-1, 1)}, "rate_bounds": {"force": 1.0}},
         "bounds on states and bounds on rates"),
    ],
)  # fmt: skip
def test_riccati_refuses_the_rest_and_names_the_solver_to_use(options, what) -> None:
    with pytest.raises(ConfigError) as caught:
        mass(**options, solver="riccati")
    assert str(caught.value) == (
        f"the solver riccati takes bounds on inputs alone, not {what}; use the solver clarabel"
    )


def test_riccati_refuses_tuned_bounds_when_it_meets_them() -> None:
    with pytest.raises(ConfigError, match="not tuned bounds on inputs; use the solver clarabel"):
        first_inputs(mass(solver="riccati"), [[1.0, 0.0]], {"high_force": 2.0})


def test_parameters_replace_numbers_and_each_changes_something() -> None:
    options = EVERYTHING | {"terminal": {"position": 3.0, "speed": 1.0, ("position", "speed"): 0.1}}
    mpc = mass(
        **options, rate_bounds={"force": 3.0}, bounds={"force": (-5.0, 5.0), "speed": (-0.5, 0.4)},
        penalty=10.0,
    )  # fmt: skip
    observations = np.random.default_rng(1).normal(size=(25, 2)) * (2.0, 0.5)
    plain = first_inputs(mpc, observations)
    again = first_inputs(mpc, observations, mpc.numbers.values)
    np.testing.assert_allclose(again, plain, atol=1e-5)
    for name, value in mpc.numbers.values.items():
        factor = 0.9 if name == "discount" else 0.5
        other = first_inputs(mpc, observations, {name: factor * value})
        assert np.abs(other - plain).max() > 1e-3, name


def test_a_tuned_bound_of_an_input_is_kept() -> None:
    observations = [[3.0, 0.0], [-3.0, 0.0]]
    np.testing.assert_allclose(first_inputs(mass(), observations), [[-5.0], [5.0]])
    tuned = first_inputs(mass(), observations, {"low_force": -4.0, "high_force": 1.5})
    np.testing.assert_allclose(tuned, [[-4.0], [1.5]], atol=1e-6)


def test_environments_have_their_own_bits() -> None:
    system = cart_pole(6, 0)
    names = {"weight_angle": np.linspace(1, 20, 6), "pole": np.linspace(0.05, 0.2, 6)}
    together = system.mpc.act(names, system.observations, system.mpc.init(6))
    for i in range(6):
        alone = system.mpc.act(
            {name: value[i : i + 1] for name, value in names.items()},
            system.observations[i : i + 1],
            system.mpc.init(1),
        )
        np.testing.assert_array_equal(alone[0][0], together[0][i])
        for name, value in alone[1].items():
            np.testing.assert_array_equal(value[0], together[1][name][i])


def test_a_copy_plans_the_same_bits() -> None:
    system = cart_pole(3, 0)
    before = first_inputs(system.mpc, system.observations)
    copy = pickle.loads(cloudpickle.dumps(system.mpc))
    np.testing.assert_array_equal(first_inputs(copy, system.observations), before)


def test_rates_are_those_from_the_input_before() -> None:
    mpc = mass(rate_bounds={"force": 0.5}, initial_input={"force": 1.0})
    memory = mpc.init(1)
    np.testing.assert_array_equal(memory["input"], [[1.0]])
    forces, x = [1.0], np.array([[3.0, 0.0]])
    for _ in range(6):
        action, memory, found = mpc.act({}, x, memory)
        forces.append(action[0, 0])
        x = found["prediction"]
    np.testing.assert_allclose(np.diff(forces), -0.5, atol=1e-6)


def test_a_shifted_plan_is_remembered_and_begins_at_rest() -> None:
    mpc = mass(initial_guess="shifted", linearisations=1, reference={"force": 0.5})
    memory = mpc.init(2)
    assert np.isnan(memory["plan"]).all()
    x = np.array([[1.0, 0.0], [0.5, 0.2]])
    first, memory, _ = mpc.act({}, x, memory)
    np.testing.assert_array_equal(memory["plan"][:, 0], first)
    np.testing.assert_allclose(first, first_inputs(mass(reference={"force": 0.5}), x), atol=1e-6)


def test_references_come_as_columns_or_from_a_function() -> None:
    x, ahead = np.array([[0.5, 0.0]]), np.linspace(0.0, 1.0, 10)
    seen = np.concatenate([x, [[7.0]], ahead[None]], axis=1)
    previewed = first_inputs(mass(reference={"position": slice(3, 13)}), seen)
    goal = np.stack([ahead, np.zeros(10)], axis=1)
    np.testing.assert_array_equal(first_inputs(mass(reference=lambda obs: goal), x), previewed)
    held = first_inputs(mass(reference={"position": slice(2, 3)}), seen)
    constant = first_inputs(mass(reference={"position": 7.0}), x)
    np.testing.assert_array_equal(held, constant)
    assert abs(held - previewed) > 0.1


def test_the_state_is_read_from_the_observation() -> None:
    plain = first_inputs(mass(), [[0.5, 0.2]])
    assert first_inputs(mass(state=[2, 0]), [[0.2, 9.0, 0.5]]) == plain
    read = lambda obs: np.stack([obs[:, 0] - 1.0, obs[:, 1]], axis=1)  # noqa: E731
    assert first_inputs(mass(state=read), [[1.5, 0.2]]) == plain


def test_where_no_plan_keeps_hard_bounds_the_fallback_is_applied_and_counted() -> None:
    options = {"bounds": {"force": (-5.0, 5.0), "position": (-1.0, 1.0)}, "linearisations": 2}
    observations = np.array([[0.9, 0.0], [1.5, 0.0]])
    hard = mass(**options, hard="position", reference={"force": 9.0})
    actions, _, found = hard.act({}, observations, hard.init(2))
    np.testing.assert_array_equal(found["solver_failed"], [False, True])
    np.testing.assert_array_equal(found["solver_status"], [0, Status.INFEASIBLE])
    np.testing.assert_array_equal(actions[1], 5.0)  # the reference, inside the bounds
    soft = mass(**options)
    actions, _, found = soft.act({}, observations, soft.init(2))
    assert not found["solver_failed"].any()
    np.testing.assert_allclose(actions[1], -5.0)


def test_soft_bounds_have_a_plan_wherever_it_begins() -> None:
    system = cart_pole(60, 1, linearisations=2)
    far = system.observations * (30.0, 30.0, 3.0, 10.0)
    actions, _, found = system.mpc.act({}, far, system.mpc.init(60))
    assert not found["solver_failed"].any()
    assert np.isfinite(actions).all()
    assert (np.abs(actions) <= 6.0 + 1e-6).all()  # from rest, by the bound on rates


def test_the_space_holds_todays_values() -> None:
    mpc = mass(reference={"position": 0.0}, discount=0.9)
    space = mpc.space("weight", "reference", within=10.0, mass=(1.0, 3.0), discount=(0.8, 1.0))
    assert space["weight_position"] == {"low": 0.1, "high": 10.0, "scale": "log", "baseline": 1.0}
    assert space["mass"] == {"low": 1.0, "high": 3.0, "baseline": 2.0}
    assert list(space) == ["weight_position", "weight_speed", "weight_force", "mass", "discount"]


@pytest.mark.parametrize(
    ("names", "bounds", "message"),
    [
        (["wieght"], {}, "space: this MPC has no number 'wieght'; did you mean 'weight'?"),
        ([], {}, "space: name what is tuned; known: "),
        ([], {"mass": (3.0, 4.0)}, "space: mass is 2 now, outside [3, 4]; widen the bounds"),
        ([], {"discount": (0.9, 1.1)}, "space: discount must stay at most 1"),
        (["high"], {}, "space: high_force must stay inside the bounds that the MPC was built with"),
        (["reference_position"], {}, "reference_position is 0, no scale for bounds"),
    ],
)
def test_a_wrong_space_is_named(names, bounds, message) -> None:
    with pytest.raises(ConfigError) as caught:
        mass(reference={"position": 0.0}).space(*names, **bounds)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": {"postion": 1.0}}, "weights: unknown 'postion'; did you mean 'position'?"),
        ({"weights": {"position": 1.0}}, "the input 'force' has no weight; give weights={'force':"),
        (
            {"weights": {**WEIGHTS, "speed": -1.0}},
            "weight_speed=-1.0: expected a finite number",
        ),
        ({"weights": {**WEIGHTS, ("position", "speed"): 9.0}}, "not positive semidefinite"),
        ({"weights": [1.0]}, "weights=[1.0]: expected values by name: position, speed, force"),
        ({"bounds": {"force": 1.0}}, "bounds['force']=1.0: expected (low, high)"),
        ({"bounds": {"force": (2.0, 1.0)}}, "low must not be above high"),
        ({"hard": ["speed"]}, "hard: no bounds on a state 'speed'"),
        ({"penalty": {"speed": 1.0}}, "penalty: unknown 'speed'; known: (none)"),
        ({"terminal": "ricati"}, "terminal='ricati': did you mean 'riccati'?"),
        ({"terminal": {"force": 1.0}}, "terminal: unknown 'force'"),
        ({"rate_weights": {"speed": 1.0}}, "rate_weights: unknown 'speed'; known: force"),
        ({"discount": 1.5}, "discount=1.5: expected a number above 0, at most 1"),
        ({"reference": {"speed": "x"}}, "reference_speed='x': expected a finite number"),
        ({"state": [0]}, "state=[0]: expected 2 columns of the observation"),
        ({"solver": "clarable"}, "solver='clarable': did you mean 'clarabel'?"),
        ({"linearisations": 0}, "mpc.linearisations: expected a number from 1 or 'converged'"),
        ({"initial_guess": "zeros"}, "mpc.initial_guess: unknown 'zeros'"),
    ],
)
def test_what_is_wrong_is_named(options, message) -> None:
    with pytest.raises(ConfigError) as caught:
        mass(**options)
    assert message in str(caught.value)


@pytest.mark.parametrize("solver", ["clarabel", "cvxpy"])
@pytest.mark.parametrize("pair", [(None, None), (-np.inf, np.inf)])
def test_bounds_without_a_side_bound_nothing(pair, solver) -> None:
    one, other = (first_inputs(mass(solver=solver, bounds={"force": (-1.0, 1.0), **bounds}),
                               [[1.0, 0.5]]) for bounds in ({}, {"speed": pair}))  # fmt: skip
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_names_that_clash_are_told() -> None:
    model = FunctionModel(["a"], ["u"], {"weight_a": 1.0}, step=lambda x, u, p: (x.a + u.u,))
    with pytest.raises(ConfigError, match="weight_a would be two numbers of this MPC; rename"):
        Mpc(model, weights={"a": 1.0, "u": 1.0})


@pytest.mark.parametrize(
    ("options", "observation", "message"),
    [
        ({}, [[1.0]], "the model has 2 states, the observation 1 numbers"),
        ({"state": lambda obs: obs}, [[1.0, 2.0, 3.0]], "expected states of shape (1, 2), got"),
        ({"reference": {"speed": slice(1, 4)}}, [[1.0, 0.0, 0.0, 0.0]], "are 3 columns, expected"),
        ({"reference": lambda obs: np.zeros(3)}, [[1.0, 0.0]], "the function returned (3,)"),
    ],
)  # fmt: skip
def test_observations_that_do_not_fit_are_told(options, observation, message) -> None:
    with pytest.raises(ControllerError) as caught:
        first_inputs(mass(**options), observation)
    assert message in str(caught.value)


def test_a_plant_that_cannot_be_stabilised_has_no_riccati_weight() -> None:
    model = FunctionModel(["a"], ["u"], step=lambda x, u, p: (2.0 * x.a + 0.0 * u.u,))
    mpc = Mpc(model, weights={"a": 1.0, "u": 1.0}, terminal="riccati")
    with pytest.raises(ControllerError, match="terminal='riccati': no solution with these param"):
        first_inputs(mpc, [[1.0]])


class Line(gymnasium.Env):
    """The mass, 1.5 kg, from a random place."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-5.0, 5.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1.0, 1.0, 2)
        return self.x.copy(), {}

    def step(self, action):
        self.x = self.x + 0.1 * np.array([self.x[1], float(action[0]) / 1.5])
        return self.x.copy(), -float(self.x[0] ** 2), False, False, {}


def test_it_is_tuned_like_any_controller() -> None:
    mpc = mass(linearisations=1)
    result = zoac.tune(
        env=Line, controller=mpc, space=mpc.space("weight_force", mass=(1.0, 3.0)), tuner="cmaes",
        budget=300, max_episode_steps=20, num_envs=2, final_episodes=2, episodes=2, quiet=True,
    )  # fmt: skip
    assert result.cost_mean < result.baseline_cost_mean
    assert result.record["solver_failures"] == 0
    assert set(result.parameters) == {"weight_force", "mass"}
    np.testing.assert_array_equal(
        result.controller()(np.array([1.0, 0.0])),
        first_inputs(mpc, [[1.0, 0.0]], result.parameters)[0],
    )


def test_casadis_model_and_a_function_give_the_same_controller() -> None:
    names = {"states": MASS.states, "inputs": MASS.inputs, "parameters": MASS.parameters}
    by_casadi = Mpc(CasadiModel(**names, step=step), 10, weights=WEIGHTS)
    np.testing.assert_allclose(
        first_inputs(by_casadi, [[1.0, 0.0]]),
        first_inputs(Mpc(MASS, 10, weights=WEIGHTS), [[1.0, 0.0]]),
        atol=1e-9,
    )
