"""Specs of a loop with a PID: what is looked at when, and margins without a simulation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac import specs as requirements
from zoac.controllers.pid import PID
from zoac.controllers.pid_loop import SampledLoop
from zoac.core.errors import ConfigError, suggest
from zoac.specs.loops import OpenLoop
from zoac.specs.signals import Episode, Signal
from zoac.specs.spec import Loop, Spec

OBJECTIVES = ("iae", "ise", "itae")
OF_THE_STEP = ("overshoot", "settling_time", "rise_time", "steady_state_error")
"""Figures of the reference's step: judged before the load begins."""


class WorstPlant(Spec):
    """A soft spec of several plants: the worst one counts."""

    def of_episode(self, episode: Episode) -> float:
        """Return the figure of the worst plant."""
        return self.worst if episode.ended < 1.0 else max(self.of_loops(episode))


def objective_of(given: str | Spec, plants: int) -> Spec:
    """Return what is minimised.

    Raises:
        ConfigError: If it is neither the name of an integral nor a spec without a limit.
    """
    if isinstance(given, str):
        if given not in OBJECTIVES:
            raise ConfigError(f"objective={given!r}: {suggest(given, OBJECTIVES)}")
        given = getattr(requirements, given)("y", "r")
    if not isinstance(given, Spec) or given.hard:
        raise ConfigError(
            f"objective={given!r}: expected {', '.join(map(repr, OBJECTIVES))}, or a spec without "
            "a limit"
        )
    return given if plants == 1 else WorstPlant(**vars(given))


def closed_loops(
    loops: Sequence[SampledLoop], pid: PID, parameters: Mapping[str, Any]
) -> list[OpenLoop]:
    """Return the loops of the plants with a PID of these gains."""
    return [loop.at(pid, parameters) for loop in loops]


def fitted(spec: Spec, loops: Loop, load_at: float) -> Spec:
    """Return a spec as it is judged here.

    A figure of the reference's step is looked at until the load begins, at `load_at` [s]; a figure
    of a loop is of the plant that keeps it least.
    """
    if spec.of_loop and spec.loop is None:
        worst = min if spec.max is None else max
        return replace(
            spec,
            figure=lambda of: float(worst(map(spec.figure, of))),
            loop=loops,
        )
    if spec.name in OF_THE_STEP and spec.window is None:
        return replace(spec, window=(0.0, load_at))
    return spec


def signals_of(loops: int, which: Sequence[int]) -> dict[str, Signal]:
    """Return y, without its noise, r and u of the loops `which` of so many side by side."""
    chosen = np.squeeze(np.array(which, dtype=int))  # of a single loop (T,), not (T, 1)
    return {
        "y": Signal("output", lambda s: s.observations[:, 2 * loops + chosen]),
        "r": Signal("reference", lambda s: s.observations[:, loops + chosen]),
        "u": Signal("input", lambda s: s.actions[:, chosen]),
    }
