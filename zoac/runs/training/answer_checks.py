"""Warnings about the answer of a run, such as that the baseline was better."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from zoac.algorithm.strategies.held_specs import MIN_EPISODES
from zoac.algorithm.strategies.paired_comparison import MIN_PAIRS, clearly_higher
from zoac.core.parameters import Parameter
from zoac.core.types import bad_is_infinite
from zoac.specs.verdict import OF_A_SPEC

CLEAR = 0.02
"""Part of its cost by which an earlier evaluation must be better to be worth a warning."""

EDGE = 0.02
"""Part of a range in which changes of a parameter are too small for most tuners to find."""


def warnings(
    result: Mapping[str, Any],
    evaluations: Sequence[Mapping[str, Any]],
    parameters: Sequence[Parameter] = (),
) -> list[str]:
    """Return what is wrong with the answer of a run, one sentence each; [] if nothing is.

    Args:
        result: The content of `result.json`.
        evaluations: Rows of the evaluations while tuning.
        parameters: What was tuned.
    """
    return [
        *_of_the_cost(result),
        *_of_failures(result),
        *_of_the_start(result),
        *_of_constraints(result),
        *(unmet := _of_specs(result)),
        *(_of_ranges(result["parameters"], parameters) if unmet else []),
        *_of_held_specs(result),
        *_of_evaluations(result, evaluations),
        *_of_the_acceptance_test(result),
    ]


def _of_the_cost(result: Mapping[str, Any]) -> Iterator[str]:
    finite = np.isfinite(np.asarray(result["cost_per_episode"]))
    if not finite.all():
        yield f"The cost is not finite in {(~finite).sum()} of {len(finite)} final episodes."


def _of_failures(result: Mapping[str, Any]) -> Iterator[str]:
    failed, episodes = result.get("failed_episodes"), len(result["cost_per_episode"])
    if failed is not None:
        yield (
            f"The answer failed in {failed['count']} of {episodes} final episodes. The first: "
            f"{failed['first']}"
        )


def _of_the_start(result: Mapping[str, Any]) -> Iterator[str]:
    start = result.get("baseline")
    if start is None:
        return
    costs, episodes = result["cost_per_episode"], len(result["cost_per_episode"])
    # Feasibility first: a baseline that breaks more requirements is not better, however cheap.
    safer = result.get("violations", 0) < start.get("violations", 0)
    if not safer and clearly_higher(np.array(costs), np.array(start["cost_per_episode"])):
        yield (
            f"The answer is worse than the baseline values: cost {result['cost_mean']:.4g} instead "
            f"of {start['cost_mean']:.4g} on the same {episodes} final episodes."
        )
    for what, count, before in (
        ("terminates", result["terminations"], start["terminations"]),
        (_requirement(result), result.get("violations", 0), start.get("violations", 0)),
    ):
        if count > before:
            yield (
                f"The answer {what} more often than the baseline values: in {count} of {episodes} "
                f"final episodes instead of {before}."
            )


def _requirement(result: Mapping[str, Any]) -> str:
    """Return what `violations` counts."""
    kinds = {"by_spec": "a hard spec", "violations_by_constraint": "a constraint"}
    told = [kind for key, kind in kinds.items() if key in result]
    return f"breaks {' or '.join(told)}"


def _of_constraints(result: Mapping[str, Any]) -> list[str]:
    episodes = len(result["cost_per_episode"])
    return [
        f"The constraint {name} is broken in {broken['episodes']} of {episodes} final episodes."
        for name, broken in result.get("violations_by_constraint", {}).items()
        if broken["episodes"]
    ]


def _of_specs(result: Mapping[str, Any]) -> list[str]:
    episodes = len(result["cost_per_episode"])
    return [
        f"{OF_A_SPEC} {row['spec']} {row['limit']} is not met: {row['value']:.4g}, broken in "
        f"{row['broken']} of {episodes} final episodes."
        for row in result.get("specs", [])
        if row["met"] is False
    ]


def _of_held_specs(result: Mapping[str, Any]) -> Iterator[str]:
    held = result.get("held_specs")
    if held is not None and held["episodes"] < MIN_EPISODES and result.get("violations", 0):
        yield (
            f"Only {held['episodes']} held-out episode(s) chose among answers by the hard specs, "
            "where luck decides: give more experiments."
        )


def _of_ranges(values: Mapping[str, Any], parameters: Sequence[Parameter]) -> list[str]:
    """Say, where a spec is not met, which values the search may have been too coarse for."""
    return [
        f"{p.name}={values[p.name]:.4g} lies at the edge of its range {p.low:g} to {p.high:g}, "
        "where small changes are hard to find: give a range around it, or a log scale."
        for p in parameters
        if p.kind == "real" and p.scale == "linear"
        if not EDGE <= (values[p.name] - p.low) / (p.high - p.low) <= 1.0 - EDGE
    ]


def _of_evaluations(
    result: Mapping[str, Any], evaluations: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    """Compare with the best evaluation on the episodes that both have, the first ones.

    One that broke requirements as often has no cost to compare: it may have broken them by more.
    """
    end = np.array(result["cost_per_episode"])
    rows = [
        row
        for row in evaluations
        if row["x"] != result["x"] and (_broken(row) < _broken(result) or not _broken(row))
    ]
    if not rows:
        return
    best = min(rows, key=lambda row: (row.get("violations", 0), bad_is_infinite(row["cost_mean"])))
    shared = min(len(end), len(best["cost_per_episode"]))
    costs = np.array(best["cost_per_episode"][:shared])
    if shared == 1 and (end != end[0]).any():  # one episode of several kinds
        return
    if clearly_higher(end[:shared], costs, comparisons=len(rows), noteworthy=CLEAR):
        yield (
            f"An earlier evaluation, after {best['env_steps']:,} steps, was clearly better: cost "
            f"{costs.mean():.4g} instead of {end[:shared].mean():.4g} on the same {shared} "
            "episodes; select=best_evaluated chooses among them."
        )


def _broken(row: Mapping[str, Any]) -> float:
    """Return in which part of the episodes requirements were broken."""
    return float(row.get("violations", 0) / len(row["cost_per_episode"]))


def _of_the_acceptance_test(result: Mapping[str, Any]) -> Iterator[str]:
    test = result.get("acceptance_test")
    if test is None or test["candidate_is_start"]:
        return
    if test["p_value"] is None:
        yield f"The answer is the baseline values: {test['text']}."
    elif test["pairs"] < MIN_PAIRS:
        yield (
            f"The acceptance test had {test['pairs']} pairs of episodes and fewer than {MIN_PAIRS} "
            "accept nothing, so the answer is the baseline values: give acceptance_test or budget "
            "more steps."
        )
