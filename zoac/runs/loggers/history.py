"""The rows of a run as a table that draws the learning curve."""

from typing import Any

import pandas as pd


class History(pd.DataFrame):
    """Rows of `metrics.jsonl`, whose `plot()` draws the cost of the evaluations."""

    @property
    def plot(self) -> Any:
        """The learning curve if called without `x` and `y`; otherwise as any table's."""
        return _Plot(pd.DataFrame(self))


class _Plot:
    """`DataFrame.plot` with another drawing for a call without columns."""

    def __init__(self, rows: pd.DataFrame) -> None:
        self._rows = rows

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        if arguments or "y" in options:
            return self._rows.plot(*arguments, **options)
        found = self._rows[self._rows["kind"] == "eval"]
        curve = pd.DataFrame({"cost": found["cost_mean"]}).rename_axis("environment steps")
        return curve.plot(**{"marker": "o", "ylabel": "mean cost", "legend": False, **options})

    def __getattr__(self, kind: str) -> Any:
        return getattr(self._rows.plot, kind)
