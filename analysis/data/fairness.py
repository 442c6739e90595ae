"""Checks that runs may be averaged or compared; the errors name the keys that differ."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from zoac.analysis.data.runs import Method, Run, by_method, variants
from zoac.config.settings import CHANGES_THE_METHOD
from zoac.core.errors import RunFolderError
from zoac.runs.schema import differing_keys

WITHOUT_TUNING = ("budget", "num_envs", "eval_every")
"""Keys without meaning for a controller that was not tuned."""

OF_TUNER = ("tuner", *CHANGES_THE_METHOD)
"""Keys in which compared methods may differ."""


def unmixed(runs: Iterable[Run]) -> dict[Method, list[Run]]:
    """Return runs by method, seeds in order.

    Raises:
        RunFolderError: If runs of a method differ in their configuration, see `refuse_mixed`.
    """
    groups = by_method(runs)
    for group in groups.values():
        refuse_mixed(group)
    return groups


def refuse_mixed(runs: Sequence[Run]) -> None:
    """Check that runs of a method differ only in the seed and in settings without effect.

    Raises:
        RunFolderError: If they do; the message names each key, its values and their seeds.
    """
    mixed = _differences([(f"seed {run.seed}", _settings(run, "seed")) for run in runs])
    if mixed:
        raise RunFolderError(
            f"the runs of {runs[0].method} differ in their configuration and do not go together:"
            f"{mixed}\nset one group apart with variant=NAME, or move it to another folder"
        )


def refuse_unequal(runs: Sequence[Run], *, any_budget: bool = False) -> None:
    """Check that runs to be compared solved the same problem under the same budget.

    Tuners may differ. Tasks may differ if there are several. A controller that was not tuned has no
    budget. What `fidelity` says stands again in the task and the tuner that follow it.

    Args:
        runs: The runs.
        any_budget: Whether budgets may differ.

    Raises:
        RunFolderError: If they differ in anything else.
    """
    several = len({run.method.task for run in runs}) > 1
    ignored = ("seed", "fidelity", *OF_TUNER, *(["task", "code"] if several else []))
    named = [(str(run.method), _settings(run, *ignored, *WITHOUT_TUNING)) for run in runs]
    budgets = [
        (str(run.method), {key: run.config.get(key) for key in WITHOUT_TUNING})
        for run in runs
        if run.tuned and not any_budget
    ]
    mixed = _differences(named) + _differences(budgets)
    if mixed:
        terms = "" if any_budget else " under the same budget"
        told = variants(run for run in runs if run.tuned)
        hint = f"\nchoose with --variant: {', '.join(told)}" if len(told) > 1 else ""
        raise RunFolderError(
            f"these runs did not solve the same problem{terms} and are not compared:{mixed}{hint}"
        )


def _settings(run: Run, *ignored: str) -> dict[str, Any]:
    """Return the configuration without some keys, and without the solver: the task names it too."""
    return {k: v for k, v in run.config.items() if k not in (*ignored, "mpc_solver")}


def _differences(configs: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """Return one line per differing key with its values and the owners of each value."""
    changes = [(name, differing_keys(configs[0][1], config)) for name, config in configs]
    reference = {key: pair[0] for _, change in changes for key, pair in change.items()}
    lines = []
    for key, first in sorted(reference.items()):
        owners: dict[str, list[str]] = {}
        for name, change in changes:
            _, value = change.get(key, (first, first))
            owners.setdefault(str(value), []).append(name)
        shown = "; ".join(f"{v} in {', '.join(dict.fromkeys(o))}" for v, o in owners.items())
        lines.append(f"\n  {key}: {shown}")
    return "".join(lines)
