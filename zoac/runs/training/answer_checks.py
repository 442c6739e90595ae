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
        *_of_failures(result),
        *_of_the_start(result),
        *_of_requirements(result, parameters),
        *_of_evaluations(result, evaluations),
        *_of_the_acceptance_test(result),
    ]


def _of_failures(result: Mapping[str, Any]) -> Iterator[str]:
    episodes = len(result["cost_per_episode"])
    if bad := episodes - np.isfinite(result["cost_per_episode"]).sum():
        yield f"The cost is not finite in {bad} of {episodes} final episodes."
    if failed := result.get("failed_episodes"):
        yield (
            f"The answer failed in {failed['count']} of {episodes} final episodes. The first: "
            f"{failed['first']}"
        )


def _of_the_start(result: Mapping[str, Any]) -> Iterator[str]:
    start = result.get("baseline")
    if start is None:
        return
    costs, before = (np.array(row["cost_per_episode"]) for row in (result, start))
    # Feasibility first: a baseline that breaks more requirements is not better, however cheap.
    safer = result.get("violations", 0) < start.get("violations", 0)
    if not safer and clearly_higher(costs, before):
        yield (
            f"The answer is worse than the baseline values: cost {result['cost_mean']:.4g} instead "
            f"of {start['cost_mean']:.4g} on the same {len(costs)} final episodes."
        )
    kinds = {"by_spec": "a hard spec", "violations_by_constraint": "a constraint"}
    requirement = " or ".join(kind for key, kind in kinds.items() if key in result)
    for what, key in (("terminates", "terminations"), (f"breaks {requirement}", "violations")):
        if result.get(key, 0) > start.get(key, 0):
            yield (
                f"The answer {what} more often than the baseline values: in {result[key]} of "
                f"{len(costs)} final episodes instead of {start.get(key, 0)}."
            )


def _of_requirements(result: Mapping[str, Any], parameters: Sequence[Parameter]) -> Iterator[str]:
    episodes = len(result["cost_per_episode"])
    for name, broken in result.get("violations_by_constraint", {}).items():
        if broken["episodes"]:
            yield (
                f"The constraint {name} is broken in {broken['episodes']} of {episodes} final "
                "episodes."
            )
    unmet = [row for row in result.get("specs", []) if row["met"] is False]
    for row in unmet:
        yield (
            f"{OF_A_SPEC} {row['spec']} {row['limit']} is not met: {row['value']:.4g}, broken in "
            f"{row['broken']} of {episodes} final episodes."
        )
    for p in parameters if unmet else ():
        value = result["parameters"][p.name]
        if (p.kind, p.scale) == ("real", "linear") and not (
            EDGE <= (value - p.low) / (p.high - p.low) <= 1.0 - EDGE
        ):
            yield (
                f"{p.name}={value:.4g} lies at the edge of its range {p.low:g} to {p.high:g}, "
                "where small changes are hard to find: give a range around it, or a log scale."
            )
    held = result.get("held_specs")
    if held is not None and held["episodes"] < MIN_EPISODES and result.get("violations", 0):
        yield (
            f"Only {held['episodes']} held-out episode(s) chose among answers by the hard specs, "
            "where luck decides: give more experiments."
        )


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
