"""What a study is: its parameters, its tuner and how many experiments it may ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from zoac.config.files import configuration
from zoac.config.settings import Settings, converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.types import is_number
from zoac.runs import schema
from zoac.specs.spec import Spec
from zoac.specs.trace import as_plain, from_plain
from zoac.study.state.trial import numbers
from zoac.tasks.user_space import parse_space
from zoac.tasks.user_specs import specs_of

TUNERS = (
    "bo", "botorch", "cmaes", "cmaes_full", "es", "halving", "nevergrad", "nominal", "optuna",
    "random", "smac",
)  # fmt: skip
"""Tuners that need no more of an experiment than its cost."""

BO_EXPERIMENTS, BO_DIMENSION = 200, 4
"""Up to here `auto` is Bayesian optimisation; beyond, CMA-ES, which failures mislead less."""


class StudySettings:
    """Everything that the parameters of a study's experiments depend on, beside their results."""

    def __init__(self, config: Mapping[str, Any], tuner: str) -> None:
        """
        Args:
            config: Plain data, in the layout of a run's configuration.
            tuner: Name of the tuner's configuration.
        """
        self.config, self.tuner, task = config, tuner, config["task"]
        self.space = ParameterSpace(
            [Parameter(**{**p, "options": tuple(p["options"])}) for p in task["space"]]
        )
        self.fixed: dict[str, Any] = task["fixed"]
        self.baseline: dict[str, Any] | None = task["baseline"]
        self.limits: dict[str, float] = task["limits"]
        self.specs = tuple(map(from_plain, task["specs"]))
        self.experiments: int = config["budget"]
        self.workers: int = config["num_envs"]
        self.baseline_first: bool = config["baseline_first"]
        self.acceptance_test: float | None = config["acceptance_test"]


def new_settings(
    space: ParameterSpace | Mapping[str, Any],
    tuner: str,
    tuner_options: Mapping[str, Any] | None,
    *,
    experiments: int,
    workers: int,
    seed: int,
    baseline: Mapping[str, Any] | None,
    baseline_first: bool,
    constraints: Mapping[str, float] | None,
    specs: Sequence[Spec],
    **others: Any,
) -> StudySettings:
    """Return checked settings; see `zoac.study.study.Study` for the arguments."""
    check_arguments(Settings, converted(Settings, others), "")
    parsed, fixed, values = parse_space(space, baseline)
    limits = numbers(constraints, "constraints")
    given = {"space": fixed, "tuner_options": tuner_options or {}, "constraints": limits}
    _refuse_not_finite(given)
    named = _tuner(tuner, parsed.dimension, experiments, workers)
    node = configuration(task=None, tuner=named)["tuner"]
    options = dict(tuner_options or {})
    if values and "start" in node:
        options.setdefault("start", "baseline")
    for key in options:
        known = [k for k in node if not k.startswith("_")]
        if key not in known:
            raise ConfigError(f"tuner {named!r} has no option {key!r}; {suggest(key, known)}")
    config = {
        "task": {
            "space": [asdict(p) for p in parsed.parameters],
            "fixed": fixed,
            "baseline": values or None,
            "limits": limits,
            "specs": [as_plain(spec) for spec in specs_of(specs)],
        },
        "tuner": {**node, **options},
        "seed": seed,
        "budget": experiments,
        "num_envs": workers,
        "baseline_first": baseline_first and bool(values),
        **others,
    }
    return StudySettings(schema.plain(config), named)


def _tuner(name: str, dimension: int, experiments: int, workers: int) -> str:
    """Return the name of a tuner's configuration that a study can use."""
    if name == "auto":
        few = experiments <= BO_EXPERIMENTS and dimension <= BO_DIMENSION
        if few and workers == 1:
            return "bo"
        return "cmaes" if dimension > 1 else "nevergrad"  # CMA-ES needs two
    if name in ("zoac", "zoac_plus"):
        raise ConfigError(
            f"tuner={name!r} learns from single steps of an episode, and a study has costs of "
            f"whole experiments only; {suggest(name, TUNERS)}"
        )
    return name


def _refuse_not_finite(given: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse numbers that JSON lacks: `schema.plain` would make them None."""
    for of, values in given.items():
        for name, value in values.items():
            if is_number(value) and not math.isfinite(value):
                raise ConfigError(f"{of}[{name!r}]={value!r}: expected a finite number")
