"""An environment that pickle does not take: a warning, and new episodes at a resume."""

import json

import numpy as np
import pytest

import zoac
from tests.core.test_adapters import Drift
from zoac import checkpoint
from zoac.adapters import UserTask
from zoac.parameters import Parameter, ParameterSpace
from zoac.rollout import LaneGroup
from zoac.segments import Proposal
from zoac.trainer import Trainer


def proportional(params, obs):
    return -params["k"] * obs[0]


def tune(folder, env):
    return zoac.tune(
        env=env, controller=proportional, space={"k": (0, 2)}, budget=200, lanes=2, episodes=1,
        final_episodes=2, quiet=True, max_episode_steps=10, folder=folder,
    )  # fmt: skip


def local_env():
    class Local(Drift):
        def __init__(self):
            self.noise = lambda: 0.0

    return Local()


def stopped(folder, env, monkeypatch):
    """Tune, and stop after the second iteration as by Ctrl-C."""
    original = Trainer.__init__

    def init(self, *arguments, **options):
        original(self, *arguments, **options)
        calls = iter(range(1000))
        self._stop_requested = lambda: next(calls) == 1

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "__init__", init)
        with pytest.raises(KeyboardInterrupt):
            tune(folder, env)


def test_it_is_said_at_the_start_and_counted_in_the_result(tmp_path, monkeypatch, capsys):
    stopped(tmp_path / "run", local_env, monkeypatch)
    assert "cannot be saved" in capsys.readouterr().err
    state, _ = checkpoint.load(tmp_path / "run" / "checkpoint")
    assert state["lanes"] is None
    tune(tmp_path / "run", local_env)
    assert json.loads((tmp_path / "run" / "result.json").read_text())["lane_restarts"] == 1


def test_one_that_can_be_saved_is_not_restarted(tmp_path, monkeypatch, capsys):
    stopped(tmp_path / "run", Drift, monkeypatch)
    assert "cannot be saved" not in capsys.readouterr().err
    tune(tmp_path / "run", Drift)
    assert json.loads((tmp_path / "run" / "result.json").read_text())["lane_restarts"] == 0


class Bolted(Drift):
    """Cannot be copied at all."""

    def __deepcopy__(self, memo):
        raise TypeError("bolted to the bench")


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "cmaes"])
def test_an_environment_that_cannot_even_be_copied_is_tuned(tmp_path, tuner):
    result = zoac.tune(
        env=Bolted, controller=proportional, space={"k": (0, 2), "other": (0, 1)}, tuner=tuner,
        budget=400, lanes=2, episodes=1, final_episodes=2, quiet=True, max_episode_steps=10,
        folder=tmp_path / "run",
    )  # fmt: skip
    assert result.env_steps >= 400


def test_after_a_seeded_run_its_lane_begins_an_episode_of_its_own():
    space = ParameterSpace([Parameter("k", 0.0, 2.0)])
    task = UserTask(Bolted, proportional, space, max_episode_steps=10)
    z = np.zeros(1)

    def after(seed):
        group = LaneGroup(task, [0], [1])
        own = [Proposal(z, 0, horizon=3), Proposal(z, 0, horizon=3)]
        return group.rollout([Proposal(z, 0, horizon=3, seed=seed), *own])[1:]

    one, two = after(7)
    assert (one.starts_episode, two.starts_episode) == (True, False)
    assert np.array_equal(one.observations, after(8)[0].observations)
