"""What an episode comes to by the specs of a task: the value of each, and the objective.

Specs are judged over whole episodes: segments that begin an episode and end it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.segments import Segment
from zoac.specs.signals import Episode, Signal
from zoac.specs.spec import Spec

EPISODES_ONLY = (
    "specs are judged over whole episodes; choose the tuner auto, or one that asks for these: "
    "cmaes_full, bo, optuna, es, nevergrad or random"
)


class Judge:
    """Puts the values of the specs, and the objective that they give, into segments."""

    def __init__(
        self,
        specs: Sequence[Spec],
        signals: Mapping[str, Signal],
        sample_time: float | None,
        max_episode_steps: int,
        parameters: Callable[[np.ndarray], Mapping[str, Any]],
    ) -> None:
        """
        Args:
            specs: Hard ones, and soft ones, whose weighted sum is the objective.
            signals: By name.
            sample_time: Seconds of a step; None: not known.
            max_episode_steps: An episode that terminates earlier ended before its time.
            parameters: Returns all of them, by name, for mapped ones (d,).
        """
        check(specs, signals, sample_time)
        self._specs = tuple(specs)
        self._signals, self._sample_time = signals, sample_time or 1.0
        self._max_episode_steps, self._parameters = max_episode_steps, parameters
        self._of_loops: dict[bytes, list[float]] = {}  # of the latest parameters

    def judged(self, segment: Segment) -> Segment:
        """Return a segment with the values of all specs, and the objective as its last cost.

        A part of an episode comes back as it is.
        """
        ended = segment.terminated or segment.truncated
        if not (self._specs and segment.starts_episode and ended):
            return segment
        episode = self.episode(segment)
        of_loops = iter(self._loop_values(segment.proposal.x))
        values = tuple(
            next(of_loops) if spec.of_loop else spec.of_episode(episode) for spec in self._specs
        )
        pairs = list(zip(self._specs, values, strict=True))
        violation = sum(spec.violation_of(episode, value) for spec, value in pairs)
        costs = segment.costs
        if soft := [spec.weight * value for spec, value in pairs if not spec.hard]:
            costs = np.zeros(segment.length)
            costs[-1] = sum(soft)
        return replace(segment, costs=costs, spec_values=values, violation=violation)

    def episode(self, segment: Segment) -> Episode:
        """Return the signals of a whole episode; none of one that ended early."""
        part = min(1.0, segment.length / self._max_episode_steps)
        if (segment.terminated and part < 1.0) or segment.failure is not None:
            return Episode(np.zeros(0), {}, ended=min(part, LAST_STEP))
        return Episode.of(segment, self._signals, self._sample_time)

    def _loop_values(self, x: np.ndarray) -> list[float]:
        """Return the figures of loops; asked again for the same parameters, from memory."""
        key = x.tobytes()
        if key not in self._of_loops:
            if len(self._of_loops) >= REMEMBERED:
                self._of_loops.clear()
            of_loops = [spec for spec in self._specs if spec.of_loop]
            parameters = self._parameters(x) if of_loops else {}
            self._of_loops[key] = [spec.of_parameters(parameters) for spec in of_loops]
        return self._of_loops[key]


LAST_STEP = 1.0 - 1e-9
"""What counts as the end of an episode whose very last step failed."""

REMEMBERED = 256
"""Parameter vectors whose figures of a loop are kept: several episodes share one."""


def check(specs: Sequence[Spec], signals: Mapping[str, Signal], sample_time: float | None) -> None:
    """See that specs can be judged.

    Raises:
        ConfigError: If a spec names an unknown signal or only constant ones, needs seconds or a
            loop that are not there, or is there twice.
    """
    labels = [spec.label for spec in specs]
    for spec in specs:
        if labels.count(spec.label) > 1:
            raise ConfigError(f"specs: {spec.label} is there twice")
        for name in spec.signals:
            if name not in signals:
                hint = f"name it: signals={{{name!r}: zoac.observation(0)}}"
                hint = suggest(name, signals) if signals else hint
                raise ConfigError(f"{spec}: no signal {name!r}; {hint}")
        numbers = [signals[name].number for name in spec.signals]
        if numbers and None not in numbers:
            name = repr(spec.signals[0])
            raise ConfigError(
                f"{spec}: {name} is the number {numbers[0]:g} at all times, which no tuning can "
                f"change; for a number of the observation write signals={{{name}: "
                "zoac.observation(0)}"
            )
        if spec.of_loop and spec.loop is None:
            raise ConfigError(
                f"{spec}: expected loop=, a function of the parameters that returns the open loop "
                "as a system of python-control"
            )
        if sample_time is None and (spec.timed or spec.window is not None):
            raise ConfigError(
                f"{spec} is in seconds, and nothing says how long a step is; give "
                "sample_time=<seconds>, or the environment an attribute dt [s]"
            )


def need_episodes(segments: Sequence[Segment]) -> None:
    """Refuse segments that are parts of episodes."""
    if any(segment.spec_values is None for segment in segments):
        raise ConfigError(f"the tuner asked for a part of an episode, and {EPISODES_ONLY}")


def comparable(segments: Sequence[Segment]) -> list[Segment]:
    """Return episodes without the infinite objective of those that ended early.

    Their violation says how bad they are, which infinity cannot.
    """
    return [
        segment.with_costs(np.zeros(segment.length))
        if segment.violation > 0 and not np.isfinite(segment.costs[-1])
        else segment
        for segment in segments
    ]
