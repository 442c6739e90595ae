"""`task=program`: the command line's way to experiments of an external program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from zoac.config import factory
from zoac.config.files import configuration
from zoac.config.settings import Settings
from zoac.core.errors import ConfigError, RunFolderError
from zoac.runs import schema
from zoac.runs.training import lifeline, run_folder
from zoac.study.carry_out import tune_cost
from zoac.study.program import ProgramTask

OF_EXPERIMENTS = ("seed", "acceptance_test", "initial_sigma", "initial_samples")
"""Settings of a run that experiments have too."""


def is_program(config: Mapping[str, Any]) -> bool:
    """Whether a resolved configuration has experiments of a program in place of an environment."""
    return bool(config["task"].get("_target_") == factory.PROGRAM)


def run_experiments(config: Mapping[str, Any], task: str, tuner: str) -> dict[str, Any]:
    """Tune as configured, or go on with or return what is there already; see `tune_cost`.

    Args:
        config: Resolved configuration.
        task: Name of the task, for the study's identity.
        tuner: Name of the tuner, likewise.

    Returns:
        The content of `result.json`.
    """
    settings = factory.build_settings(config)
    given: ProgramTask = factory.build(config["task"], "task", ProgramTask)
    cost = given.cost()
    _refuse_settings_of_steps(settings)
    if given.space is None:
        raise ConfigError(
            "task.space: a value is needed, bounds by name, such as task.space={kp:[0,20]}"
        )
    folder = run_folder.of(config, task, tuner)
    there = (folder / schema.RUN).exists()
    if there and config["resume"] == "never":
        raise RunFolderError(
            f"{folder} holds a study already and resume=never; use resume=auto to go on with it, "
            "or another variant=<name>"
        )
    if there and config["resume"] == "overwrite":
        with run_folder.held(folder):
            run_folder.empty(folder)
    result = tune_cost(
        cost, folder=folder, name=task, variant=config["variant"], space=given.space, tuner=tuner,
        quiet=lifeline.shares_terminal(),
        tuner_options=_options(config["tuner"], tuner), experiments=given.experiments,
        workers=config["executor"].get("workers") or 1, baseline=given.baseline,
        constraints=given.constraints, **{name: getattr(settings, name) for name in OF_EXPERIMENTS},
    )  # fmt: skip
    return dict(result.record)


def _refuse_settings_of_steps(settings: Settings) -> None:
    """Raise if a setting is changed that experiments have no use for."""
    usual, now = asdict(Settings()), asdict(settings)
    for name in usual.keys() - {*OF_EXPERIMENTS, "checkpoint_seconds"}:
        if now[name] != usual[name]:
            raise ConfigError(
                f"{name}={now[name]}: experiments of a program have no such setting; there are "
                "task.experiments of them, executor.workers at a time"
            )


def _options(node: Mapping[str, Any], tuner: str) -> dict[str, Any]:
    """Return the tuner's options that differ from those of its file."""
    usual = configuration(task=None, tuner=tuner)["tuner"]
    return {k: v for k, v in node.items() if k not in usual or usual[k] != v}
