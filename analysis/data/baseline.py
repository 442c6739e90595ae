"""What a tuned controller is compared with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.analysis.data.runs import Run
from zoac.analysis.statistics.intervals import Interval, Scores, paired_difference
from zoac.core.seeding import stream


@dataclass(frozen=True, eq=False)
class Before:
    """A controller before tuning.

    Args:
        what: What it is, for people to read.
        parameters: By name; None if they are not known.
        costs: (E,) in the first E final evaluation episodes of the run.
    """

    what: str
    parameters: Mapping[str, Any] | None
    costs: np.ndarray

    def difference(self, run: Run) -> Interval | None:
        """Return the mean cost of `run` minus this one's in the same episodes, with its interval.

        None if a cost is not finite. The interval is over episodes alone: it is of this one run.
        """
        costs = run.costs[: len(self.costs)]
        if not np.isfinite([*costs, *self.costs]).all():
            return None
        rng = stream(0, f"report {run.method} {run.seed}")
        return paired_difference(
            Scores(costs[None], tuned=False), Scores(self.costs[None], tuned=False), rng
        )


def before(run: Run, reference: Run | None = None) -> Before | None:
    """Return what `run` is compared with: its baseline values, else `reference`, else its start.

    Args:
        run: A finished run.
        reference: A run that was not tuned.
    """
    if (found := baseline_values(run)) is not None:
        return found
    if reference is not None and reference is not run and len(reference.costs) == len(run.costs):
        parameters = reference.outcome["parameters"]
        return Before("nominal controller", parameters, reference.costs)
    if run.start is not None:
        costs = run.evaluations[0]["cost_per_episode"]
        return Before("start of tuning", run.start, np.array(costs, float)[: len(run.costs)])
    return None


def baseline_values(run: Run) -> Before | None:
    """Return the baseline values of `run`.

    None if it has none, if a cost of theirs is not finite, or if they met other episodes.
    """
    result = run.outcome
    record = result.get("baseline") or {"cost_mean": result.get("baseline_cost_mean")}
    costs = record.get("cost_per_episode") or [record["cost_mean"]]
    known = np.array(costs, float)
    if len(known) != len(run.costs) or not np.isfinite(known).all():
        return None
    return Before("baseline values", run.identity["nominal"], known)
