"""A run of a user's own YAML file, loaded again."""

import json
import sys

import pytest

import zoac
from zoac.config.compose import compose_config, resolved
from zoac.core.errors import RunFolderError
from zoac.runs.training.lifecycle import run_session

MODULE = """
from tests.envs.test_adapters import Drift

def act(params, obs):
    return -params["k"] * obs[0] + params["bias"]
"""

YAML = """
_target_: zoac.tasks.user_task.user_task
env: load_result_plant.Drift
controller: load_result_plant.act
space:
  k: {low: 0.0, high: 1.0, unit: N/m}
  bias: 0.125
max_episode_steps: 5
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The run folder; as the current folder, the one that holds module and configuration."""
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "drift.yaml").write_text(YAML)
    (tmp_path / "load_result_plant.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    small = ["budget=20", "num_envs=2", "evaluation.episodes=1", "evaluation.final_episodes=1"]
    config = resolved(compose_config(["task=drift", "tuner=random", *small]))
    run_session(config, task="drift", tuner="random", command=[])
    yield tmp_path / "runs" / "drift" / "random" / "seed=0"
    sys.modules.pop("load_result_plant", None)


def test_fixed_parameters_are_loaded_and_exported(folder, tmp_path):
    result = zoac.load_result(folder)
    assert set(result.parameters) == {"k", "bias"}
    assert result.parameters["bias"] == 0.125
    written = json.loads(result.export(tmp_path / "gains.json").read_text())
    assert written == result.parameters


def test_parameters_need_no_code(folder, tmp_path):
    (tmp_path / "load_result_plant.py").unlink()
    sys.modules.pop("load_result_plant", None)
    result = zoac.load_result(folder, trust_code=True)
    assert result.parameters["bias"] == 0.125
    with pytest.raises(RunFolderError, match="no module 'load_result_plant'.*give it to load_res"):
        result.controller()


def test_a_module_is_loaded_only_if_it_is_trusted(folder):
    sys.modules.pop("load_result_plant", None)
    with pytest.raises(
        RunFolderError, match="task.env: load_result_plant.Drift, task.controller: l"
    ):
        zoac.load_result(folder).controller()
    assert "load_result_plant" not in sys.modules
    assert zoac.load_result(folder, trust_code=True).controller()([2.0]).shape == (1,)
