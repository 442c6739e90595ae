"""`executor=auto`: where it goes, and that nobody can tell from the numbers."""

import os

import numpy as np
import pytest

import zoac
from tests import support
from zoac.core.errors import ControllerError
from zoac.rollout.executors import auto as automatic
from zoac.rollout.executors.auto import Auto
from zoac.rollout.executors.base import Serial

STATE = {"process": 0}


@pytest.fixture
def eager(monkeypatch):
    """Have workers started after the second batch, however fast it was, and kept."""
    monkeypatch.setattr(automatic, "PATIENCE", 0.0)
    monkeypatch.setattr(automatic, "SLOW", 0.0)
    monkeypatch.setattr(automatic, "TRIAL", 0.0)
    monkeypatch.setattr(automatic, "GAIN", np.inf)


@pytest.fixture
def patient(monkeypatch):
    """Have `Auto` wait for its workers as soon as they start."""
    start = Auto._start_workers

    def start_and_wait(self):
        start(self)
        self._wait_for_workers()

    monkeypatch.setattr(Auto, "_start_workers", start_and_wait)


@pytest.fixture
def auto(patient, forked_workers):
    executor = Auto(workers=2)
    executor.said = []
    executor.tell = executor.said.append
    yield executor
    executor.close()


def plan(horizon=3):
    return [
        support.proposal(env_index, a, horizon=horizon)
        for a in (1.0, 4.0)
        for env_index in (0, 1, 2)
    ]


def rolled_out(executor, task, rounds=4):
    """Return the segments of a few evaluations and rollouts."""
    executor.start(task, 3, seed=0)
    segments = []
    for seed in range(rounds):
        segments += executor.evaluate([support.proposal(0, seed=seed), support.proposal(1, seed=9)])
        segments += executor.rollout(plan())
    return segments


def same_as_serial(executor, task):
    pairs = zip(rolled_out(executor, task), rolled_out(Serial(), task), strict=True)
    return all(support.same_segment(one, other) for one, other in pairs)


def test_workers_take_over_and_hand_back_and_the_numbers_are_those_of_this_process(
    auto, eager, monkeypatch
):
    monkeypatch.setattr(automatic, "SLOW", 1e-4)
    monkeypatch.setattr(automatic, "GAIN", 0.0)
    monkeypatch.setattr(support.SlowTask, "seconds", 0.001)
    assert same_as_serial(auto, support.SlowTask())
    first, last = auto.said
    assert "worker processes take over" in first
    assert len(auto._processes._workers) == 2
    assert last.endswith("are no faster: all runs in one process")


def test_fast_steps_stay_in_this_process(auto, monkeypatch):
    monkeypatch.setattr(automatic, "PATIENCE", 0.0)
    monkeypatch.setattr(automatic, "SLOW", np.inf)
    rolled_out(auto, support.CountingTask())
    assert len(auto.said) == 1
    assert "too short for workers" in auto.said[0]


def test_nothing_is_started_before_it_can_pay(auto, monkeypatch):
    monkeypatch.setattr(automatic, "PATIENCE", 100.0)
    monkeypatch.setattr(automatic, "SLOW", 0.0)
    rolled_out(auto, support.CountingTask(), rounds=1)
    assert (auto.said, auto._starting) == ([], None)


@pytest.mark.parametrize("cores", ["1", ""])
def test_a_job_keeps_to_its_cores(eager, forked_workers, cores, monkeypatch):
    monkeypatch.setenv("ZOAC_CORES", cores)
    auto = Auto()
    rolled_out(auto, support.CountingTask())
    assert bool(auto._processes._workers) == (cores == "")
    auto.close()


class _SteeredController(support.EchoController):
    def act(self, params, obs, memory):
        actions, memory, diagnostics = super().act(params, obs, memory)
        return actions + (STATE["process"] == os.getpid()), memory, diagnostics


class SteeredTask(support.CountingTask):
    """Its controller reads what only this process knows."""

    def make_controller(self):
        return _SteeredController()


def test_a_task_that_something_outside_steers_stays(auto, eager, monkeypatch):
    monkeypatch.setitem(STATE, "process", os.getpid())
    assert same_as_serial(auto, SteeredTask())
    assert "workers give other numbers" in auto.said[0]


class Unsendable(support.CountingTask):
    """No pickle takes it."""

    def __reduce__(self):
        raise TypeError("bolted to the bench")


def test_a_task_that_cannot_be_sent_stays(auto, eager):
    assert same_as_serial(auto, Unsendable())
    assert "no worker can be started (TypeError: bolted to the bench)" in auto.said[0]


def test_environments_that_cannot_be_saved_go_before_they_move_or_stay(auto, eager):
    assert same_as_serial(auto, support.LockedTask())
    assert "take over" in auto.said[0]
    other = Auto(workers=2)
    other.tell = auto.said.append
    other.start(support.LockedTask(), 3, seed=0)
    for _ in range(2):
        other.rollout(plan())
    assert "cannot be moved" in auto.said[1]


def test_workers_that_start_while_it_evaluates_are_not_started_again(auto, eager, monkeypatch):
    started, launch = [], automatic.Process.launch
    monkeypatch.setattr(
        automatic.Process, "launch", lambda self, *made: (started.append(self), launch(self, *made))
    )
    auto.start(support.LockedTask(), 3, seed=0)
    for seed in range(3):
        auto.evaluate([support.proposal(0, seed=seed)])
    auto.rollout(plan())
    assert started == [auto._processes]


def test_an_error_of_the_rollout_in_which_workers_take_over_is_an_error(auto, eager):
    auto.start(support.RaisingTask(), 3, seed=0)
    auto._start_workers()
    with pytest.raises(ControllerError, match="in the controller"):
        auto.rollout(plan())


def test_a_run_ends_with_the_same_numbers_stopped_before_and_after_the_move(
    eager, patient, forked_workers, stopping, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("ZOAC_CORES", "2")

    def tune(executor, stop=None, moves=True):
        stopping(stop)
        monkeypatch.setattr(automatic, "PATIENCE", 0.0 if moves else np.inf)
        return zoac.tune(
            task=zoac.make_task("pendulum", max_episode_steps=20), budget=480, num_envs=4,
            episodes=1, final_episodes=2, executor=executor, folder=tmp_path / executor,
            tuner="zoac_plus",
            tuner_options={"exploration": {"segment_length": 5, "segments": 4}},
        )  # fmt: skip

    expected = tune("serial")
    for moves in (False, True):
        with pytest.raises(zoac.Interrupted):
            tune("auto", stop=2, moves=moves)
        assert ("worker processes take over" in capsys.readouterr().out) == moves
    result = tune("auto")
    told = capsys.readouterr().out
    assert "worker processes take over" in told
    assert "no faster" not in told
    assert result.record["x"] == expected.record["x"]
    assert result.cost_per_episode == expected.cost_per_episode
    assert result.history["step_cost_mean"].equals(expected.history["step_cost_mean"])
