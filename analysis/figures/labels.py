"""Names for people to read; whatever is not listed here goes by its own name."""

from __future__ import annotations

from collections.abc import Iterable

from zoac.analysis.data.runs import Method

TUNERS = {
    "zoac": "ZOAC",
    "zoac_plus": "ZOAC+",
    "bo": "BO",
    "cmaes": "CMA-ES",
    "cmaes_full": "CMA-ES (full, mean)",
    "es": "ES",
    "random": "Random search",
    "nominal": "Nominal",
}
TASKS = {
    "pid_acc": "PID-ACC",
    "pid_acc_code": "PID-ACC (authors' cost)",
    "mpc_tracking": "MPC-Tracking",
    "mpc_tracking_reg": "MPC-Tracking (w/ reg)",
}
VARIANTS = {"authors_code": "(authors' code)"}
REGULARISED = "_reg"
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


def method_labels(methods: Iterable[Method]) -> dict[Method, str]:
    """Return a short label for each of the methods of one family, told apart by what differs."""
    methods = list(methods)
    several = len({method.variant for method in methods}) > 1
    labels = {}
    for method in methods:
        label = TUNERS.get(method.tuner, method.tuner)
        if method.task.endswith(REGULARISED):
            label += " (w/ reg)"
        if several and method.variant:
            label += " " + VARIANTS.get(method.variant, f"[{method.variant}]")
        labels[method] = label
    return labels


def unit_label(name: str, unit: str) -> str:
    """Return "m [kg]", or the name alone for a pure number."""
    return f"{name} [{unit.replace('^2', '²')}]" if unit else name
