"""What tuning found, and the task that it was found on, from a run folder."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoac import build, records
from zoac.checks import TARGET
from zoac.errors import RunFolderError
from zoac.export import TunedController, export
from zoac.task import Task

if TYPE_CHECKING:
    import pandas as pd


def task_from_config(config: Mapping[str, Any]) -> Task:
    """Return the task of a run, from the `config` in its `run.json`."""
    return build.build_task(config)


@dataclass(frozen=True)
class Result:
    """What tuning found.

    Args:
        parameters: By name, physical values, fixed ones included.
        cost_mean: Mean cost of the final evaluation episodes.
        cost_per_episode: Of each of them.
        start_cost_mean: Mean cost of the start values on the same episodes; None without any, and
            for runs of the command line.
        env_steps: Spent on tuning.
        folder: The run folder, with everything that was logged.
        record: The content of `result.json`: metrics, violations, the gate's verdict, times.
        task: What was tuned; None if it is to be found again from the folder.
    """

    parameters: dict[str, Any]
    cost_mean: float
    cost_per_episode: list[float]
    start_cost_mean: float | None
    env_steps: int
    folder: Path
    record: Mapping[str, Any] = field(repr=False)
    task: Task | None = field(default=None, repr=False)

    @property
    def history(self) -> pd.DataFrame:
        """The rows of `metrics.jsonl`."""
        import pandas as pd

        return pd.DataFrame(records.read_metrics(self.folder))

    def controller(self) -> TunedController:
        """Return the tuned controller: `action = controller(observation)`, and `reset()`.

        Raises:
            RunFolderError: If the task is not known and cannot be built from the folder.
        """
        return TunedController(self.task or task_of_run(self.folder), self.parameters)

    def export(self, path: str | Path) -> Path:
        """Write the parameters as `.yaml`, `.json`, `.h` (C) or `.m` (MATLAB); return the path.

        Raises:
            ConfigError: If the suffix is none of these, or the file cannot be written; see
                `zoac.export.export`.
        """
        units = {p["name"]: p["unit"] for p in records.read_run(self.folder)["parameters"]}
        return export(self.parameters, path, units)


def load_result(folder: str | Path, task: Task | None = None) -> Result:
    """Return the result of a finished run, by `zoac.tune` or the command line.

    Args:
        folder: The run folder. It may hold a pickle, as checkpoints do: load only what you trust.
        task: What was tuned, where it cannot be found again from the folder.

    Raises:
        RunFolderError: If there is no finished run, or it does not say which parameters were fixed
            and its task cannot be built.
    """
    folder = Path(folder)
    record = records.read_result(folder)
    return result_of(record, _fixed_parameters(folder, task), folder, task)


def _fixed_parameters(folder: Path, task: Task | None) -> Mapping[str, float]:
    """Return the parameters that a run did not tune, by name."""
    run = records.read_run(folder)
    if "fixed" in run:
        return run["fixed"]
    noted = run["config"]["task"]
    if TARGET not in noted:  # a task that was no YAML file
        return noted.get("fixed", {})
    return (task or task_of_run(folder)).fixed  # a run of before `run.json` had them


def result_of(
    record: Mapping[str, Any],
    fixed: Mapping[str, float],
    folder: Path,
    task: Task | None,
) -> Result:
    """Return the result of a run whose `result.json` holds `record`."""
    return Result(
        parameters={**record["parameters"], **fixed},
        cost_mean=record["cost_mean"],
        cost_per_episode=record["cost_per_episode"],
        start_cost_mean=record.get("start_cost_mean"),
        env_steps=record["env_steps"],
        folder=folder,
        record=record,
        task=task,
    )


def task_of_run(folder: Path) -> Task:
    """Return the task that a run tuned, from its folder.

    Raises:
        RunFolderError: If it cannot be built.
    """
    import cloudpickle

    pickled = folder / records.TASK
    try:
        if pickled.is_file():
            return cloudpickle.loads(pickled.read_bytes())
        config = records.read_run(folder)["config"]
        if TARGET in config["task"]:
            return task_from_config(config)
        reason = "it could not be pickled"
    except Exception as error:  # whatever the modules that it needs raise
        reason = f"{type(error).__name__}: {error}"
    raise RunFolderError(
        f"{folder}: the task cannot be had from the run folder ({reason}); give it to load_result"
    )


def keep_task(task: Task, folder: Path) -> None:
    """Write the task beside its run, if it can be pickled."""
    import cloudpickle

    try:
        content = cloudpickle.dumps(task)
    except Exception as error:  # an environment may hold anything
        print(f"{folder}: the task is not kept: {error}", file=sys.stderr)
        return
    records.write_atomically(folder / records.TASK, content)
