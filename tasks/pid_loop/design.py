"""From a plant to an experiment: gains to begin with, how long an episode is, bounds of the gains.

A screening simulates the gains of all rules, weakened and strengthened, and gains read off the
plant's frequency response. The best of them says how fast the loop can be, which fixes the length
of an episode and the middle of the box that is searched.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.controllers import tuning_rules
from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine
from zoac.specs.spec import Spec
from zoac.tasks.pid_loop.plants import PARAMETERS, RULES, Design, Gains, gains_of
from zoac.tasks.pid_loop.requirements import OF_THE_STEP
from zoac.tasks.pid_loop.task import Experiment, PidLoop

WIDTHS = {"Kp": 30.0, "Ki": 2000.0, "Kd": 30.0, "Tf": 30.0}
"""Bounds of a gain: the best screened one divided and multiplied by this. A step of the reference
without overshoot may need a very slow integral; where the plant integrates, hardly any."""

EDGE = 0.98
"""A normalised gain beyond lies at an edge of its box."""

BAND = 0.05
"""Of the step: an output inside has settled, for the length of an episode."""

LONGER = 2.5
"""An episode's parts last this many times as long as a good screened loop takes to settle."""

MIN_STEPS, MAX_STEPS = 40, 2000
"""Of each of the two parts of an episode."""

COARSER = 4.0
"""Factor between the sample times that are tried where no loop settles within `MAX_STEPS`."""

SLOWEST = 30.0
"""A loop that takes longer than this many times the dead time and the slowest time constant is not
slow: nothing that was screened settles at all."""

GOOD = 1.5
"""A good loop costs at most this many times as much as the best one."""


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
        ConfigError: If there is no such rule, the gains cannot be used, or `MAX_STEPS` are too few
            for the plant at this sample time.
    """
    today, remarks = _today(design, baseline)
    timed = [spec.max for spec in specs if spec.name in OF_THE_STEP and spec.unit == "s"]
    limit = max([0.0, *(limit for limit in timed if limit is not None)])
    longest, delay = MAX_STEPS * design.sample_time, max(design.dead_times)
    remarks += [
        f"{spec} <= {spec.max:g} s: nothing settles within the dead time, {delay:g} s."
        for spec in specs
        if spec.name == "settling_time" and spec.max is not None and spec.max <= delay
    ]
    if 2.0 * delay > longest:  # what feedback does is seen after a second dead time
        raise _too_fast(design, f"the dead time is {delay:g} s", 10.0 * delay)
    if limit > longest:
        raise _too_fast(design, f"a spec allows {limit:g} s", LONGER * limit)
    tried = [*([today] if today else []), *candidates(design)]
    best, settled = screened(design, tried)
    if settled > MAX_STEPS:
        _refuse_slow_loops(design)
    today = today or best
    shortest = math.ceil(max(LONGER * settled, LONGER * limit / design.sample_time))
    steps = min(MAX_STEPS, max(MIN_STEPS, shortest))
    experiment = experiment_of(design, tried, steps)
    experiment = replace(experiment, noise=design.noise, settled=settled)
    space = space_around(best, today, design.sample_time)
    task = PidLoop(design.plants, design.pid, space, experiment, today, specs, objective)
    return task, remarks


def _refuse_slow_loops(design: Design) -> None:
    """Refuse a sample time at which an episode is too short for a loop to settle.

    Coarser sample times tell whether any loop settles, and how long it takes.

    Raises:
        ConfigError: If one settles.
    """
    roots = np.abs(np.concatenate([system.poles() for system in design.systems]))
    slowest = max([*design.dead_times, *(1.0 / roots[roots > 1e-9])])
    coarse = design
    while MAX_STEPS * coarse.sample_time < SLOWEST * slowest:
        coarse = replace(coarse, sample_time=COARSER * coarse.sample_time)
        _, settled = screened(coarse, candidates(coarse))
        if settled <= MAX_STEPS:
            seconds = settled * coarse.sample_time
            reason = f"a good loop takes about {seconds:.2g} s to settle"
            raise _too_fast(design, reason, LONGER * seconds)


def _too_fast(design: Design, reason: str, needed: float) -> ConfigError:
    """Return the refusal of a sample time: `needed` seconds are to be simulated."""
    return ConfigError(
        f"sample_time={design.sample_time:g} is too small for this plant: "
        f"{MAX_STEPS * design.sample_time:.4g} s ({MAX_STEPS} steps) are simulated after the step "
        f"of the reference, but {reason}; give a sample_time of {needed / MAX_STEPS:.2g} s or more"
    )


def _today(design: Design, baseline: str | Mapping[str, float]) -> tuple[Gains | None, list[str]]:
    """Return the baseline, and what to warn of: a rule that has no answer gives way to another."""
    if not isinstance(baseline, str):
        return gains_of(design.structure, baseline), []
    if baseline not in RULES:
        raise ConfigError(f"baseline: unknown rule {baseline!r}; {suggest(baseline, RULES)}")
    reasons: dict[str, None] = {}  # several rules may have the same one
    for rule in sorted(RULES, key=lambda rule: rule != baseline):
        gains = design.by_rule[rule]
        if isinstance(gains, ConfigError):
            reasons[str(gains)] = None
            continue
        found = f"the baseline is {rule!r} instead of {baseline!r}: {'; '.join(reasons)}"
        return gains, [found] if reasons else []
    return None, [f"the baseline is the best of screened gains: {'; '.join(reasons)}"]


def space_around(best: Gains, today: Gains, sample_time: float) -> ParameterSpace:
    """Return the box that is searched: `best` in its middle, and `today` inside."""
    found = []
    for name, middle in best.items():
        now, unit = today[name], {"Ki": "1/s", "Kd": "s", "Tf": "s"}.get(name, "")
        if name == "Tf":
            middle = max(middle, sample_time / 2)
        if now * middle > 0:
            factor = max(WIDTHS[name], 1.1 * now / middle, 1.1 * middle / now)
            low, high = sorted((middle / factor, middle * factor))
            found.append(Parameter(name, low, high, "log", unit))
        else:  # 0, or of the other sign: no place on a logarithmic scale
            edge = now - 0.05 * abs(now) if middle > 0 else now + 0.05 * abs(now)
            low, high = sorted((edge, 2.0 * middle - edge))
            found.append(Parameter(name, low, high, "linear", unit))
    return ParameterSpace(found)


def widened(space: ParameterSpace, gains: Gains) -> ParameterSpace:
    """Return the box, wider where `gains` lie at an edge: screening knew nothing of the specs."""
    found = []
    for p, x in zip(space.parameters, space.normalise(gains), strict=True):
        if p.scale == "log" and abs(x) > EDGE:
            end = "low" if x < 0 else "high"
            factor = WIDTHS[p.name] if x * p.low > 0 else 1.0 / WIDTHS[p.name]
            p = replace(p, **{end: factor * getattr(p, end)})
        found.append(p)
    return ParameterSpace(found)


def candidates(design: Design) -> list[Gains]:
    """Return gains to screen: of every rule that has an answer, and of the frequency response."""
    found = []
    for gains in design.by_rule.values():
        if not isinstance(gains, ConfigError):
            found += [gains, *_varied(gains)]
    system, dead_time = design.systems[0], design.dead_times[0] + design.sample_time / 2
    top = math.pi / design.sample_time
    roots = np.abs(np.concatenate([system.poles(), system.zeros()]))
    low = min([*roots[roots > 1e-9], 1.0 / dead_time, top]) / 10
    sign = tuning_rules.sign(system)
    for omega in np.geomspace(low, top / 2, 14):
        kp = sign / abs(complex(system(1j * omega)))
        td = 0.5 / omega
        gains = {"Kp": kp, "Ki": kp * omega / 4, "Kd": kp * td, "Tf": tuning_rules.FILTER * td}
        found += _varied({name: gains[name] for name in PARAMETERS[design.structure]})
    if "Tf" in PARAMETERS[design.structure]:  # half a sample at least
        found = [{**gains, "Tf": max(gains["Tf"], design.sample_time / 2)} for gains in found]
    return found


def _varied(gains: Gains) -> list[Gains]:
    """Return gains with a weaker and a stronger Kp, and with less and more of the integral."""
    return [
        {name: value * (strength if name != "Tf" else 1.0) * (part if name == "Ki" else 1.0)
         for name, value in gains.items()}
        for strength in (0.25, 0.5, 0.8)
        for part in ((0.25, 1.0) if "Ki" in gains else (1.0,))
    ]  # fmt: skip


def experiment_of(design: Design, candidates: Sequence[Gains], part: int) -> Experiment:
    """Return an episode: `part` steps after the reference's step, and as many after the load's.

    The reference is 1, or two thirds of what the input can hold; below 0 where the input moves the
    output only down. The load takes half of the input that holds the reference; where the plant
    integrates, a part of what the P-action would answer.

    Raises:
        ConfigError: If the input moves some plants only up and others only down.
    """
    low, high = design.input_limits
    at_rest = [_gain_at_rest(system) for system in design.systems]
    # A limit of 0 holds an output of 0, also where the gain is infinite.
    ends = [[limit * gain if limit else 0.0 for limit in (low, high)] for gain in at_rest]
    up, down = min(map(max, ends)), -max(map(min, ends))
    if not (up > 0 or down > 0):
        raise ConfigError(
            f"input_limits={design.input_limits}: such an input moves the output of some plants "
            "only up and of others only down, so no step of the reference suits all; tune them "
            "one by one"
        )
    size = min(1.0, (up if up > 0 else down) / 1.5)
    reference = size if up > 0 else -size
    usual = float(np.median([abs(gains["Kp"]) for gains in candidates]))
    room = max(-low, high)
    side = 1.0 if high >= -low else -1.0
    free = -side * min(0.3 * usual * size, 0.5 * room)
    loads = tuple(0.5 * reference / g if math.isfinite(g) else free for g in at_rest)
    return Experiment(2 * part, part, reference, loads)


def _gain_at_rest(system: Any) -> float:
    """Return the plant's static gain; infinite, with its sign, where it integrates."""
    if np.abs(system.poles()).min(initial=np.inf) < 1e-9:
        return math.copysign(math.inf, float(np.real(complex(system(1e-9 + 0j)))))
    return float(np.real(complex(system(0j))))


def screened(design: Design, candidates: Sequence[Gains]) -> tuple[Gains, int]:
    """Return the gains of the smallest integral of the absolute error, and the steps to settle.

    The screening is repeated with longer episodes until a good loop settles early in one; more
    than `MAX_STEPS` steps if none does.
    """
    names = list(candidates[0])
    widest = [(min(c[n] for c in candidates), max(c[n] for c in candidates)) for n in names]
    space = ParameterSpace(
        [Parameter(n, low - 1e-9 - abs(low), high + 1e-9 + abs(high))
         for n, (low, high) in zip(names, widest, strict=True)]
    )  # fmt: skip
    longest = max(plant.delay for plant in design.plants)
    steps = max(MIN_STEPS, 10 * longest)
    while True:
        steps = min(steps, MAX_STEPS)
        task = PidLoop(design.plants, design.pid, space, experiment_of(design, candidates, steps))
        rows = range(len(candidates))
        engine = RolloutEngine(task, rows, rows)
        proposals = [Proposal(space.normalise(c), k) for k, c in enumerate(candidates)]
        segments = engine.rollout(proposals)
        costs = np.array([np.inf if s.terminated else s.costs.sum() for s in segments])
        good = [s for s, cost in zip(segments, costs, strict=True) if cost <= GOOD * costs.min()]
        settled = min(_settled(s, task) for s in good)
        if steps == MAX_STEPS or settled * LONGER <= steps:
            return candidates[int(costs.argmin())], settled
        steps *= 3


def _settled(segment: Segment, task: PidLoop) -> int:
    """Return after how many steps of the reference's part every output has settled."""
    part = task.experiment.load_at
    y = segment.observations[: part + 1, -task.loops :]
    around = task.experiment.reference if "Ki" in task.space.names else y[-1]
    outside = np.abs(y - around).max(axis=1) > BAND * abs(task.experiment.reference)
    return int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
