"""From a checked configuration to the objects of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from zoac.best_evaluated import SELECTION_SHARE, BestEvaluated
from zoac.checks import TARGET, check_arguments, check_node, locate
from zoac.errors import ConfigError
from zoac.executor import Executor
from zoac.gate import Gate, trusted
from zoac.held_out import search_budget
from zoac.runlog import Sink
from zoac.scout import CommonEpisodes, Scout
from zoac.task import Task
from zoac.trainer import Settings
from zoac.tuner import Problem, Tuner

# Notes for other parts of the configuration, not arguments of the task.
NOTES = ("tuned_for",)


def build(node: Mapping[str, Any], where: str, expected: Any, **provided: Any) -> Any:
    """Check a config node against its `_target_` and call that, inner nodes first.

    Args:
        node: The node, resolved, as plain Python.
        where: Its name in the config.
        expected: What it must make: a class or a protocol.
        provided: Arguments of the target beside those in the node.

    Raises:
        ConfigError: Naming every fault of the node, or a target that makes something else.
    """
    node = {k: v for k, v in node.items() if k not in NOTES}
    check_node(node, where, tuple(provided), expected)
    return _call(node, where, provided)


def _call(node: Mapping[str, Any], where: str, provided: Mapping[str, Any]) -> Any:
    arguments = {
        name: _call(value, f"{where}.{name}", {})
        if isinstance(value, Mapping) and TARGET in value
        else value
        for name, value in node.items()
        if not name.startswith("_")
    }
    return locate(node[TARGET], f"{where}.{TARGET}")(**arguments, **provided)


def build_task(config: Mapping[str, Any]) -> Task:
    """Return the task of a resolved configuration."""
    task = build(config["task"], "task", Task)
    if (penalty := config.get("failure_penalty")) is not None:
        task.failure_penalty = penalty
    return task


def build_settings(config: Mapping[str, Any]) -> Settings:
    """Return the trainer's settings of a resolved configuration."""
    evaluation = config["evaluation"]
    top = {k: config[k] for k in ("seed", "budget", "lanes", "eval_every", "checkpoint_seconds")}
    top |= {
        k: config[k]
        for k in ("trust", "gate", "select", "failure_penalty", "scout", "common_episodes")
        if config.get(k) is not None
    }
    check_arguments(Settings, top, "")
    inner = {
        "episodes": evaluation["episodes"],
        "final_episodes": evaluation["final_episodes"],
        "evaluation_seed": evaluation["seed"],
    }
    check_arguments(Settings, inner, "evaluation")
    return Settings(**top, **inner)


def build_tuner(node: Mapping[str, Any], task: Task, settings: Settings) -> Tuner:
    """Return the tuner of the config node `tuner`, for `task`."""
    env = task.make_env(1)
    shape = env.single_observation_space.shape
    assert shape is not None
    nominal = None if task.nominal is None else task.space.unit(task.nominal)
    whole = Problem(
        space=task.space,
        observation_size=shape[0],
        lanes=settings.lanes,
        budget=settings.budget,
        max_episode_steps=task.horizon.steps,
        seed=settings.seed,
        nominal=nominal,
        branches=task.restore_fault is None,
        baseline=nominal,
    )
    env.close()
    if settings.trust is not None:
        node = trusted(node, settings.trust)
    return _tested(node, whole, settings)


def _tested(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, its answer tested against the start values if that is asked for."""
    if settings.gate is None:
        return _selected(node, problem, settings)
    left = replace(problem, budget=search_budget(problem.budget, settings.gate))
    return Gate(_selected(node, left, settings), problem, settings.gate)


def _selected(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, its answer the best of those evaluated if that is asked for."""
    if settings.select != "best_evaluated":
        return _on_terms(node, problem, settings)
    left = replace(problem, budget=search_budget(problem.budget, SELECTION_SHARE))
    return BestEvaluated(_on_terms(node, left, settings), problem, settings.eval_every)


def baseline_use(node: Mapping[str, Any], task: Task, settings: Settings) -> dict[str, str]:
    """Return what a run does with the start values, for its first lines; {} if there are none.

    Args:
        node: The tuner's config node.
        task: What is tuned.
        settings: Of the run.
    """
    if task.nominal is None:
        return {}
    begins = settings.trust is not None or node.get("start") == "nominal"
    if not begins or settings.scout is not None:
        told = "only compared, the search does not begin there"
        more = "; tuner.start=nominal does" if "start" in node else ""
    else:
        told = "the search begins there"
        raced = settings.trust is None and node.get("race_share")
        more = ", if they win the race against random points" if raced else ""
    return {"start values": told + more}


def _on_terms(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, with a scouted start and common episodes if they are asked for."""
    if settings.scout is None:
        tuner: Tuner = build(node, "tuner", Tuner, problem=problem)
    else:
        if "start" not in node or settings.trust is not None:
            why = "trust gives one" if settings.trust is not None else "this tuner takes none"
            raise ConfigError(f"scout={settings.scout}: it looks for a start, and {why}")
        node = {**node, "start": "nominal"}
        tuner = Scout(problem, settings.scout, lambda p: build(node, "tuner", Tuner, problem=p))
    return CommonEpisodes(tuner, settings.seed) if settings.common_episodes else tuner


def build_executor(config: Mapping[str, Any]) -> Executor:
    """Return the executor of a resolved configuration, not yet started."""
    return build(config["executor"], "executor", Executor)


def build_sinks(config: Mapping[str, Any]) -> list[Sink]:
    """Return the mirrors of a resolved configuration."""
    return [build(node, f"logger.{name}", Sink) for name, node in config["logger"].items()]
