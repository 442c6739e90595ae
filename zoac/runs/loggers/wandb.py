"""Weights & Biases."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from zoac.runs.loggers.base import numbers


class Wandb:
    """One wandb run per process; offline unless the user's settings say otherwise.

    A run that was stopped and goes on is another wandb run of the same name and group, which begins
    at the last checkpoint. It is not wandb's own resuming, which needs to be online and would mix
    folders that hold the same configuration.
    """

    def __init__(
        self,
        *,
        project: str = "zoac",
        entity: str | None = None,
        mode: Literal["offline", "online", "disabled"] | None = None,
        folder: str | None = None,
    ) -> None:
        """
        Args:
            project: Project name.
            entity: User or team.
            mode: None: the environment's WANDB_MODE, else offline.
            folder: Where wandb keeps its files; None: the current folder.
        """
        self._project, self._entity, self._folder = project, entity, folder
        self._mode = mode or os.environ.get("WANDB_MODE", "offline")

    def start(self, run: Mapping[str, Any]) -> None:
        """Begin a wandb run, named after the identity."""
        import wandb

        if self._folder is not None:
            Path(self._folder).mkdir(parents=True, exist_ok=True)
        identity = [run[k] for k in ("task", "tuner", "seed", "variant")]
        name = "-".join(str(part) for part in identity if part is not None)
        self._run = wandb.init(
            project=self._project,
            entity=self._entity,
            mode=self._mode,  # type: ignore[arg-type]
            dir=self._folder,
            name=name,
            group=f"{run['task']}-{run['tuner']}",
            config=dict(run["config"]),
            settings=wandb.Settings(init_timeout=20, silent=True, console="off"),
        )

    def row(self, row: Mapping[str, Any]) -> None:
        """Log the row's numbers against environment steps."""
        named = {f"{row['kind']}/{k}": v for k, v in numbers(row).items() if k != "env_steps"}
        self._run.log({"env_steps": row["env_steps"], **named})

    def finish(self, result: Mapping[str, Any]) -> None:
        """Write the result into the run's summary and end it."""
        self._run.summary.update(numbers(result))
        self._run.finish()
