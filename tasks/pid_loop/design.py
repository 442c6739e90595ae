"""From a plant to an experiment: gains to begin with, how long an episode is, bounds of the gains.

A screening simulates the gains of all rules, weakened and strengthened, and gains read off the
plant's frequency response. The best of them says how fast the loop can be, which fixes the length
of an episode and the middle of the box that is searched.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.specs.spec import Spec
from zoac.tasks.pid_loop.plants import RULES, Design, Gains, gains_of
from zoac.tasks.pid_loop.requirements import OF_THE_STEP
from zoac.tasks.pid_loop.screening import (
    LONGER,
    MAX_STEPS,
    MIN_STEPS,
    candidates,
    experiment_of,
    screened,
)  # fmt: skip
from zoac.tasks.pid_loop.task import PidLoop

WIDTHS = {"Kp": 30.0, "Ki": 2000.0, "Kd": 30.0, "Tf": 30.0}
"""Bounds of a gain: the best screened one divided and multiplied by this. A step of the reference
without overshoot may need a very slow integral; where the plant integrates, hardly any."""


def designed(
    design: Design,
    baseline: str | Mapping[str, float],
    specs: Sequence[Spec] = (),
    objective: str | Spec = "iae",
) -> tuple[PidLoop, list[str]]:
    """Return the task, with its baseline, its bounds and its episode; and what to warn of.

    Args:
        design: What was asked for.
        baseline: A rule, or the present gains by name.
        specs: Hard specs; an episode is long enough to see their settling times exceeded.
        objective: See `PidLoop`.

    Raises:
        ConfigError: If there is no such rule, or the gains cannot be used.
    """
    today, remarks = _today(design, baseline)
    tried = [*([today] if today else []), *candidates(design)]
    best, steps = screened(design, tried)
    settled = round(steps / LONGER)
    today = today or best
    timed = [spec.max for spec in specs if spec.name in OF_THE_STEP and spec.unit == "s"]
    shortest = LONGER * max([0.0, *(limit for limit in timed if limit is not None)])
    steps = min(MAX_STEPS, max(MIN_STEPS, steps, math.ceil(shortest / design.sample_time)))
    experiment = experiment_of(design, tried, steps)
    experiment = replace(experiment, noise=design.noise, settled=settled)
    space = space_around(best, today, design.sample_time)
    task = PidLoop(design.plants, design.pid, space, experiment, today, specs, objective)
    return task, remarks


def _today(design: Design, baseline: str | Mapping[str, float]) -> tuple[Gains | None, list[str]]:
    """Return the baseline, and what to warn of: a rule that has no answer gives way to another."""
    if not isinstance(baseline, str):
        return gains_of(design.structure, baseline), []
    if baseline not in RULES:
        raise ConfigError(f"baseline: unknown rule {baseline!r}; {suggest(baseline, RULES)}")
    reasons = []
    for rule in (baseline, *(other for other in RULES if other != baseline)):
        try:
            gains = design.by_rule(rule)
        except ConfigError as error:
            reasons.append(str(error))
            continue
        found = f"the baseline is {rule!r} instead of {baseline!r}: {'; '.join(reasons)}"
        return gains, [found] if reasons else []
    return None, [f"the baseline is the best of screened gains: {'; '.join(reasons)}"]


def space_around(best: Gains, today: Gains, sample_time: float) -> ParameterSpace:
    """Return the box that is searched: `best` in its middle, and `today` inside."""
    return ParameterSpace([_bounds(name, best, today, sample_time) for name in best])


def _bounds(name: str, best: Gains, today: Gains, sample_time: float) -> Parameter:
    """Return bounds with the best screened value in their middle, and today's value inside."""
    middle, now = best[name], today[name]
    unit = {"Ki": "1/s", "Kd": "s", "Tf": "s"}.get(name, "")
    if name == "Tf":
        middle = max(middle, sample_time / 2)
    if now * middle > 0:
        factor = max(WIDTHS[name], 1.1 * now / middle, 1.1 * middle / now)
        low, high = sorted((middle / factor, middle * factor))
        return Parameter(name, low, high, "log", unit)
    # A gain of 0, or of the other sign, has no place on a logarithmic scale.
    edge = now - 0.05 * abs(now) if middle > 0 else now + 0.05 * abs(now)
    low, high = sorted((edge, 2.0 * middle - edge))
    return Parameter(name, low, high, "linear", unit)
