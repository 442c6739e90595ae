"""TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoac.errors import ConfigError
from zoac.sinks.numbers import numbers


class TensorBoard:
    """One event file per run, below `folder`."""

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

    def start(self, run: Mapping[str, Any]) -> None:
        """Open the event file."""
        parts = [str(run[k]) for k in ("task", "tuner", "seed", "variant") if run[k] is not None]
        self._writer = self._writer_class(str(self._folder.joinpath(*parts)))

    def row(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers at its environment steps."""
        for name, value in numbers(row).items():
            self._writer.add_scalar(f"{row['kind']}/{name}", value, row["env_steps"])

    def finish(self, result: Mapping[str, Any]) -> None:
        """Close the file."""
        self._writer.close()
