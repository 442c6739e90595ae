"""From a checked configuration to the objects of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

from zoac.config.named_code import kinds_of, locate_maker
from zoac.config.settings import Settings
from zoac.config.validate import TARGET, check_arguments, with_groups
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem, Tuner
from zoac.executors.base import Executor
from zoac.loggers.base import Logger
from zoac.rollout.task import Task
from zoac.specs.judge import EPISODES_ONLY
from zoac.strategies.acceptance_test import AcceptanceTest
from zoac.strategies.around_baseline import around_baseline
from zoac.strategies.best_evaluated import SELECTION_FRACTION, BestEvaluated
from zoac.strategies.held_out import search_budget
from zoac.strategies.held_specs import FRACTION, HeldSpecs
from zoac.strategies.initial_design import CommonRandomNumbers, InitialDesign


def build(node: Mapping[str, Any], where: str, kind: type, **provided: Any) -> Any:
    """Check a config node against its `_target_` and call that, inner nodes first.

    Args:
        node: The node, resolved, as plain Python.
        where: Its name in the config, for messages.
        kind: What is built: a class or a protocol.
        provided: Arguments of the target that the node does not hold.

    Raises:
        ConfigError: Naming every fault of the node. Nothing is called if there is one.
    """
    return _checked(node, where, (kind,), provided)()


def _checked(
    node: Mapping[str, Any], where: str, kinds: tuple[type, ...], provided: Mapping[str, Any]
) -> Callable[[], Any]:
    """Return the call that a node stands for, after all checks of it and of those inside it."""
    if TARGET not in node:
        raise ConfigError(f"{where}: there is no _target_, the class that this node configures")
    if not isinstance(node[TARGET], str):
        raise ConfigError(f"{where}.{TARGET}: expected a dotted path, got {node[TARGET]!r}")
    target = locate_maker(node[TARGET], kinds, f"{where}.{TARGET}")
    given = {k: v for k, v in node.items() if not k.startswith("_")}
    hints = check_arguments(target, given, where, tuple(provided))
    inner = {}
    for name, value in given.items():
        if isinstance(value, Mapping) and TARGET in value:
            if not (taken := kinds_of(hints.get(name))):
                raise ConfigError(
                    f"{where}.{name}: a node with a _target_, and {node[TARGET]} does not say what "
                    f"it takes; annotate its argument {name!r} with a class"
                )
            inner[name] = _checked(value, f"{where}.{name}", taken, {})

    def call() -> Any:
        made = {name: make() for name, make in inner.items()}
        return target(**with_groups(given, hints) | made, **provided)

    return call


def build_task(config: Mapping[str, Any]) -> Task:
    """Return the task of a resolved configuration."""
    task = build(config["task"], "task", Task)
    if (penalty := config.get("failure_penalty")) is not None:
        task.failure_penalty = penalty
    return task


def build_settings(config: Mapping[str, Any]) -> Settings:
    """Return the settings of a resolved configuration.

    Raises:
        ConfigError: If one is of the wrong type or out of its bounds.
    """
    given = {f.name: config[f.name] for f in fields(Settings) if f.name in config}
    return Settings(**with_groups(given, check_arguments(Settings, given, "")))


def build_tuner(node: Mapping[str, Any], task: Task, settings: Settings) -> Tuner:
    """Return the tuner of the config node `tuner`, for `task`."""
    env = task.make_env(1)
    shape = env.single_observation_space.shape
    assert shape is not None
    baseline = None if task.baseline is None else task.space.normalise(task.baseline)
    whole = Problem(
        space=task.space,
        observation_size=shape[0],
        num_envs=settings.num_envs,
        budget=settings.budget,
        max_episode_steps=task.horizon.steps,
        seed=settings.seed,
        start=baseline,
        supports_snapshots=task.restore_fault is None,
        baseline=baseline,
    )
    env.close()
    if task.specs:
        _refuse_parts_of_episodes(node)
    if task.held_specs and any(spec.hard and not spec.of_loop for spec in task.specs):
        left = replace(whole, budget=search_budget(whole.budget, FRACTION))
        return HeldSpecs(build_tuner_for(node, left, settings), whole)
    return build_tuner_for(node, whole, settings)


def build_tuner_for(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner of a config node, and what wraps it, for a problem."""
    if settings.initial_sigma is not None:
        node = around_baseline(node, settings.initial_sigma)
    return _tested(node, problem, settings)


def _refuse_parts_of_episodes(node: Mapping[str, Any]) -> None:
    """Raise if a tuner asks for parts of episodes, over which specs cannot be judged."""
    made_by = locate_maker(node[TARGET], (Tuner,), f"tuner.{TARGET}")
    if not getattr(made_by, "whole_episodes", True):
        raise ConfigError(f"{node[TARGET]} sees parts of episodes, and {EPISODES_ONLY}")


def _tested(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, its answer tested against the baseline values if that is asked for."""
    if settings.acceptance_test is None:
        return _selected(node, problem, settings)
    left = replace(problem, budget=search_budget(problem.budget, settings.acceptance_test))
    return AcceptanceTest(_selected(node, left, settings), problem, settings.acceptance_test)


def _selected(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, its answer the best of those evaluated if that is asked for."""
    if settings.select != "best_evaluated":
        return _on_terms(node, problem, settings)
    left = replace(problem, budget=search_budget(problem.budget, SELECTION_FRACTION))
    return BestEvaluated(_on_terms(node, left, settings), problem, settings.eval_every)


def baseline_use(node: Mapping[str, Any], task: Task, settings: Settings) -> dict[str, str]:
    """Return what a run does with the baseline values, for its first lines; {} if there are none.

    Args:
        node: The tuner's config node.
        task: What is tuned.
        settings: Of the run.
    """
    if task.baseline is None:
        return {}
    begins = settings.initial_sigma is not None or node.get("start") == "baseline"
    if not begins or settings.initial_samples is not None:
        told = "only compared, the search does not begin there"
        more = "; tuner.start=baseline does" if "start" in node else ""
    else:
        told = "the search begins there"
        halved = settings.initial_sigma is None and node.get("halving_fraction")
        more = ", if they win against random points" if halved else ""
    return {"baseline values": told + more}


def _on_terms(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, with an initial design and common random numbers if they are asked for."""
    if settings.initial_samples is None:
        tuner: Tuner = build(node, "tuner", Tuner, problem=problem)
    else:
        if "start" not in node or settings.initial_sigma is not None:
            why = (
                "initial_sigma gives one"
                if settings.initial_sigma is not None
                else "this tuner takes none"
            )
            raise ConfigError(
                f"initial_samples={settings.initial_samples}: it looks for a start, and {why}"
            )
        node = {**node, "start": "baseline"}
        tuner = InitialDesign(
            problem, settings.initial_samples, lambda p: build(node, "tuner", Tuner, problem=p)
        )
    return CommonRandomNumbers(tuner, settings.seed) if settings.common_random_numbers else tuner


def build_executor(config: Mapping[str, Any]) -> Executor:
    """Return the executor of a resolved configuration, not yet started."""
    return build(config["executor"], "executor", Executor)


def build_loggers(config: Mapping[str, Any]) -> list[Logger]:
    """Return the loggers of a resolved configuration."""
    return [build(node, f"logger.{name}", Logger) for name, node in config["logger"].items()]
