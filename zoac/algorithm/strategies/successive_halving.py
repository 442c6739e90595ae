"""Successive halving for any tuner: try many parameter vectors briefly, few for long.

Most vectors show within a few steps that they are bad (Jamieson and Talwalkar, 2016). All vectors
of a round run from the same start under the same disturbances. The better ones stay for the next
round. Offspring joins them: one of them plus a difference of two others (differential evolution:
Storn and Price, 1997), which follows a narrow valley whatever its direction and scale.
"""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from zoac.algorithm.strategies.base import Begin, StartSearch
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem
from zoac.core.types import Count, UnitInterval, bad_is_infinite
from zoac.rollout.outcomes import cost_sums, ranking

SHORTEST = 1 / 40
"""Horizon of the first round, as a part of an episode's time limit; see also
`Problem.shortest_horizon`."""

MIN_POINTS = 4
"""Vectors in a round, at least; and in the last one, which spends its steps on several episodes."""

NO_OFFSPRING = 20
"""Number of parameters from which a round has too few vectors for offspring to be of use."""

DIFFERENCE, JITTER = 0.7, 0.02
"""Which fraction of a difference offspring moves by, and the standard deviation of its noise."""


class SuccessiveHalving(StartSearch):
    """A tuner that begins at the winner of rounds of equal numbers of steps.

    The horizon grows geometrically to a whole episode. The last round is between the best few only,
    over as many whole episodes as its steps allow. Where environments cannot be restored
    (`Problem.supports_snapshots`), every round runs whole episodes from the environments' own
    starts, and it ends early where the next round would exceed its fraction of the budget.
    """

    whole_episodes = False
    kept = "_rng _round _points _ranked"

    def __init__(
        self,
        problem: Problem,
        begin: Begin,
        *,
        fraction: UnitInterval = 0.4,
        rounds: Count = 6,
        survivors: UnitInterval | None = None,
        start: Literal["random", "baseline"] = "random",
    ) -> None:
        """
        Args:
            fraction: Of the budget.
            rounds: How many; 3 or more begin with parts of episodes.
            survivors: Which fraction of a round are the last round's best; the rest are their
                offspring. Few survivors suit few parameters; None: d / `NO_OFFSPRING`, at most 1.
            start: Whether the baseline values take part in the first round, or random ones only.

        Raises:
            ConfigError: If baseline values are to take part and there are none.
        """
        dimension = problem.space.dimension
        self._rng = problem.rng("successive_halving")
        self._first = self._rng.uniform(-1.0, 1.0, dimension)
        if start == "baseline":
            self._first = problem.baseline_start("start=baseline")
        self._survivors = min(1.0, dimension / NO_OFFSPRING) if survivors is None else survivors
        self._fraction, self._start = fraction, start
        steps = fraction * problem.budget / rounds
        self._horizons = _horizons(problem, rounds)
        self._sizes = [max(MIN_POINTS, int(steps / h)) for h in self._horizons]
        self._episodes = [1] * rounds
        if rounds > 1:
            self._sizes[-1] = MIN_POINTS
            whole = int(steps / (MIN_POINTS * problem.max_episode_steps))
            self._episodes[-1] = max(1, whole)
        self._round = 0
        self._points = np.empty((0, dimension))
        self._ranked = self._first[None].copy()  # the better half of the last round, best first
        super().__init__(problem, begin)
        self.display_name += " after halving"

    @property
    def _looking(self) -> bool:
        return self._round < len(self._horizons)

    def _best(self) -> np.ndarray:
        return self._ranked[0].copy()

    def _ask_start(self) -> list[Proposal]:
        """Return the next round: all its vectors, divided among the environments."""
        size = self._sizes[self._round]
        self._points = self._uniform(size) if self._round == 0 else self._descendants(size)
        num_envs, horizon = self._problem.num_envs, self._horizons[self._round]
        count = self._episodes[self._round]
        seeds: list[int | None] = [None] * count
        if self._problem.supports_snapshots:
            seeds = [int(seed) for seed in self._rng.integers(2**62, size=count)]
        runs = [(x, seed) for x in self._points for seed in seeds]
        return [
            Proposal(x, i % num_envs, horizon=None if seed is None else horizon, seed=seed)
            for i, (x, seed) in enumerate(runs)
        ]

    def _uniform(self, size: int) -> np.ndarray:
        drawn = self._rng.uniform(-1.0, 1.0, (size - 1, len(self._first)))
        return np.concatenate([self._first[None], drawn])

    def _descendants(self, size: int) -> np.ndarray:
        """Return the next round's vectors (size, d): survivors and their offspring."""
        ranked, rng = self._ranked, self._rng
        parents = ranked[: max(2, math.ceil(self._survivors * size))][:size]
        count = size - len(parents)
        parent = parents[rng.integers(len(parents), size=count)]
        one, other = ranked[rng.integers(len(ranked), size=(2, count))]
        noise = rng.standard_normal((count, ranked.shape[1]))
        offspring = parent + DIFFERENCE * (one - other) + JITTER * noise
        return np.concatenate([parents, self._problem.space.clip(offspring)])

    def _tell_start(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Rank the vectors by what came back, in the order of the proposals."""
        costs = bad_is_infinite(cost_sums(segments)).reshape(len(self._points), -1).mean(axis=1)
        violations = np.reshape([s.violation for s in segments], (len(self._points), -1))
        order = ranking(violations.mean(axis=1), costs)
        self._ranked = self._points[order[: max(2, len(order) // 2)]]
        self._round += 1
        told = {"halving_round": self._round, "halving_best_cost": float(costs[order[0]])}
        if self._looking and not self._problem.supports_snapshots:
            # A round is several whole episodes, which a small fraction pays for only a few times.
            episodes = self._sizes[self._round] * self._episodes[self._round]
            steps = episodes * np.mean([s.length for s in segments])
            if self._spent + steps > self._fraction * self._problem.budget:
                self._round = len(self._horizons)
        return told

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices, its start replaced."""
        among = ", the baseline values take part" if self._start == "baseline" else ""
        told = f"successive halving, {self._fraction:.0%} of the budget{among}"
        return {**super().describe(), "start": told}


def _horizons(problem: Problem, rounds: int) -> list[int]:
    """Return each round's horizon: geometric to a whole episode, and that again.

    The first is `SHORTEST` of an episode, or what the problem says is informative.
    """
    whole = problem.max_episode_steps
    if not problem.supports_snapshots or rounds < 3:
        return [whole] * rounds
    exponents = 1 - np.arange(rounds - 1) / (rounds - 2)
    first = min(1.0, max(SHORTEST, problem.shortest_horizon / whole))
    return [max(1, round(whole * first**e)) for e in exponents] + [whole]
