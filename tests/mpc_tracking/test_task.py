"""What tuners and evaluations see of the task."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal, Segment
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.riccati import Riccati
from zoac.mpc.sqp import MpcOptions
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.mpc_tracking import MpcTracking

SOLVER = ClarabelSolver()
OPTIONS = MpcOptions(linearisations=1)


def rollout(task: MpcTracking, z: np.ndarray) -> Segment:
    return RolloutEngine(task, [0], [7]).rollout([Proposal(z, env_index=0, horizon=6)])[0]


@pytest.fixture(scope="module")
def segment() -> Segment:
    z = np.random.default_rng(0).uniform(-1, 1, 19)
    return rollout(MpcTracking(solver=SOLVER, mpc=OPTIONS), z)


def metric(name: str, segment: Segment) -> np.ndarray:
    return next(m for m in MpcTracking.metrics if m.name == name).per_step(segment)


def test_there_are_19_named_parameters() -> None:
    task = MpcTracking(solver=SOLVER)
    assert task.space.dimension == 19
    assert task.space.names == (
        "I_z", "k_f", "k_r", "l_f", "l_r", "m",
        "stage_x", "stage_y", "stage_phi", "stage_v", "stage_omega",
        "terminal_x", "terminal_y", "terminal_phi", "terminal_u", "terminal_v", "terminal_omega",
        "input_delta", "input_a",
    )  # fmt: skip


def test_the_nominal_parameters_lie_in_the_box() -> None:
    task = MpcTracking(solver=SOLVER)
    again = task.space.denormalise(task.space.normalise(task.baseline))
    for name, value in task.baseline.items():
        assert again[name] == pytest.approx(value, rel=1e-12)


def test_the_nominal_controller_predicts_without_error_and_keeps_to_the_path() -> None:
    task = MpcTracking(solver=SOLVER, mpc=OPTIONS)
    episode = RolloutEngine(task, [0], [7]).rollout(
        [Proposal(task.space.normalise(task.baseline), env_index=0)]
    )[0]
    assert episode.truncated
    assert episode.length == 200
    assert metric("prediction_error", episode).max() < 1e-12
    assert 10 < episode.costs.sum() < 80


def test_prediction_error_is_half_the_squared_distance_to_the_next_state(segment) -> None:
    expected = [
        0.5 * np.linalg.norm(predicted - following[:6]) ** 2
        for predicted, following in zip(
            segment.diagnostics["prediction"], segment.observations[1:], strict=True
        )
    ]
    np.testing.assert_allclose(metric("prediction_error", segment), expected)
    assert min(expected) > 0


def test_the_tuner_sees_the_plain_cost(segment) -> None:
    np.testing.assert_array_equal(MpcTracking(solver=SOLVER).tuning_costs(segment), segment.costs)


def test_the_regularised_tuner_pays_for_prediction_error(segment) -> None:
    costs = MpcTracking(solver=SOLVER, regularisation=50.0).tuning_costs(segment)
    error = segment.diagnostics["prediction"] - segment.observations[1:, :6]
    np.testing.assert_allclose(costs, segment.costs + 25.0 * (error**2).sum(axis=1))


def test_failures_and_retries_are_counted(segment) -> None:
    diagnostics = {
        **segment.diagnostics,
        "solver_failed": np.array([True, False, True, False, False, False]),
        "solver_retried": np.array([True, True, True, False, False, False]),
    }
    marked = replace(segment, diagnostics=diagnostics)
    assert metric("solver_failures", marked).sum() == 2
    assert metric("solver_retries", marked).sum() == 3


def test_a_pickled_task_gives_the_same_bits(segment) -> None:
    task = pickle.loads(pickle.dumps(MpcTracking(solver=SOLVER, mpc=OPTIONS)))
    again = rollout(task, segment.proposal.x)
    np.testing.assert_array_equal(again.actions, segment.actions)
    np.testing.assert_array_equal(again.costs, segment.costs)


def test_a_bound_on_the_yaw_rate_is_kept_in_closed_loop() -> None:
    largest = []
    for bounds in ({}, {"state_low": {"omega": -0.05}, "state_high": {"omega": 0.05}}):
        task = MpcTracking(solver=SOLVER, mpc=MpcOptions(**bounds))
        episode = RolloutEngine(task, [0], [7]).rollout(
            [Proposal(task.space.normalise(task.baseline), env_index=0, horizon=60)]
        )[0]
        assert not episode.diagnostics["solver_failed"].any()
        largest.append(np.abs(episode.observations[10:, 5]).max())  # the start is outside
    assert largest[0] > 0.1
    assert largest[1] < 0.05 + 1e-6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"state_low": {"w": 1.0}}, "mpc.state_low: unknown 'w'; known: omega, phi, u, v"),
        ({"state_bounds": "sfot"}, "mpc.state_bounds: unknown 'sfot'; did you mean 'soft'?"),
    ],
)
def test_wrong_bounds_are_named(options: dict, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        MpcTracking(solver=SOLVER, mpc=MpcOptions(**options))
    assert message in str(caught.value)


@pytest.mark.parametrize("solver", [SOLVER, Riccati()])
def test_infinite_bounds_are_none(solver) -> None:
    plain = MpcTracking(solver=solver).make_controller()
    params = {name: np.array([value]) for name, value in MpcTracking.baseline.items()}
    observations = np.ones((1, 6 + 3 * MpcOptions().horizon))
    mpc = MpcOptions(state_high={"u": np.inf}, state_low={"v": -np.inf})
    bounded = MpcTracking(solver=solver, mpc=mpc).make_controller()
    one, other = (c.act(params, observations, c.init(1))[0] for c in (plain, bounded))
    np.testing.assert_array_equal(one, other)


def test_riccati_names_the_solver_for_bounds_on_states() -> None:
    with pytest.raises(ConfigError) as caught:
        MpcTracking(solver=Riccati(), mpc=MpcOptions(state_high={"v": 1.0}))
    assert str(caught.value) == (
        "the solver riccati takes bounds on inputs alone, not task.mpc.state_low and state_high; "
        "use the solver clarabel"
    )
