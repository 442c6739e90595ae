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
    """Have workers take over after the first batch, however fast it was."""
    monkeypatch.setattr(automatic, "PATIENCE", 0.0)
    monkeypatch.setattr(automatic, "SLOW", 0.0)


@pytest.fixture
def auto(forked_workers):
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


def test_workers_take_over_and_the_numbers_are_those_of_this_process(auto, monkeypatch):
    monkeypatch.setattr(automatic, "PATIENCE", 0.0)
    monkeypatch.setattr(support.SlowTask, "seconds", 0.001)
    assert same_as_serial(auto, support.SlowTask())
    (told,) = auto.said
    assert "worker processes take over" in told
    assert len(auto._current._workers) == 2


def test_environments_that_have_moved_go_on_in_workers(auto, eager, monkeypatch):
    serial = Serial()
    for executor in (auto, serial):
        executor.start(support.CountingTask(), 3, seed=0)
    for patience in (np.inf, 0.0, 0.0):
        monkeypatch.setattr(automatic, "PATIENCE", patience)
        pairs = zip(auto.rollout(plan()), serial.rollout(plan()), strict=True)
        assert all(support.same_segment(one, other) for one, other in pairs)
    assert "take over" in auto.said[0]


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
    assert auto.said == []


@pytest.mark.parametrize("cores", ["1", ""])
def test_a_job_keeps_to_its_cores(eager, forked_workers, cores, monkeypatch):
    monkeypatch.setenv("ZOAC_CORES", cores)
    auto = Auto()
    rolled_out(auto, support.CountingTask())
    assert isinstance(auto._current, Serial) == (cores == "1")
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


def test_an_error_of_the_rollout_in_which_workers_take_over_is_an_error(auto, eager):
    auto.start(support.CountingTask(), 3, seed=0)
    auto.rollout(plan())
    auto._current.run = auto._candidate.run = failing
    with pytest.raises(ControllerError, match="in the controller"):
        auto.rollout(plan())


def failing(*proposals):
    raise ControllerError("in the controller")


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
    auto.start(support.LockedTask(), 3, seed=0)
    auto.rollout(plan())
    assert "cannot be moved" in auto.said[1]


def test_a_run_ends_with_the_same_numbers_stopped_before_and_after_the_move(
    eager, forked_workers, stopping, tmp_path, monkeypatch, capsys
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
    assert "worker processes take over" in capsys.readouterr().out
    assert result.record["x"] == expected.record["x"]
    assert result.cost_per_episode == expected.cost_per_episode
    assert result.history["step_cost_mean"].equals(expected.history["step_cost_mean"])
