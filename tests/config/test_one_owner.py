"""A setting is stated once in Python; its YAML file says the same; both readers agree."""

import importlib
import inspect
import itertools
from dataclasses import asdict, is_dataclass
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests import commands
from tests.support import needs_its_library
from zoac.config.compose import compose_config, resolved
from zoac.config.files import choices, configuration
from zoac.config.settings import Settings
from zoac.config.validate import _signature

CONF = Path(__file__).parents[2] / "conf"


def nodes():
    """Yield file, place and node of all that YAML files configure from the class's own defaults."""
    for path in sorted(CONF.rglob("*.yaml")):
        plain = OmegaConf.to_container(OmegaConf.load(path))
        if "defaults" not in plain:  # a preset begins from another file
            yield from inner(str(path.relative_to(CONF)), plain)


def inner(place, node):
    if isinstance(node.get("_target_"), str) and node["_target_"].startswith("zoac."):
        yield pytest.param(node, id=place)
    for key, value in node.items():
        if isinstance(value, dict):
            yield from inner(f"{place}:{key}", value)


def plain(value):
    """A default as YAML has it."""
    if is_dataclass(value):
        return {key: plain(v) for key, v in asdict(value).items()}
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize("node", list(nodes()))
def test_the_file_of_a_class_states_its_defaults(node):
    if node["_target_"].endswith("ray.Ray"):
        pytest.importorskip("ray", reason="executor=ray needs zoac[ray]")
    needs_its_library(node["_target_"])
    module, _, name = node["_target_"].rpartition(".")
    arguments, _ = _signature(getattr(importlib.import_module(module), name))
    stated = {k: v for k, v in node.items() if k in arguments and not is_choice(v)}
    defaults = {k: plain(arguments[k].default) for k in stated}
    own = {k: v for k, v in stated.items() if arguments[k].default is not inspect.Parameter.empty}
    assert own == {k: defaults[k] for k in own}


def is_choice(value):
    """Whether a value is another object, or comes from a group of its own."""
    return (isinstance(value, dict) and "_target_" in value) or str(value).startswith("${")


@pytest.mark.parametrize("tuner", choices("tuner"))
def test_every_option_of_a_tuner_is_in_its_file(tuner):
    node = configuration(task=None, tuner=tuner)["tuner"]
    needs_its_library(node["_target_"])
    module, _, name = node["_target_"].rpartition(".")
    arguments, _ = _signature(getattr(importlib.import_module(module), name))
    # What wraps a tuner is an option of all of them.
    assert set(node) - {"_target_", "strategies"} == set(arguments) - {"self", "problem"}


def test_the_runs_file_states_the_settings_defaults():
    run = OmegaConf.to_container(OmegaConf.load(CONF / "run.yaml"))
    assert {key: run[key] for key in asdict(Settings())} == asdict(Settings())


PRESETS = [path.relative_to(CONF / "preset") for path in (CONF / "preset").rglob("*.yaml")]
PAIRS = {(str(path.parent), path.stem) for path in PRESETS}


def other_tasks():
    """Yield those without a preset; of files with the same keys for the same class one will do."""
    kinds = set()
    for task in sorted(set(choices("task")) - {task for task, _ in PAIRS}):
        text = (CONF / "task" / f"{task}.yaml").read_text()
        plain = "defaults:" not in text and "${" not in text
        node = OmegaConf.to_container(OmegaConf.create(text))
        kind = (node["_target_"], *sorted(node)) if plain else task
        if kind not in kinds:
            kinds.add(kind)
            yield task


OTHER_TUNERS = sorted(set(choices("tuner")) - {tuner for _, tuner in PAIRS})
OTHER_TASKS = list(other_tasks())
PAIRS |= {
    *zip(itertools.cycle(OTHER_TASKS), OTHER_TUNERS),
    *zip(OTHER_TASKS, itertools.cycle(OTHER_TUNERS)),
}
"""A task and a tuner have only a preset in common."""


@pytest.mark.parametrize(("task", "tuner"), sorted(PAIRS))
def test_python_and_command_line_read_the_same_configuration(task, tuner):
    # A fidelity without a file for either of them changes nothing.
    own = {f"task/authors_code/{task}", f"tuner/authors_code/{tuner}"} & set(choices("fidelity"))
    for fidelity in ["paper", "authors_code"] if own else ["paper"]:
        overrides = [f"task={task}", f"tuner={tuner}", f"fidelity={fidelity}"]
        composed = resolved(compose_config(overrides))
        read = configuration(task=task, tuner=tuner, fidelity=fidelity)
        del composed["logger"]
        assert read == composed


def test_the_pairs_above_have_every_tuner():
    assert {tuner for _, tuner in PAIRS} == set(choices("tuner"))


def test_tuning_from_python_needs_no_hydra():
    code = """
import sys
for name in [name for name in sys.modules if name.partition(".")[0] == "hydra"]:
    del sys.modules[name]  # which the process that this one is forked from has imported
import zoac
zoac.tune(task="lqr", tuner="random", budget=20, episodes=1, final_episodes=1, quiet=True)
sys.exit("hydra" in sys.modules)
"""
    done = commands.run("-c", code, cwd=CONF.parent)
    assert (done.returncode, done.stderr) == (0, "")
