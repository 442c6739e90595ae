"""A stopped run continues bit for bit, and without any pickle where no object needs one."""

import json
import pickle

import cloudpickle
import numpy as np
import pytest

import zoac
from tests.contracts.test_pairs import configured, names
from tests.envs.test_adapters import Drift, Integrator
from tests.support import with_a_trap
from zoac.config import factory
from zoac.core.measures import CLOCKS
from zoac.runs import checkpoint
from zoac.runs.training.lifecycle import Run, execute

NEED_A_PICKLE = {"bo", "optuna"}
NO_STATE_OF_THEIR_OWN = {"mpc_tracking_reg", "pid_acc_code"}
"""Tasks that are another one with other costs."""

STRATEGIES = {"acceptance_test": 0.3, "initial_samples": 3, "common_random_numbers": True}


def run(folder, config):
    identity = {"task": "t", "tuner": "x", "seed": 0}
    task = factory.build_task(config)
    made = Run(config, task, identity=identity, command=[], loggers=[])
    return without_clocks(execute(made, folder))


def without_clocks(result):
    return json.dumps({k: v for k, v in result.items() if k not in CLOCKS})


def stopped_and_resumed(tmp_path, stopping, monkeypatch, config):
    """Return a whole run's result and that of one that was stopped and went on without pickles."""
    whole = run(tmp_path / "whole", config)
    stopping(2)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "parts", config)
    stopping(None)
    with_a_trap(tmp_path / "parts" / "checkpoint" / checkpoint.CURRENT, tmp_path / "trace")
    with monkeypatch.context() as patch:
        for name in ("loads", "load"):
            patch.setattr(cloudpickle, name, None)
            patch.setattr(pickle, name, None)
        resumed = run(tmp_path / "parts", config)
    assert not (tmp_path / "trace").exists()
    return whole, resumed


@pytest.mark.parametrize("task", [t for t in names("task") if t not in NO_STATE_OF_THEIR_OWN])
def test_no_task_of_zoac_needs_a_pickle(task, tmp_path, stopping, monkeypatch):
    config = configured(task, "zoac_plus", budget=150, eval_every=100)
    whole, resumed = stopped_and_resumed(tmp_path, stopping, monkeypatch, config)
    assert resumed == whole


# The state of every tuner and strategy alone: test_contract.py, test_strategies.py.
@pytest.mark.parametrize(
    ("tuner", "wrapping"),
    [("zoac", {}), ("zoac_plus", STRATEGIES), ("cmaes", STRATEGIES), ("es", STRATEGIES)],
)
def test_no_tuner_of_zoac_that_needs_none_has_a_pickle(
    tuner, wrapping, tmp_path, stopping, monkeypatch
):
    config = configured("pid_acc", tuner, budget=600, eval_every=100, **wrapping)
    whole, resumed = stopped_and_resumed(tmp_path, stopping, monkeypatch, config)
    assert resumed == whole


@pytest.mark.parametrize("tuner", sorted(NEED_A_PICKLE))
def test_a_librarys_optimiser_continues_bit_for_bit(tuner, tmp_path, stopping):
    pytest.importorskip({"bo": "nevergrad"}.get(tuner, tuner))
    config = configured("pid_acc", tuner, budget=120, eval_every=100)
    whole = run(tmp_path / "whole", config)
    stopping(3)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "parts", config)
    stopping(None)
    assert run(tmp_path / "parts", config) == whole


def tune(folder, executor="serial"):
    result = zoac.tune(
        env=Drift, controller=Integrator(), space={"k": (0, 2)}, tuner="random", budget=200,
        num_envs=2, episodes=1, final_episodes=2, quiet=True, max_episode_steps=10, folder=folder,
        executor=executor,
    )  # fmt: skip
    return without_clocks(result.record)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return tune(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("executor", ["serial", "process"])
def test_a_users_objects_continue_bit_for_bit(executor, tmp_path, stopping, forked_workers, whole):
    stopping(2)
    with pytest.raises(KeyboardInterrupt):
        tune(tmp_path, executor)
    stopping(None)
    state, _ = checkpoint.load(tmp_path / "checkpoint")
    assert isinstance(state["num_envs"][0]["env"]["envs"].value[0], Drift)
    assert np.isfinite(state["num_envs"][0]["env"]["seen"]).all()
    assert tune(tmp_path, executor) == whole
