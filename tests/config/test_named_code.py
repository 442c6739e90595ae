"""What a configuration names is looked at before it is called."""

import os
import subprocess
from functools import lru_cache, partial
from typing import Annotated

import gymnasium
import numpy as np
import pytest

from tests.envs.test_adapters import Drift
from zoac.baselines.random_search import RandomSearch
from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.config.named_code import kinds_of, locate_code, locate_maker
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem, Tuner
from zoac.mpc.problem import Solver
from zoac.mpc.sqp import MpcOptions
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.task import Task
from zoac.runs.log import Logger
from zoac.tasks.pendulum import Pendulum
from zoac.tasks.user_task import user_task

KINDS = [Task, Tuner, Executor, Solver, Logger, MpcOptions]
FOREIGN = [
    "os.system",
    "subprocess.run",
    "subprocess.Popen",
    "builtins.eval",
    "builtins.object",
    "pathlib.Path.cwd",
    "zoac.runs.schema.write_atomically",
    "zoac.run.api.tune",
    "zoac.core.parameters.Parameter",
]


def pendulum(length: float = 1.0) -> Pendulum:
    return Pendulum()


def silent(length=1.0):
    return Pendulum()


def alternative() -> Annotated[Task | None, "or nothing"]:
    return None


def drift() -> Drift:
    return Drift()


def hold(params, obs):
    return 0.0


def unannotated_drift():
    return Drift()


class Callable:
    def __call__(self, params, obs):
        return 0.0


callable_object, with_gain = Callable(), partial(hold)
cached = lru_cache(unannotated_drift)
shell, popen = os.system, subprocess.Popen


@pytest.mark.parametrize("path", FOREIGN)
@pytest.mark.parametrize("kind", KINDS)
def test_a_target_of_another_kind_is_refused(path, kind):
    with pytest.raises(ConfigError, match=r"task\._target_: .*('\S+'|Path)"):
        locate_maker(path, (kind,), "task._target_")


@pytest.mark.parametrize("group", ["task", "tuner", "executor", "logger.mine", "task.solver",
                                   "task.mpc"])  # fmt: skip
def test_no_place_of_a_configuration_calls_a_program(group, tmp_path):
    trace = tmp_path / "trace"
    config = resolved(compose_config(["task=mpc_tracking"]))
    node = config
    *outer, last = group.split(".")
    for name in outer:
        node = node[name]
    node[last] = {"_target_": "os.system", "command": f"touch {trace}"}
    told = r"_target_: 'os.system' .*not called; expected a subclass of zoac.*def make\(...\) -> "
    with pytest.raises(ConfigError, match=f"{group}.{told}"):
        settings = factory.build_settings(config)
        factory.build_executor(config)
        factory.build_loggers(config)
        factory.build_tuner(config["tuner"], factory.build_task(config), settings)
    assert not trace.exists()


def test_nothing_is_called_if_a_fault_lies_deeper(tmp_path):
    outer = {
        "_target_": "tests.config.test_named_code.Recorder",
        "solver": {"_target_": "os.getcwd"},
    }
    with pytest.raises(ConfigError, match="solver._target_"):
        factory.build(outer, "task", Task)
    assert Recorder.made == 0


class Recorder(Task):
    made = 0

    def __init__(self, solver: Solver, anything=None) -> None:
        type(self).made += 1


def test_a_node_for_an_argument_without_a_class_is_refused():
    node = {
        "_target_": "tests.config.test_named_code.Recorder",
        "solver": {"_target_": "zoac.mpc.solvers.riccati.Riccati"},
        "anything": {"_target_": "os.getcwd"},
    }
    with pytest.raises(ConfigError, match="task.anything: .* annotate its argument 'anything'"):
        factory.build(node, "task", Task)


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("zoac.tasks.pendulum.Pendulum", Task),
        ("tests.config.test_named_code.pendulum", Task),
        ("tests.config.test_named_code.alternative", Task),
        ("zoac.tasks.user_task.user_task", Task),
        ("zoac.rollout.executors.base.Serial", Executor),
        ("zoac.mpc.solvers.clarabel_qp.ClarabelSolver", Solver),
        ("zoac.runs.loggers.wandb.Wandb", Logger),
    ],
)
def test_a_subclass_or_a_function_that_is_annotated_passes(path, kind):
    assert callable(locate_maker(path, (kind,), "x"))


def test_a_function_that_does_not_say_what_it_returns_is_refused():
    with pytest.raises(ConfigError, match=r"def make\(...\) -> Task"):
        locate_maker("tests.config.test_named_code.silent", (Task,), "task._target_")


def named(**changes):
    here = "tests.config.test_named_code"
    given = {"env": f"{here}.drift", "controller": f"{here}.hold", "space": {"k": (0.0, 1.0)}}
    return user_task(**given | changes, max_episode_steps=5)


@pytest.mark.parametrize("key", ["env", "controller", "metrics", "constraints"])
@pytest.mark.parametrize(
    "path", [*FOREIGN[:5], "tests.config.test_named_code.shell", "numpy.save", "pandas.eval",
             "torch.load", "zoac.run.api.make_task", "tests.config.test_named_code.popen"],
)  # fmt: skip
def test_a_path_that_leads_to_a_program_is_refused(key, path):
    value = {"mine": path} if key in ("metrics", "constraints") else path
    with pytest.raises(ConfigError, match=rf"{key}.*: '{path}' .*not called; expected a"):
        named(**{key: value})


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"env": "tests.config.test_named_code.unannotated_drift"},
        {"env": "tests.config.test_named_code.cached"},
        {"env": "tests.envs.test_adapters.Drift"},
        {"env": "gymnasium.envs.classic_control.PendulumEnv"},
        {"controller": "tests.config.test_named_code.callable_object"},
        {"controller": "tests.config.test_named_code.Callable"},
        {"controller": "tests.config.test_named_code.with_gain"},
    ],
)
def test_a_users_own_code_passes(changes):
    assert isinstance(named(**changes).space.dimension, int)


@pytest.mark.parametrize(
    "other", ["zoac.tasks.pendulum.Pendulum", "zoac.rollout.executors.base.Serial"]
)
def test_a_class_of_another_kind_is_no_environment(other):
    with pytest.raises(ConfigError, match="env: .* expected a gymnasium.Env, its class"):
        named(env=other)


@pytest.mark.parametrize(
    ("hint", "kinds"),
    [
        (Task, (Task,)),
        (Task | None, (Task,)),
        (Serial | RandomSearch, (Serial, RandomSearch)),
        (np.ndarray, (np.ndarray,)),
        (np.typing.NDArray[np.float64], (np.ndarray,)),
        (gymnasium.Env[int, int], (gymnasium.Env,)),
        (object, ()),
        (None, ()),
    ],
)
def test_the_classes_of_a_hint(hint, kinds):
    assert kinds_of(hint) == kinds


def test_installed_functions_pass_if_they_say_what_they_return(monkeypatch):
    def act(params, obs) -> float:
        return 0.0

    act.__module__ = "numpy"
    monkeypatch.setattr("tests.config.test_named_code.shell", act)
    path = "tests.config.test_named_code.shell"
    assert locate_code(path, "controller", (), (float,), "") is act
    with pytest.raises(ConfigError, match="annotated: -> ndarray"):
        locate_code(path, "metrics.mine", (), (np.ndarray,), "")


def test_a_problem_is_still_provided_by_the_caller():
    config = resolved(compose_config(["tuner=random"]))["tuner"]
    space = named().space
    problem = Problem(space, observation_size=1, num_envs=1, budget=5, max_episode_steps=5, seed=0)
    assert isinstance(factory.build(config, "tuner", Tuner, problem=problem), Tuner)
