"""Choose the runs that represent their methods in figures of single runs."""

from collections.abc import Sequence

from zoac.analysis.data.fairness import unmixed
from zoac.analysis.data.runs import Collection, Run
from zoac.core.errors import RunFolderError
from zoac.core.types import bad_is_infinite


def chosen(collection: Collection, tuner: str | None = None, seed: int | None = None) -> list[Run]:
    """Return one finished run per method, tuned ones first: `seed`, or the median one in cost.

    Raises:
        RunFolderError: If there is none, or seeds of a method differ in their configuration.
    """
    runs = [r for r in collection.finished if tuner in (None, r.method.tuner)]
    if seed is not None:
        runs = [r for r in runs if r.seed == seed or not r.tuned]
    if not runs:
        wanted = "".join(
            f" with {name} {value!r}" for name, value in (("tuner", tuner), ("seed", seed))
            if value is not None
        )  # fmt: skip
        raise RunFolderError(f"no finished run{wanted}")
    typical = map(median_run, unmixed(runs).values())
    return sorted(typical, key=lambda run: (not run.tuned, run.method.rank))


def median_run(runs: Sequence[Run]) -> Run:
    """Return the run whose final cost is the (lower) median: typical, not the best."""
    ordered = sorted(runs, key=lambda run: (float(bad_is_infinite(run.cost_mean)), run.seed))
    return ordered[(len(ordered) - 1) // 2]
