"""Ctrl-C while `zoac.tune` runs: what was found so far is not lost."""

import signal

import pytest

import zoac
from tests.envs.test_adapters import Drift
from zoac.runs.training.trainer import Trainer


def proportional(params, obs):
    return -params["k"] * obs[0]


def tune(**options):
    return zoac.tune(
        env=Drift, controller=proportional, space={"k": (0, 2), "m": 3.0}, tuner="random",
        budget=200, num_envs=2, episodes=1, final_episodes=2, max_episode_steps=10, quiet=True,
        **options,
    )  # fmt: skip


def interrupted(**options):
    """Tune, press Ctrl-C in the third iteration, and return what is raised."""
    learn, iterations = Trainer._learn, iter(range(100))

    def press(self, segments):
        if next(iterations) == 2:
            signal.raise_signal(signal.SIGINT)
        learn(self, segments)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt) as stop:
        patch.setattr(Trainer, "_learn", press)
        tune(**options)
    return stop.value


def test_the_result_so_far_is_had_from_the_interruption(tmp_path):
    stop = interrupted(folder=tmp_path)
    assert isinstance(stop, zoac.Interrupted)
    result = stop.result
    assert result.parameters.keys() == {"k", "m"}
    assert result.parameters["k"] == result.record["parameters"]["k"]
    assert not result.finished
    assert "stopped early" in result.warnings[0]
    assert 0 < result.env_steps < 200
    assert result.history["env_steps"].max() == result.env_steps
    last = result.history.query("kind == 'eval'").iloc[-1]
    assert result.cost_mean == last["cost_mean"]
    assert result.record["evaluated_after_steps"] == last["env_steps"]
    assert float(result.controller()([1.0])[0]) == -min(result.parameters["k"], 1.0)


def test_parameters_are_the_recommendation_of_the_moment(tmp_path):
    stop = interrupted(folder=tmp_path, eval_every=1000)
    evaluated = stop.result.history.query("kind == 'eval'").iloc[-1]
    assert evaluated["env_steps"] == 0
    assert stop.result.parameters["k"] != evaluated["parameters"]["k"]


def test_the_same_call_goes_on_from_its_folder_to_the_same_end(tmp_path):
    stop = interrupted(folder=tmp_path)
    steps = stop.result.env_steps
    told = f"stopped after {steps} steps; the same call goes on from {tmp_path}"
    assert str(stop) == told
    result = tune(folder=tmp_path)
    assert result.finished
    assert result.parameters == tune().parameters


def test_without_a_folder_the_message_says_which_to_give():
    stop = interrupted()
    folder = stop.result.folder
    assert f"the same call with folder={str(folder)!r} goes on from {folder}" in str(stop)
    before = len(stop.result.history)
    result = tune(folder=folder)
    assert result.parameters == tune().parameters
    assert len(result.history) > before


@pytest.mark.parametrize("resume", ["never", "overwrite"])
def test_another_resume_is_not_promised_to_go_on(resume, tmp_path):
    stop = interrupted(folder=tmp_path, resume=resume)
    assert "the same call, with resume=auto, goes on from" in str(stop)
