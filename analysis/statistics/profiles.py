"""How tuners compare over many problems: scores, performance profiles, who is better how often.

A run's score is (cost - best) / (reference - best). Here best is the lowest cost of all runs on the
problem, and the reference is the median cost of random search with the fewest experiments. So 0 is
the best that is known, and 1 is what a few random experiments give.

Intervals are of the bootstrap over problems and, within each, over seeds.
"""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from zoac.analysis.statistics.intervals import UNKNOWN, Interval
from zoac.core.errors import RunFolderError
from zoac.core.seeding import stream
from zoac.core.types import bad_is_infinite

NEAR = 0.05
"""Score within which a run is near the best."""

RANDOM = "random"
RESAMPLES = 2000
QUANTILES = (0.025, 0.975)


def failures_last(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with infinity for costs that are not finite.

    A run that failed is then worse than any other; as NaN it would count as not run at all.
    """
    return runs.assign(cost=bad_is_infinite(runs["cost"]))


def with_scores(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs with their `score`; a cost that is not finite and its score are infinite.

    Problems without runs of random search are left out, and those on which its few experiments are
    as good as anything or fail mostly, since nothing can be told apart there.

    Args:
        runs: Columns problem, tuner, experiments, seed, cost.

    Raises:
        RunFolderError: If no problem is left.
    """
    parts = []
    for _, group in failures_last(runs).groupby("problem", sort=True):
        best, reference = group["cost"].min(), reference_cost(group)
        if np.isfinite(reference) and reference > best:
            parts.append(group.assign(score=(group["cost"] - best) / (reference - best)))
    if not parts:
        raise RunFolderError(
            f"scores need runs of tuner={RANDOM} that other runs beat; no problem has such runs"
        )
    return pd.concat(parts, ignore_index=True)


def reference_cost(runs: pd.DataFrame) -> float:
    """Return the median cost of random search with the fewest experiments; NaN if not run.

    The runs are those on one problem, as `failures_last` returns them.
    """
    random = runs[runs["tuner"] == RANDOM]
    few = random[random["experiments"] == random["experiments"].min()]
    return float(few["cost"].median())


def share_within(scores: np.ndarray, limits: Sequence[float]) -> np.ndarray:
    """Return the share of scores (N,) at or below each of the limits (L,), each (L,)."""
    return (np.asarray(scores)[:, None] <= np.asarray(limits)[None]).mean(axis=0)


def mean_score(runs: pd.DataFrame) -> Interval:
    """Return the mean score of one tuner with one number of experiments, each score at most 1."""
    table = np.minimum(_by_seed(runs, "score"), 1.0)
    return _interval([table], lambda drawn: drawn[0].mean(axis=(-2, -1)))


def improvement(first: pd.DataFrame, second: pd.DataFrame) -> Interval:
    """Return the probability that a run of the first tuner costs less than one of the second.

    It is the mean over the problems that both have; equal costs count half. Both have runs of one
    tuner with the same number of experiments.
    """
    common = sorted(set(first["problem"]) & set(second["problem"]))
    if not common:
        return UNKNOWN
    tables = [_by_seed(runs[runs["problem"].isin(common)], "cost") for runs in (first, second)]

    def probability(drawn: list[np.ndarray]) -> np.ndarray:
        a, b = drawn[0][..., :, None], drawn[1][..., None, :]
        return ((a < b) + 0.5 * (a == b)).mean(axis=(-3, -2, -1))

    return _interval(tables, probability)


def experiments_needed(runs: pd.DataFrame) -> pd.DataFrame:
    """Return how many experiments bring each tuner near the best: rows problems, columns tuners.

    It is the smallest number with which more than half of its runs score at most `NEAR`; NaN
    where none of those tried does.
    """
    near = runs.assign(near=runs["score"] <= NEAR)
    often = near.groupby(["problem", "tuner", "experiments"])["near"].mean().reset_index()
    enough = often["experiments"].where(often["near"] > 0.5)
    return often.assign(needed=enough).pivot_table(
        index="problem", columns="tuner", values="needed", aggfunc="min", dropna=False
    )


def _by_seed(runs: pd.DataFrame, column: str) -> np.ndarray:
    """Return a table (problems, seeds) of the seeds that all problems have."""
    table = runs.pivot(index="problem", columns="seed", values=column).sort_index()
    whole = table.dropna(axis="columns")
    if whole.empty:
        raise RunFolderError(
            f"{runs['tuner'].iloc[0]} with {runs['experiments'].iloc[0]} experiments: no seed was "
            "run on every problem; launching the sweep again makes what is missing"
        )
    return whole.to_numpy(float)


def _interval(
    tables: Sequence[np.ndarray], statistic: Callable[[list[np.ndarray]], np.ndarray]
) -> Interval:
    """Return a statistic of tables (problems, seeds) with its percentile interval."""
    rng = stream(0, "analysis suite")
    problems = len(tables[0])
    rows = rng.integers(problems, size=(RESAMPLES, problems))[..., None]
    drawn = [
        table[rows, rng.integers(table.shape[1], size=(RESAMPLES, problems, table.shape[1]))]
        for table in tables
    ]
    low, high = np.quantile(statistic(drawn), QUANTILES)
    return Interval(float(statistic(list(tables))), float(low), float(high))
