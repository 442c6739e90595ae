"""What leaves the project is the controller that was tuned, to the last bit."""

import ctypes
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
import yaml

import zoac
from tests.envs.test_adapters import Drift, Integrator
from zoac.core.errors import ConfigError, RunFolderError
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.runs.export import export

ODD = {"k": 0.1 + 0.2, "tiny": 1e-05, "big": 1e16, "whole": 3, "c-f": -2.5, "mode": "it's"}


def tuned(controller, folder=None, **changes):
    options = {
        "env": Drift, "controller": controller, "budget": 60, "num_envs": 2, "seed": 3,
        "space": {"k": (1e-3, 1.0, "log"), "n": (1, 4, "integer"), "mode": {"choices": ["a", "b"]}},
        "tuner": "random", "max_episode_steps": 15, "quiet": True, "folder": folder,
        "episodes": 1, "final_episodes": 1,
    }  # fmt: skip
    return zoac.tune(**{**options, **changes})


def replayed(controller, segment):
    """Return the actions of a callable controller on a segment's observations."""
    return np.array([np.atleast_1d(controller(o)) for o in segment.observations[:-1]])


def closed_loop(result):
    group = RolloutEngine(result.task, [0], [7])
    return group.rollout([Proposal(np.array(result.record["x"]), env_index=0)])[0]


def law(params, obs):
    return -params["k"] / params["n"] * obs[0] * (1 if params["mode"] == "a" else 0.5)


def test_the_c_header_holds_every_value_as_its_type(tmp_path):
    text = export(ODD, tmp_path / "my gains.h", {"k": "N/rad"}).read_text()
    assert text.startswith("#ifndef MY_GAINS_H\n#define MY_GAINS_H\n")
    assert text.endswith("\n#endif\n")
    found = {name: (kind, literal) for kind, name, literal in
             re.findall(r"^static const (.+?) (\w+) = (.*?);", text, re.MULTILINE)}  # fmt: skip
    assert found == {
        "k": ("double", repr(0.1 + 0.2)), "tiny": ("double", "1e-05"), "big": ("double", "1e+16"),
        "whole": ("long", "3L"), "c_f": ("double", "-2.5"), "mode": ("char *const", '"it\'s"'),
    }  # fmt: skip
    assert "/* N/rad */" in text


def compiled(folder):
    """The control law of the header, by the C compiler."""
    (folder / "law.c").write_text(
        '#include <string.h>\n#include "gains.h"\n#include "words.h"\n'
        "double law(double x) "
        '{ return -k / (double) n * x * (strcmp(mode, "a") == 0 ? 1.0 : 0.5); }\n'
    )
    library = folder / "law.so"
    gcc = ["gcc", "-Wall", "-Werror", "-shared", "-fPIC", "-o", str(library), "law.c"]
    subprocess.run(gcc, cwd=folder, check=True)
    function = ctypes.CDLL(str(library)).law
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function


def read_as_text(folder):
    """The same, where there is no compiler."""
    found = dict(re.findall(r"(\w+) = (.*?);", (folder / "gains.h").read_text()))
    k, n, mode = float(found["k"]), int(found["n"].rstrip("L")), json.loads(found["mode"])
    return lambda x: -k / n * x * (1.0 if mode == "a" else 0.5)


READERS = [compiled, read_as_text] if shutil.which("gcc") else [read_as_text]


@pytest.mark.parametrize("reader", READERS)
def test_the_c_header_acts_as_the_tuned_controller(tmp_path, reader):
    result = tuned(law)
    result.export(tmp_path / "gains.h")
    export(WORDS, tmp_path / "words.h", {})
    by_header = reader(tmp_path)
    segment = closed_loop(result)
    assert [by_header(o[0]) for o in segment.observations[:-1]] == segment.commands[:, 0].tolist()


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_every_value_comes_back_exactly(suffix, tmp_path):
    path = export(ODD, tmp_path / f"x{suffix}", {"k": "N/rad"})
    read = json.loads if suffix == ".json" else yaml.safe_load
    assert read(path.read_text()) == ODD


def test_matlab_gets_a_function_that_returns_a_struct(tmp_path):
    text = export(ODD, tmp_path / "my gains.m", {"k": "N/rad"}).read_text()
    assert text.startswith("function parameters = my_gains()\n")
    fields = dict(re.findall(r"parameters\.(\w+) = (.*?);", text))
    assert {k: v for k, v in fields.items() if k != "mode"} == {
        "k": repr(0.1 + 0.2), "tiny": "1e-05", "big": "1e+16", "whole": "3", "c_f": "-2.5"
    }  # fmt: skip
    assert fields["mode"] == "'it''s'"
    assert "% N/rad" in text


def test_an_unknown_suffix_and_names_that_collide_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="known: .h, .json, .m, .yaml, .yml"):
        export(ODD, tmp_path / "x.txt", {})
    with pytest.raises(ConfigError, match="c-f, c_f are one identifier"):
        export({"c-f": 1.0, "c_f": 2.0}, tmp_path / "x.h", {})


WORDS = dict.fromkeys(("double", "end", "class", "for", "function", "default"), 1.0)


def test_names_that_a_language_keeps_for_itself_get_an_underscore(tmp_path):
    for suffix in (".h", ".m"):
        text = export(WORDS, tmp_path / f"end{suffix}", {}).read_text()
        names = re.findall(r"(\w+) = 1.0;", text)
        assert names == [f"{word}_" for word in WORDS]
    assert text.startswith("function parameters = end_()")
    assert json.loads(export(WORDS, tmp_path / "end.json", {}).read_text()) == WORDS
    with pytest.raises(ConfigError, match="end, end_ are one identifier"):
        export({"end": 1.0, "end_": 2.0}, tmp_path / "x.m", {})


@pytest.mark.parametrize("suffix", [".h", ".m"])
def test_a_value_without_a_literal_is_named(suffix, tmp_path):
    with pytest.raises(ConfigError, match="parameter 'mode': None has no literal .* to .json"):
        export({"mode": None}, tmp_path / f"x{suffix}", {})
    assert export({"mode": None}, tmp_path / "x.json", {}).read_text() == '{\n  "mode": null\n}\n'


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"x.json': No such file or directory; choose a folder"):
        export(ODD, tmp_path / "missing" / "x.json", {})


def test_a_loaded_controller_that_remembers_acts_as_the_tuned_one(tmp_path):
    result = tuned(Integrator(), tmp_path / "run", space={"k": (0.0, 1.0), "unused": 2.0})
    loaded = zoac.load_result(tmp_path / "run", trust_code=True)
    assert loaded.parameters == result.parameters
    assert loaded.parameters["unused"] == 2.0
    controller = loaded.controller()
    segment = closed_loop(result)
    wanted = segment.actions.astype(np.float32)
    for _ in range(2):  # the second time from a reset
        assert np.array_equal(replayed(controller, segment), wanted)
        controller.reset()


def test_a_built_in_tasks_controller_comes_from_its_configuration(tmp_path):
    result = zoac.tune(task="pid_acc", tuner="nominal", budget=0, episodes=1, final_episodes=1,
                       quiet=True, folder=tmp_path)  # fmt: skip
    segment = closed_loop(result)
    assert np.array_equal(
        replayed(zoac.load_result(tmp_path).controller(), segment), segment.commands
    )


def test_a_task_that_is_lost_is_named(tmp_path):
    tuned(Integrator(), tmp_path, space={"k": (0.0, 1.0)})
    (tmp_path / "task.pkl").unlink()
    with pytest.raises(RunFolderError, match="give it to load_result"):
        zoac.load_result(tmp_path).controller()
