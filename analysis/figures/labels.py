"""Names for people to read; whatever is not listed here goes by its own name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from zoac.analysis.data.runs import REGULARISED, Method, Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TUNERS = {
    "zoac": "ZOAC",
    "zoac_plus": "ZOAC+",
    "bo": "BO",
    "cmaes": "CMA-ES",
    "cmaes_full": "CMA-ES (full, mean)",
    "cmaes_plus": "CMA-ES+",
    "es": "ES",
    "random": "Random search",
    "nominal": "Nominal",
}
TASKS = {
    "pid_acc": "PID-ACC",
    "pid_acc_code": "PID-ACC (authors' cost)",
    "mpc_tracking": "MPC-Tracking",
    "mpc_tracking_reg": "MPC-Tracking (w/ reg)",
    "PidLoop": "PID loop",
    "lqr": "LQR",
    "pendulum": "Pendulum",
    "lane_change": "Lane change",
}
VARIANTS = {"authors_code": "(authors' code)"}
METRICS = {
    "cost_mean": "Cumulative cost",
    "prediction_error": "Prediction error",
    "env_steps": "Environment steps",
    "wall_seconds": "Wall time [s]",
    "compute_seconds": "Compute time [s]",
}


def family(task: str) -> tuple[str, str]:
    """Return a task and its regularised twin: the same evaluation, another cost for the tuner."""
    base = task.removesuffix(REGULARISED)
    return base, base + REGULARISED


def tuner_names(runs: Iterable[Run]) -> dict[str, str]:
    """Return the names that run.json gives tuners, by tuner."""
    named = ((run.method.tuner, run.identity.get("tuner_name")) for run in runs)
    return {tuner: str(name) for tuner, name in named if name}


def method_labels(
    methods: Iterable[Method], names: Mapping[str, str] | None = None
) -> dict[Method, str]:
    """Return a short label for each of the methods of one family, told apart by what differs.

    Tuners have the names that they call themselves, see `tuner_names`, or those known here.
    """
    methods, names = list(methods), TUNERS | dict(names or {})
    labels = {}
    for method in methods:
        label = names.get(method.tuner, method.tuner)
        if method.task.endswith(REGULARISED):
            label += " (w/ reg)"
        if stands_apart(method, methods):
            label += " " + VARIANTS.get(str(method.variant), f"[{method.variant}]")
        labels[method] = label
    return labels


def stands_apart(method: Method, methods: Iterable[Method]) -> bool:
    """Tell whether a method must be told from others of its tuner by its variant.

    A controller that was not tuned is the same in every variant of one task.
    """
    if method.tuner == "nominal":
        methods = (m for m in methods if (m.tuner, m.task) == (method.tuner, method.task))
    return bool(method.variant) and len({m.variant for m in methods}) > 1


def unit_label(name: str, unit: str) -> str:
    """Return "m [kg]", or the name alone for a pure number."""
    return f"{name} [{unit.replace('^2', '²')}]" if unit else name


def needs_log(values: np.ndarray) -> bool:
    """Tell whether an axis of these values is logarithmic; only finite ones count."""
    values = values[np.isfinite(values)]
    return bool(values.size and values.max() > 20 * values.min() > 0)


def big_axis(axes: Axes, label: str) -> None:
    """Label the x axis; large numbers are shown in powers of ten."""
    axes.ticklabel_format(axis="x", scilimits=(-4, 4), useMathText=True)
    axes.set_xlabel(label)
