"""TensorBoard."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoac.core.errors import ConfigError
from zoac.runs.loggers.base import numbers


class TensorBoard:
    """One folder of event files per run, below `folder`.

    Rows come again after a stop, from the last checkpoint on. Each process therefore hides what
    earlier ones wrote at or after the environment steps of its own first row.
    """

    def __init__(self, *, folder: str = "tensorboard") -> None:
        """
        Raises:
            ConfigError: If TensorBoard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise ConfigError(
                "logger=tensorboard needs TensorBoard: pip install 'zoac[tensorboard]'"
            ) from None
        self._writer_class = SummaryWriter
        self._folder = Path(folder)
        self._writer: Any = None

    def start(self, run: Mapping[str, Any]) -> None:
        """Take the run's identity; the event file is opened by the first row."""
        parts = [str(run[k]) for k in ("task", "tuner", "seed", "variant") if run[k] is not None]
        self._folder = self._folder.joinpath(*parts)

    def row(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers at its environment steps."""
        if self._writer is None:
            self._writer = self._writer_class(str(self._folder), purge_step=row["env_steps"])
        for name, value in numbers(row).items():
            self._writer.add_scalar(f"{row['kind']}/{name}", value, row["env_steps"])

    def finish(self, result: Mapping[str, Any]) -> None:
        """Close the file."""
        self._writer.close()
