"""The MPC as a function of its parameters, beside the nonlinear programme."""

import numpy as np
import pytest

from tests.mpc_tracking.oracle import NonlinearMpc
from zoac.core.errors import ControllerError
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.sqp import MpcOptions
from zoac.tasks.mpc_tracking import MpcTrackingVecEnv, TrackingMpc
from zoac.tasks.mpc_tracking.controller import NOMINAL, SPACE
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW, BicycleModel

N = 24
SOLVER = ClarabelSolver()


class Recorder:
    """Keeps a copy of the last problem; answers zero input."""

    screens = False
    bounds_states = True

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        names = ("a", "b", "states", "reference", "state_weights", "input_weights")
        self.problem = {name: getattr(problem, name).copy() for name in names}
        self.bounds = problem.bounds
        n = len(problem.inputs)
        return Solution(np.zeros_like(problem.inputs), np.zeros(n, np.int8), np.ones(n, np.int64))


@pytest.fixture(scope="module")
def observations() -> np.ndarray:
    return MpcTrackingVecEnv(N).reset(seed=5)[0]


def nominal(n: int = N) -> dict[str, np.ndarray]:
    return {name: np.full(n, value) for name, value in NOMINAL.items()}


def boxed(n: int = N) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (n, SPACE.dimension))


def off(actions: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return (n,) the largest difference, as a part of the input's range."""
    return (np.abs(actions - reference) / (INPUT_HIGH - INPUT_LOW)).max(axis=1)


def controller(**options) -> TrackingMpc:
    return TrackingMpc(SOLVER, MpcOptions(**options))


@pytest.fixture(scope="module")
def ipopt() -> NonlinearMpc:
    return NonlinearMpc(SPACE.names)


def test_nominal_inputs_are_those_of_the_nonlinear_programme(ipopt) -> None:
    starts = MpcTrackingVecEnv(60).reset(seed=6)[0]
    values = np.array(list(NOMINAL.values()))
    reference = np.array([ipopt.plan(values, row)[0] for row in starts])
    actions, _, _ = controller().act(nominal(60), starts, {})
    assert off(actions, reference).max() < 1e-6


def test_over_the_box_more_linearisations_come_nearer(observations, ipopt) -> None:
    z = boxed()
    plans = [ipopt.plan(*row) for row in zip(SPACE.values(z), observations, strict=True)]
    known = np.array([plan is not None for plan in plans])
    reference = np.array([plan[0] for plan in plans if plan is not None])
    distance = [
        np.median(
            off(
                controller(linearisations=k).act(SPACE.denormalise(z), observations, {})[0][known],
                reference,
            )
        )
        for k in (1, 2, 3, "converged")
    ]
    assert distance == sorted(distance, reverse=True)
    assert distance[-1] < 1e-8


@pytest.mark.parametrize(
    ("weights", "dead"), [("separate", set()), ("aliased", {"terminal_v", "terminal_omega"})]
)
def test_exactly_the_live_parameters_change_the_programme(observations, weights, dead) -> None:
    recorder = Recorder()
    mpc = TrackingMpc(recorder, MpcOptions(linearisations=1), weights)
    z = 0.5 * boxed()
    mpc.act(SPACE.denormalise(z), observations, {})
    before = recorder.problem
    unchanged = set()
    for i, name in enumerate(SPACE.names):
        other = z.copy()
        other[:, i] += 0.1
        mpc.act(SPACE.denormalise(other), observations, {})
        if all(np.array_equal(recorder.problem[key], before[key]) for key in before):
            unchanged.add(name)
    assert unchanged == dead


def numbered_weights(observations: np.ndarray, layout: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the state and input weights of the programme where the 13 weights are 1 to 13."""
    recorder = Recorder()
    values = dict(zip(SPACE.names[6:], np.arange(1.0, 14.0), strict=True))
    params = {**nominal(), **{name: np.full(N, value) for name, value in values.items()}}
    TrackingMpc(recorder, weights=layout).act(params, observations, {})
    return recorder.problem["state_weights"], recorder.problem["input_weights"]


def test_weights_stand_where_the_paper_puts_them(observations) -> None:
    weights, inputs = numbered_weights(observations, "separate")
    for k in (1, 24):
        np.testing.assert_allclose(weights[0, k - 1], 0.99**k * np.array([1, 2, 3, 0.01, 4, 5]))
    np.testing.assert_allclose(weights[0, 24], 0.99**25 * np.arange(6, 12))
    for k in (0, 24):
        np.testing.assert_allclose(inputs[0, k], 0.99**k * np.array([12, 13]))


def test_aliased_weights_are_read_two_places_early(observations) -> None:
    terminal = numbered_weights(observations, "aliased")[0][0, 24]
    np.testing.assert_allclose(terminal, 0.99**25 * np.array([12, 13, 6, 7, 8, 9]))


@pytest.mark.parametrize(
    ("options", "penalty"),
    [({}, 1e3 * 0.1), ({"state_penalty": 9.0}, 9.0), ({"state_bounds": "hard"}, np.inf)],
)
def test_bounds_on_states_stand_in_the_programme(observations, options, penalty) -> None:
    recorder = Recorder()
    sides = {"state_low": {"v": -0.3}, "state_high": {"v": 0.2, "u": 19.0}}
    mpc = TrackingMpc(recorder, MpcOptions(**sides, **options))
    mpc.act(nominal(), observations, {})
    bounds = recorder.bounds
    np.testing.assert_array_equal(bounds.low[3], [-np.inf] * 4 + [-0.3, -np.inf])
    np.testing.assert_array_equal(bounds.high[3], [np.inf] * 3 + [19.0, 0.2, np.inf])
    np.testing.assert_allclose(bounds.penalty[3, 3:5], penalty)


def test_the_true_model_predicts_the_plant() -> None:
    envs = MpcTrackingVecEnv(N)
    observations, _ = envs.reset(seed=5)
    actions, _, diagnostics = controller(linearisations=1).act(nominal(), observations, {})
    after = envs.step(actions)[0]
    np.testing.assert_array_equal(diagnostics["prediction"], after[:, :6])


@pytest.mark.parametrize(
    "options",
    [{}, {"linearisations": "converged"}, {"initial_guess": "shifted"}],
    ids=["default", "converged", "shifted"],
)
def test_an_environment_gives_the_same_bits_alone_and_again(observations, options) -> None:
    mpc = controller(**options)
    z, memory = boxed(8), mpc.init(8)
    if memory:
        memory["plan"][:] = np.random.default_rng(2).uniform(-0.1, 0.1, memory["plan"].shape)
    kept = observations[:8].copy(), {name: value.copy() for name, value in memory.items()}
    together = mpc.act(SPACE.denormalise(z), observations[:8], memory)
    for env_index in (6, 0, 3):
        row = slice(env_index, env_index + 1)
        own = {name: value[row] for name, value in memory.items()}
        alone = mpc.act(SPACE.denormalise(z[row]), observations[row], own)
        np.testing.assert_array_equal(alone[0][0], together[0][env_index])
        for one, many in ((alone[1], together[1]), (alone[2], together[2])):
            assert one.keys() == many.keys()
            for name in one:
                if name != "solver_seconds":
                    np.testing.assert_array_equal(one[name][0], many[name][env_index])
    np.testing.assert_array_equal(observations[:8], kept[0])
    for name, value in memory.items():
        np.testing.assert_array_equal(value, kept[1][name])


def test_a_stateless_controller_declares_no_memory(observations) -> None:
    mpc = controller(linearisations=1)
    assert mpc.init(N) == {}
    assert mpc.act(nominal(), observations, {})[1] == {}


def test_shifted_plan_begins_with_last_steps_plan_one_step_on(observations) -> None:
    solver = Recorder()
    mpc = TrackingMpc(solver, MpcOptions(linearisations=1, initial_guess="shifted"))
    plan = np.random.default_rng(0).uniform(-0.1, 0.1, (N, 25, 2))
    memory = mpc.act(nominal(), observations, {"plan": plan})[1]
    shifted = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
    theta = np.tile(list(NOMINAL.values())[:6], (N, 1))
    expected = BicycleModel().linearise(theta, observations[:, :6], shifted)[0]
    np.testing.assert_array_equal(solver.problem["states"], expected)
    np.testing.assert_array_equal(memory["plan"], np.zeros((N, 25, 2)))  # what was solved for
    assert {name: value.shape for name, value in mpc.init(3).items()} == {"plan": (3, 25, 2)}


def test_nothing_finite_gives_zero_input_and_says_so(observations) -> None:
    bad = observations.copy()
    bad[2, 4] = np.nan
    bad[5, 30] = np.inf
    actions, _, diagnostics = controller().act(nominal(), bad, {})
    failed = np.isin(np.arange(N), (2, 5))
    np.testing.assert_array_equal(diagnostics["solver_failed"], failed)
    np.testing.assert_array_equal(diagnostics["solver_status"][failed], Status.NOT_FINITE)
    np.testing.assert_array_equal(actions[failed], 0.0)
    good, _, _ = controller().act(nominal(), observations, {})
    np.testing.assert_array_equal(actions[~failed], good[~failed])


def test_a_shorter_horizon_reads_a_shorter_observation() -> None:
    observations, _ = MpcTrackingVecEnv(2, horizon=10).reset(seed=0)
    actions, _, _ = controller(horizon=10).act(nominal(2), observations, {})
    assert actions.shape == (2, 2)


def test_an_observation_that_does_not_fit_the_horizon_is_refused(observations) -> None:
    with pytest.raises(ControllerError) as caught:
        controller(horizon=10).act(nominal(), observations, {})
    assert str(caught.value) == (
        f"an MPC with horizon 10 reads observations of shape (n, 36), got ({N}, 81)"
    )
