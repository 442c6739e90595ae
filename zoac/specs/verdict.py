"""What evaluation episodes come to by specs, and the table of that in a result."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from zoac.core.segments import Segment
from zoac.specs import guides
from zoac.specs.signals import Episode, Signal
from zoac.specs.spec import Spec

COLUMNS = ("spec", "limit", "baseline", "value", "met")


def over_episodes(segments: Sequence[Segment], specs: Sequence[Spec]) -> dict[str, dict[str, Any]]:
    """Return what whole episodes come to, by the spec's label.

    Returns:
        Of each spec: its `value`, by `over`; whether it is `met`, None without a limit; and in how
        many episodes it is `broken`.
    """
    rows = [segment.spec_values or tuple(spec.worst for spec in specs) for segment in segments]
    found = {}
    for spec, values in zip(specs, zip(*rows, strict=True), strict=True):
        value = spec.over_episodes(values)
        broken = sum(spec.excess(v) > 0 for v in values)
        found[spec.label] = {"value": value, "met": spec.met(value), "broken": broken}
    return found


class Deciding(NamedTuple):
    """The final episode that decides whether the specs are met, for figures.

    Args:
        episode: Its number, from 0.
        spec: The spec that it comes nearest to breaking, or breaks by most; None: no spec decides
            by its worst episode, and this is the first one.
        loop: Of loops side by side the one that decides, from 0.
    """

    episode: int
    spec: Spec | None
    loop: int = 0


def deciding(
    segments: Sequence[Segment], specs: Sequence[Spec], signals: Mapping[str, Signal],
    sample_time: float,
) -> Deciding:  # fmt: skip
    """Return which of whole episodes decides: the worst one for a spec `over="worst"`."""
    found, furthest = Deciding(0, None), -math.inf
    for j, spec in enumerate(specs):
        if not spec.hard or spec.of_loop or spec.over == "mean":
            continue
        for k, segment in enumerate(segments):
            value = segment.spec_values[j] if segment.spec_values else spec.worst
            if (beyond := spec.beyond_limit(value)) > furthest:
                found, furthest = Deciding(k, spec), beyond
    if found.spec is None or not segments[found.episode].spec_values:
        return found
    episode = Episode.of(segments[found.episode], signals, sample_time)
    of_loops = map(found.spec.beyond_limit, found.spec.of_loops(episode))
    return found._replace(loop=int(np.argmax(list(of_loops))))


def rows(
    specs: Sequence[Spec],
    after: Mapping[str, Mapping[str, Any]],
    before: Mapping[str, Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Return what `result.json` holds, one entry per spec, numbers that are not finite included.

    Args:
        specs: Of the task.
        after: What `over_episodes` returned for the answer.
        before: Likewise for the baseline values; empty without any.
    """
    found = []
    for spec in specs:
        old: Mapping[str, Any] = before.get(spec.label, {})
        found.append({
            "spec": str(spec),
            "limit": spec.limit,
            "baseline": old.get("value"),
            "baseline_met": old.get("met"),
            **after[spec.label],
            "bad_side": "low" if spec.worst < 0 else "high",
            "has_baseline": bool(old),
            **guides.plain(spec),
        })  # fmt: skip
    return found


def restored(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of `result.json` with infinity where null stands for it.

    A value that is not finite and keeps its limit lies on the good side, any other on the bad one.
    """
    high_is_bad = row["bad_side"] == "high"
    found = dict(row)
    for key, met in (("value", row["met"]), ("baseline", row["baseline_met"])):
        if found[key] is None and (key == "value" or row["has_baseline"]):
            found[key] = math.inf if high_is_bad != bool(met) else -math.inf
    return found


def lines(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line for people per restored row: spec and limit, value before and after, met?"""
    names = [f"{row['spec']} {row['limit']}".rstrip() for row in found]
    width = min(MAX_NAME, max(map(len, names), default=0))
    told = []
    for row, name in zip(found, names, strict=True):
        values = _marked(row["value"], row["met"])
        if row["baseline"] is not None:
            values = f"{_marked(row['baseline'], row['baseline_met'])} -> {values}"
        shown = name if len(name) <= width else name[: width - 3] + "..."
        told.append(f"{shown:<{width}}  {values}")
    return told


def _marked(value: float, met: bool | None) -> str:
    return f"{value:.4g}{MARKS[met]}"


MARKS = {True: " met", False: " UNMET", None: ""}

OF_A_SPEC = "The spec"
"""How the warning of a broken spec begins."""

MAX_NAME = 44
"""Characters of a spec and its limit, so that a line with both values fits a terminal."""
