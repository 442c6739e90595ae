"""What tuning found, and the task that it was found on, from a run folder."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cloudpickle

from zoac.config import factory
from zoac.config.validate import TARGET
from zoac.core.errors import RunFolderError, as_text
from zoac.core.state import pickled
from zoac.rollout.task import Task
from zoac.runs import responses, schema
from zoac.runs.export import TunedController, export, export_c
from zoac.runs.foreign_code import foreign_code
from zoac.runs.loggers.summary import as_html, shown
from zoac.specs import verdict
from zoac.specs.verdict import OF_A_SPEC

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Result:
    """What tuning found.

    Args:
        parameters: By name, physical values, fixed ones included.
        cost_mean: Mean cost of the final evaluation episodes.
        cost_per_episode: Of each of them.
        baseline_cost_mean: Mean cost of the baseline values on the same episodes; None without any.
        warnings: What is wrong with the answer, one sentence each: it costs more than the
            baseline, it breaks a constraint, an earlier evaluation was clearly better.
        env_steps: Spent on tuning.
        folder: The run folder, with everything that was logged.
        record: The content of `result.json`: metrics, violations, acceptance test, times.
        task: What was tuned; None if it is to be found again from the folder.
        trust_code: Whether that may load code that the folder names or holds.
        finished: False after an interruption: `parameters` are then the recommendation so far, and
            costs and metrics are those of the last evaluation before it.
    """

    parameters: dict[str, Any]
    cost_mean: float
    cost_per_episode: list[float]
    baseline_cost_mean: float | None
    warnings: list[str]
    env_steps: int
    folder: Path
    record: Mapping[str, Any] = field(repr=False)
    task: Task | None = field(default=None, repr=False)
    trust_code: bool = field(default=False, repr=False)
    finished: bool = True

    @property
    def specs(self) -> pd.DataFrame:
        """What became of each spec in the final evaluation episodes.

        Returns:
            Columns `spec`, `limit`, `baseline` (the value with the baseline values), `value` and
            `met` (None for an objective); a row each, none without specs.
        """
        import pandas as pd

        return pd.DataFrame(self._spec_rows, columns=list(verdict.COLUMNS))

    @property
    def _spec_rows(self) -> list[dict[str, Any]]:
        return [verdict.restored(row) for row in self.record.get("specs", [])]

    @property
    def feasible(self) -> bool:
        """Whether the answer keeps every hard spec and constraint, at a finite cost."""
        unmet = any(row["met"] is False for row in self.record.get("specs", []))
        by_constraint = self.record.get("violations_by_constraint", {})
        broken = any(found["episodes"] for found in by_constraint.values())
        return not (unmet or broken) and all(map(math.isfinite, self.cost_per_episode))

    @property
    def responses(self) -> pd.DataFrame:
        """The signals of a final episode, with the baseline values and the answer.

        The episode is the one that decides: the worst one for a spec `over="worst"`, of several
        specs for that which has the least reserve. Without such specs it is the first.

        Returns:
            Columns `parameters` ("baseline" or "tuned"), `time` [s] and one per signal.

        Raises:
            RunFolderError: If the task has no signals.
        """
        return responses.read(self.folder)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return a figure of the signals over seconds, before and after, with limits drawn in.

        Args:
            path: Where to save it as well: `.png`, `.svg`, `.pdf`.

        Raises:
            ConfigError: If Matplotlib does not write such a file, or the file cannot be written.
            RunFolderError: If the task has no signals.
        """
        figure = responses.plot(self.folder, self.record)
        if path is not None:
            responses.save(figure, path)
        return figure

    def __repr__(self) -> str:
        """Return some lines for a terminal: cost, parameters and specs, before and after."""
        study, count = "experiments" in self.record, len(self.cost_per_episode)
        word = "experiment" if study else "episode"
        cost = f"cost {self.cost_mean:.4g} over {count} {word}{'' if count == 1 else 's'}"
        if self.baseline_cost_mean is not None:
            cost += f", baseline values {self.baseline_cost_mean:.4g}"
        values = ", ".join(f"{name}={shown(value)}" for name, value in self.parameters.items())
        told = [f"<zoac result: {cost}" + ("" if self.finished else ", stopped early")]
        told += _wrapped(values)
        told += [f"  {line}" for line in verdict.lines(self._spec_rows)]
        for sentence in self.warnings:
            if not sentence.startswith(OF_A_SPEC):  # which has its line already
                told += _wrapped(f"WARNING: {sentence}")
        unit = "experiments" if study else "steps"
        return "\n".join([*told, f"  {self.env_steps:,} {unit}, {self.folder}>"])

    def _repr_html_(self) -> str:
        """Return a table for a notebook: parameters, cost and specs, before and after."""
        fixed = {k: v for k, v in self.parameters.items() if k not in self.record["parameters"]}
        return as_html(self.record, schema.read_run(self.folder), fixed)

    @property
    def history(self) -> pd.DataFrame:
        """The rows of `metrics.jsonl`, `kind` "train" or "eval", at their `env_steps`.

        `history.plot()` draws the learning curve: the cost of the evaluations over the steps.
        """
        from zoac.runs.loggers.history import History

        rows = schema.read_metrics(self.folder)
        return History(rows, index=[row["env_steps"] for row in rows])

    def controller(self) -> TunedController:
        """Return the tuned controller: `action = controller(observation)`, and `reset()`.

        Raises:
            RunFolderError: If the task is not known, and cannot be built from the folder or needs
                code that is not trusted.
        """
        return TunedController(self._known_task(), self.parameters)

    def _known_task(self) -> Task:
        return self.task or task_of_run(self.folder, trust_code=self.trust_code)

    def export(self, path: str | Path) -> Path:
        """Write the parameters as `.yaml`, `.json`, `.h` (C) or `.m` (MATLAB); return the path.

        With `.c`, write the controller itself, if it is an MPC: see `zoac.mpc.Mpc.export`.

        Raises:
            ConfigError: If the suffix is none of these, the controller has no form in C, or the
                file cannot be written; see `zoac.runs.export.export`.
            RunFolderError: If `.c` needs a task that is not known; see `controller`.
        """
        if Path(path).suffix == ".c":
            return export_c(self._known_task(), self.parameters, path)
        units = {p["name"]: p["unit"] for p in schema.read_run(self.folder)["parameters"]}
        return export(self.parameters, path, units)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 80, initial_indent="  ", subsequent_indent="    ")


def load_result(
    folder: str | Path, task: Task | None = None, *, trust_code: bool = False
) -> Result:
    """Return the result of a finished run, by `zoac.tune` or the command line.

    This reads numbers and text. Only `Result.controller` needs the task.

    Args:
        folder: The run folder.
        task: What was tuned, where it cannot be found again from the folder.
        trust_code: Let `Result.controller` load modules that the folder names, and the pickle that
            it may hold. Either can run any code: only for folders of people whom you trust.

    Raises:
        RunFolderError: If there is no finished run.
    """
    folder = Path(folder).expanduser()
    record, run = schema.read_result(folder), schema.read_run(folder)
    return result_of(record, run["fixed"], folder, task, trust_code)


def result_of(
    record: Mapping[str, Any],
    fixed: Mapping[str, float],
    folder: Path,
    task: Task | None,
    trust_code: bool = False,
) -> Result:
    """Return the result of a run whose `result.json` holds `record`."""
    return Result(
        parameters={**record["parameters"], **fixed},
        cost_mean=record["cost_mean"],
        cost_per_episode=record["cost_per_episode"],
        baseline_cost_mean=record.get("baseline_cost_mean"),
        warnings=record["warnings"],
        env_steps=record["env_steps"],
        folder=folder,
        record=record,
        task=task,
        trust_code=trust_code,
        finished=record.get("finished", True),
    )


def task_of_run(
    folder: Path, config: Mapping[str, Any] | None = None, *, trust_code: bool = False
) -> Task:
    """Return the task that a run tuned: from its configuration, or from the pickle that it kept.

    Args:
        folder: The run folder.
        config: The run's configuration, if it is known.
        trust_code: Whether that may load code that is not zoac's own.

    Raises:
        RunFolderError: If it cannot be built, or needs code that is not trusted.
    """
    if config is None:
        config = schema.read_run(folder)["config"]
    by_config, kept = TARGET in config["task"], folder / schema.TASK
    if not by_config and not kept.is_file():
        raise _not_built(folder, "it could not be pickled")
    needed = foreign_code(config["task"]) if by_config else [f"the pickle {kept.name}"]
    if needed and not trust_code:
        raise RunFolderError(
            f"{folder}: its task would load code that is not zoac's own ({', '.join(needed)}). "
            "Such code can do anything. If you trust who wrote it, allow it: trust_code=True in "
            "load_result, --trust-code at a command"
        )
    try:
        return factory.build_task(config) if by_config else cloudpickle.loads(kept.read_bytes())
    except Exception as error:  # whatever the modules that it needs raise
        raise _not_built(folder, as_text(error)) from error


def _not_built(folder: Path, reason: str) -> RunFolderError:
    return RunFolderError(
        f"{folder}: its task cannot be built again ({reason}); give it to load_result"
    )


def keep_task(task: Task, folder: Path) -> None:
    """Write the task beside its run, if it can be pickled."""
    try:
        content = pickled(task)
    except Exception as error:  # an environment may hold anything
        print(f"{folder}: the task is not kept: {error}", file=sys.stderr)
        return
    schema.write_atomically(folder / schema.TASK, content)
