"""From a checked configuration to the objects of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from zoac.checks import TARGET, check_arguments, check_node, locate
from zoac.errors import ConfigError
from zoac.executor import Executor
from zoac.gate import Gate, search_budget, trusted
from zoac.runlog import Sink
from zoac.scout import CommonEpisodes, Scout
from zoac.task import Task
from zoac.trainer import Settings
from zoac.tuner import Problem, Tuner

# Notes for other parts of the configuration, not arguments of the task.
NOTES = ("tuned_for",)


def build(node: Mapping[str, Any], where: str, **provided: Any) -> Any:
    """Check a config node against its `_target_` and call that, inner nodes first.

    Raises:
        ConfigError: Naming every fault of the node.
    """
    node = {k: v for k, v in node.items() if k not in NOTES}
    check_node(node, where, provided=tuple(provided))
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
    task = build(config["task"], "task")
    if (penalty := config.get("failure_penalty")) is not None:
        task.failure_penalty = penalty
    return task


def build_settings(config: Mapping[str, Any]) -> Settings:
    """Return the trainer's settings of a resolved configuration."""
    evaluation = config["evaluation"]
    top = {k: config[k] for k in ("seed", "budget", "lanes", "eval_every", "checkpoint_seconds")}
    top |= {
        k: config[k]
        for k in ("trust", "gate", "failure_penalty", "scout", "common_episodes")
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
    whole = Problem(
        space=task.space,
        observation_size=shape[0],
        lanes=settings.lanes,
        budget=settings.budget,
        max_episode_steps=task.horizon.steps,
        seed=settings.seed,
        nominal=None if task.nominal is None else task.space.unit(task.nominal),
        branches=task.restore_fault is None,
    )
    env.close()
    if settings.trust is not None:
        node = trusted(node, settings.trust)
    if settings.gate is None:
        return _on_terms(node, whole, settings)
    left = replace(whole, budget=search_budget(whole.budget, settings.gate))
    return Gate(_on_terms(node, left, settings), whole, settings.gate)


def _on_terms(node: Mapping[str, Any], problem: Problem, settings: Settings) -> Tuner:
    """Return the tuner, with a scouted start and common episodes if they are asked for."""
    if settings.scout is None:
        tuner: Tuner = build(node, "tuner", problem=problem)
    else:
        if "start" not in node or settings.trust is not None:
            why = "trust gives one" if settings.trust is not None else "this tuner takes none"
            raise ConfigError(f"scout={settings.scout}: it looks for a start, and {why}")
        node = {**node, "start": "nominal"}
        tuner = Scout(problem, settings.scout, lambda p: build(node, "tuner", problem=p))
    return CommonEpisodes(tuner, settings.seed) if settings.common_episodes else tuner


def build_executor(config: Mapping[str, Any]) -> Executor:
    """Return the executor of a resolved configuration, not yet started."""
    return build(config["executor"], "executor")


def build_sinks(config: Mapping[str, Any]) -> list[Sink]:
    """Return the mirrors of a resolved configuration."""
    return [build(node, f"logger.{name}") for name, node in config["logger"].items()]
