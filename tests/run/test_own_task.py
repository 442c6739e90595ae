"""A user's own folder: a module, conf/task/*.yaml, and this project untouched."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from stress.bad_inputs import answer
from zoac.config.compose import compose_config, own_conf
from zoac.config.validate import locate
from zoac.core.errors import ConfigError
from zoac.run.help import usage
from zoac.runs.training import identity

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "own_task"
SMALL = ["tuner=random", "num_envs=2", "budget=100", "evaluation.episodes=1",
         "evaluation.final_episodes=2", "variant=${hydra:runtime.choices.executor}"]  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The example, copied somewhere else, as the current folder."""
    shutil.copytree(EXAMPLE, tmp_path / "own", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path / "own")
    monkeypatch.syspath_prepend(str(tmp_path / "own"))
    yield tmp_path / "own"
    forget()


def forget():
    """Know nothing of their module, as another process."""
    sys.modules.pop("tank", None)
    identity._seen.clear()


@pytest.mark.filterwarnings("error::UserWarning:hydra")  # what a callback raises is a warning
def test_it_is_tuned_from_its_folder_in_this_process_and_in_others(folder):
    code, _, errors = answer("task=tank", "-m", "executor=serial,process", *SMALL)
    assert code == 0, errors
    one, two = (json.loads(p.read_text()) for p in folder.glob("runs/tank/**/result.json"))
    assert set(one["parameters"]) == {"kp", "ki"}
    assert one["x"] == two["x"]


def edited(folder, new):
    """Run the task after an edit, in what is like another process."""
    path = folder / "tank.py"
    path.write_text(path.read_text().replace("DT = 1.0", new))
    forget()
    return answer("task=tank", *SMALL)


def test_an_edit_of_their_code_makes_another_run_and_a_comment_does_not(folder):
    assert answer("task=tank", *SMALL)[0] == 0
    assert "done already" in edited(folder, "# Seconds.\nDT = 1.0")[1]
    code, _, errors = edited(folder, "DT = 20.0")
    assert code == 1
    assert "code.env: 'tank.Tank@" in errors
    assert "code.controller: 'tank.Pi@" in errors


def test_a_task_in_a_folder_of_the_group_keeps_its_full_name(folder):
    (folder / "conf/task/my_pkg").mkdir()
    shutil.move(folder / "conf/task/tank.yaml", folder / "conf/task/my_pkg/tank.yaml")
    config = compose_config(["task=my_pkg/tank"])
    assert config.task.controller == "tank.Pi"
    assert "my_pkg/tank" in usage()


def test_a_misspelt_task_gets_the_nearest_of_their_own(folder):
    with pytest.raises(ConfigError, match="did you mean 'tank'.*pid_acc"):
        compose_config(["task=tnak"])


def test_zoacs_own_conf_is_not_added_twice(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    assert own_conf() is None
    monkeypatch.chdir(tmp_path)
    assert own_conf() is None
    (tmp_path / "conf").mkdir()
    assert own_conf() == tmp_path / "conf"


def test_a_module_that_is_not_there_is_explained_without_a_traceback(folder):
    code, _, errors = answer("task=tank", "task.controller=tnak.Pi")
    assert code == 1
    assert errors.startswith("error: controller: cannot import 'tnak.Pi': there is no module")
    assert "did you mean 'tank'" in errors
    assert "Traceback" not in errors


def test_a_module_that_fails_is_told_with_the_line(folder):
    (folder / "broken.py").write_text("import math\nx = math.nothing\n")
    with pytest.raises(ConfigError, match=r"importing broken raised AttributeError.*line 2\)"):
        locate("broken.act", "controller")
