"""What a study is: its parameters, its tuner and how many experiments it may ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from zoac.config.files import configuration
from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.types import is_number
from zoac.runs import schema
from zoac.specs.spec import Spec
from zoac.specs.trace import as_plain, from_plain
from zoac.tasks.user_space import parse_space

TUNERS = ("bo", "cmaes", "cmaes_full", "es", "halving", "nevergrad", "nominal", "optuna", "random")
"""Tuners that need no more of an experiment than its cost."""

BO_EXPERIMENTS, BO_DIMENSION = 200, 4
"""Up to here `auto` is Bayesian optimisation; beyond, CMA-ES, which failures mislead less."""


@dataclass(frozen=True)
class StudySettings:
    """Everything that the parameters of a study's experiments depend on, beside their results.

    Args:
        space: What is tuned.
        fixed: Parameters that are not, by name.
        baseline: Values in use today; None if there are none.
        limits: Of constraints, by name.
        specs: By which a trace is judged.
        tuner: Name of the tuner's configuration.
        node: The tuner's configuration.
        experiments: How many.
        seed: Of everything random.
        workers: Experiments that the tuner plans side by side.
        baseline_first: Whether the baseline is the first experiment.
        acceptance_test: Fraction of the experiments for it, or None.
        initial_sigma: See `zoac.tune`.
        initial_samples: See `zoac.tune`.
    """

    space: ParameterSpace
    fixed: dict[str, Any]
    baseline: dict[str, Any] | None
    limits: dict[str, float]
    specs: tuple[Spec, ...]
    tuner: str
    node: dict[str, Any]
    experiments: int
    seed: int
    workers: int
    baseline_first: bool
    acceptance_test: float | None
    initial_sigma: float | None
    initial_samples: int | None

    def config(self) -> dict[str, Any]:
        """Return the settings as JSON holds them, in the layout of a run's configuration."""
        given = {
            "task": {
                "space": [asdict(p) for p in self.space.parameters],
                "fixed": self.fixed,
                "baseline": self.baseline,
                "limits": self.limits,
                "specs": [as_plain(spec) for spec in self.specs],
            },
            "tuner": self.node,
            "seed": self.seed,
            "budget": self.experiments,
            "num_envs": self.workers,
            "baseline_first": self.baseline_first,
            "acceptance_test": self.acceptance_test,
            "initial_sigma": self.initial_sigma,
            "initial_samples": self.initial_samples,
        }
        plain: dict[str, Any] = schema.plain(given)
        return plain


def from_config(config: Mapping[str, Any], tuner: str) -> StudySettings:
    """Return the settings that `StudySettings.config` wrote."""
    task = config["task"]
    parameters = [Parameter(**{**p, "options": tuple(p["options"])}) for p in task["space"]]
    names = ("seed", "baseline_first", "acceptance_test", "initial_sigma", "initial_samples")
    return StudySettings(
        space=ParameterSpace(parameters),
        fixed=task["fixed"],
        baseline=task["baseline"],
        limits=task["limits"],
        specs=tuple(map(from_plain, task["specs"])),
        tuner=tuner,
        node=config["tuner"],
        experiments=config["budget"],
        workers=config["num_envs"],
        **{name: config[name] for name in names},
    )


def new_settings(
    *,
    space: ParameterSpace | Mapping[str, Any],
    tuner: str,
    experiments: int,
    seed: int,
    workers: int,
    baseline: Mapping[str, Any] | None,
    baseline_first: bool,
    constraints: Mapping[str, float] | None,
    specs: Sequence[Spec],
    acceptance_test: float | None,
    initial_sigma: float | None,
    initial_samples: int | None,
    tuner_options: Mapping[str, Any] | None,
) -> StudySettings:
    """Return checked settings; see `zoac.study.study.Study` for the arguments.

    Raises:
        ConfigError: If one of them cannot be used.
    """
    parsed, fixed, values = parse_space(space)
    values = {**values, **(baseline or {})}
    if values:
        parsed.normalise(values)  # says what is wrong with a value
    for name, value, least in (("experiments", experiments, 1), ("seed", seed, 0),
                               ("workers", workers, 1)):  # fmt: skip
        if not is_number(value) or value % 1 or value < least:
            raise ConfigError(f"{name}={value!r}: expected a whole number, {least} or more")
    experiments, workers = int(experiments), int(workers)
    named = _tuner(tuner, parsed.dimension, experiments, workers)
    node = configuration(task=None, tuner=named)["tuner"]
    options = dict(tuner_options or {})
    if values and "start" in node:
        options.setdefault("start", "baseline")
    for key in options:
        known = [k for k in node if not k.startswith("_")]
        if key not in known:
            raise ConfigError(f"tuner {named!r} has no option {key!r}; {suggest(key, known)}")
    return StudySettings(
        space=parsed,
        fixed=fixed,
        baseline=values or None,
        limits=_limits(constraints),
        specs=_specs(specs),
        tuner=named,
        node={**node, **options},
        experiments=experiments,
        seed=int(seed),
        workers=workers,
        baseline_first=baseline_first and bool(values),
        acceptance_test=acceptance_test,
        initial_sigma=initial_sigma,
        initial_samples=initial_samples,
    )


def seconds(name: str, value: Any) -> None:
    """Refuse what is neither None nor a number of seconds above zero."""
    if value is not None and not (is_number(value) and value > 0):
        raise ConfigError(f"{name}={value!r}: expected seconds, above zero, or None")


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


def _specs(specs: Sequence[Spec]) -> tuple[Spec, ...]:
    for spec in specs:
        if not isinstance(spec, Spec):
            raise ConfigError(
                f"specs: {spec!r} is no spec; expected such as zoac.specs.overshoot('y', 'r')"
            )
        as_plain(spec)  # says what is wrong with it
    return tuple(specs)


def _limits(constraints: Mapping[str, float] | None) -> dict[str, float]:
    if not isinstance(constraints, Mapping | None):
        raise ConfigError(f"constraints={constraints!r}: expected limits by name")
    for name, limit in (constraints or {}).items():
        if not is_number(limit) or not math.isfinite(limit):
            raise ConfigError(f"constraint {name!r}: limit={limit!r}, expected a finite number")
    return {name: float(limit) for name, limit in (constraints or {}).items()}
