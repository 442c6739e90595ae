"""A user's own code that follows a run: `zoac.tune(..., callbacks=[...])`."""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from zoac.core.errors import CallbackError, ConfigError, as_text


class Callback:
    """Follows a run and may stop it; a subclass overrides the methods that it needs.

    Rows are those of `metrics.jsonl`. A run that was interrupted and goes on first passes the rows
    that it has already, so that a callback knows what it would know without the interruption.
    """

    def on_start(self, run: Mapping[str, Any]) -> None:
        """Take the content of `run.json` before the first step; forget any earlier run."""

    def on_iteration(self, row: Mapping[str, Any]) -> bool | None:
        """Take the row of an iteration, after the tuner has learnt from it.

        Returns:
            False to stop the run.
        """

    def on_evaluation(self, row: Mapping[str, Any]) -> bool | None:
        """Take the row of an evaluation; the last one has `row["final"]`.

        Returns:
            False to stop the run.
        """

    def on_end(self, result: Mapping[str, Any]) -> None:
        """Take the content of `result.json`; not called if the run is interrupted or fails."""


class Callbacks:
    """The callbacks of one run, in their order."""

    def __init__(self, callbacks: Sequence[Callback] = ()) -> None:
        """
        Raises:
            ConfigError: If something in `callbacks` is no `Callback`.
        """
        self.stopped_by: str | None = None
        """Class of the first callback that returned False."""
        if not isinstance(callbacks, Sequence):
            raise ConfigError(f"callbacks={callbacks!r}: expected a list of callbacks")
        self._callbacks = list(callbacks)
        for index, callback in enumerate(self._callbacks):
            if not isinstance(callback, Callback):
                made = inspect.isclass(callback) and issubclass(callback, Callback)
                remedy = f"; give an instance: {callback.__name__}()" if made else ""
                raise ConfigError(
                    f"callbacks[{index}]={callback!r}: expected an instance of a subclass of "
                    f"zoac.Callback{remedy}"
                )

    def start(self, run: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
        """Begin a run, or go on with one that has `rows` already."""
        self._call("on_start", run)
        for row in rows:
            self.row(row)

    def row(self, row: Mapping[str, Any]) -> None:
        """Pass on the row of an iteration or an evaluation."""
        self._call("on_iteration" if row["kind"] == "train" else "on_evaluation", row)

    def end(self, result: Mapping[str, Any]) -> None:
        """Pass on the result."""
        self._call("on_end", result)

    def _call(self, method: str, content: Mapping[str, Any]) -> None:
        for callback in self._callbacks:
            name = type(callback).__name__
            try:
                # A copy: what a callback changes in it is nobody else's.
                told = getattr(callback, method)(deepcopy(dict(content)))
            except Exception as error:
                raise CallbackError(
                    f"the callback {name} raised in {method}: {as_text(error)}"
                ) from error
            stops = isinstance(told, bool | np.bool_) and not told
            if stops and self.stopped_by is None:
                self.stopped_by = name
