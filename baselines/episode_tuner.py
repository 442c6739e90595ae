"""Base class of tuners that learn from the costs of whole episodes."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from zoac.algorithm.strategies.held_out import HeldOut
from zoac.core.segments import Proposal, Segment
from zoac.core.state import Kept
from zoac.core.tuner import Problem, Tuner
from zoac.core.types import Count, Fraction, bad_is_infinite
from zoac.rollout.outcomes import CostRange, Outcomes, cost_sums


class EpisodeTuner(Kept, Tuner):
    """A tuner that sees nothing of an episode but its undiscounted cost.

    A subclass draws points in `_draw` and learns from their costs in `_learn`. This class
    distributes the points over the environments, remembers the best single episodes and
    re-evaluates them on request.

    `zoac.rollout.outcomes` defines how episodes rank. An episode whose cost is not finite is never
    among the best.
    """

    kept = "_rng _steps _batch_size _costs _best _best_points _final _final_told"

    def __init__(
        self,
        problem: Problem,
        *,
        start: Literal["random", "baseline", "middle"] = "random",
        recommendation: str,
        reevaluate_top: Count = 10,
        reevaluate_fraction: Fraction = 0.1,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            start: Where the search starts: a random point, the task's baseline or the middle of
                the box. The baseline is also recommended until a cost is known.
            recommendation: "best_seen": the parameters of the cheapest single episode;
                "reevaluated": the best of the cheapest after more episodes; any other: the
                subclass's own.
            reevaluate_top: Number of the cheapest points that are re-evaluated.
            reevaluate_fraction: Last fraction of the budget, spent on re-evaluation.

        Raises:
            ConfigError: If `start` is "baseline" and the task has no baseline parameters.
        """
        self._problem = problem
        self._rng = problem.rng("tuner")
        self._recommendation = recommendation
        self._fraction = reevaluate_fraction if recommendation == "reevaluated" else 0.0
        self._search_steps = int(problem.budget * (1.0 - self._fraction))
        self._steps, self._batch_size = 0, 0
        self._costs = CostRange()
        self._reevaluate_top = reevaluate_top
        self._best = Outcomes.none()  # of single episodes, best first
        self._best_points = np.empty((0, problem.space.dimension))
        self._unknown = np.zeros(problem.space.dimension)
        self._final = HeldOut(problem, "reevaluation")  # without candidates until its turn
        # Sums of what tuners are told of the re-evaluated points; None: the search goes on.
        self._final_told: np.ndarray | None = None
        self._start = start
        if start == "baseline":
            self._unknown = problem.baseline_start("tuner.start=baseline")
        self._first = self._unknown.copy()
        if start == "random":
            self._first = self._rng.uniform(-1.0, 1.0, problem.space.dimension)

    @property
    def search_episodes(self) -> int:
        """Number of episodes within the search budget if each runs to its time limit."""
        return max(1, self._search_steps // self._problem.max_episode_steps)

    @abstractmethod
    def _draw(self) -> list[np.ndarray]:
        """Return the next points to evaluate, each (d,); none if there is nothing left to do."""

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        """Take the outcomes of all points drawn since the last call, in their order."""
        return {}

    def _own_recommendation(self) -> np.ndarray | None:
        """Return the subclass's recommendation (d,), or None if it has none yet."""
        return None

    def _own_state(self) -> Any:
        """Return a copy of what the subclass adds to the state; see `Tuner.state`."""
        return None

    def _own_restore(self, state: Any) -> None:
        """Restore what `_own_state` returned."""

    def ask(self) -> list[Proposal]:
        """Return one whole episode per point."""
        if self._fraction and self._final_told is None and self._search_is_over():
            for x in self._best_points:
                self._final.enter(x)
            self._final.enter_baseline()
            self._final_told = np.zeros(len(self._best))
        if self._final_told is not None:
            return self._final.ask(episodes=1)
        num_envs = self._problem.num_envs
        return [Proposal(x=np.array(x), env_index=i % num_envs) for i, x in enumerate(self._draw())]

    def _search_is_over(self) -> bool:
        """Whether to re-evaluate now: with a small budget, while one round is still affordable."""
        batch, problem = self._batch_size * self._problem.max_episode_steps, self._problem
        left = problem.budget - self._steps - batch
        enough = (len(self._best) + 1) * problem.max_episode_steps
        return self._steps >= self._search_steps or (len(self._best) > 0 and left < enough)

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take the cost of each episode."""
        self._batch_size = max(self._batch_size, len(segments))
        self._steps += sum(segment.length for segment in segments)
        if self._final_told is not None:
            self._final_told += bad_is_infinite(cost_sums(segments[: len(self._best)]))
            self._final.tell(segments)
            return self._final_numbers(self._final_told)
        outcomes = Outcomes.of(segments)
        finite = np.isfinite(outcomes.violations)
        points = np.concatenate([self._best_points, [s.proposal.x for s in segments]])
        together = self._best + outcomes
        first = together.order[: self._reevaluate_top]
        first = first[np.isfinite(together.violations[first])]
        self._best_points, self._best = points[first], together[first]
        self._costs.add(outcomes)
        metrics = {"cost_mean": float(outcomes.costs[finite].mean())} if finite.any() else {}
        metrics["cost_not_finite"] = float((~finite).sum())
        if len(self._best):
            metrics["best_seen"] = float(self._best.costs[0])
        return metrics | self._learn(outcomes)

    def _final_numbers(self, told: np.ndarray) -> dict[str, float]:
        rounds, means = len(self._final.costs), self._final.costs.mean(axis=0)
        metrics = {"reevaluation_rounds": float(rounds)}
        if np.isfinite(means).any():
            metrics["reevaluated_best"] = float(means[self._final.ranking[0]])
        if (finite := np.isfinite(told)).any():
            luck = (told / rounds - self._best.costs)[finite]
            metrics["selection_bias"] = float(luck.mean())
        return metrics

    def recommend(self) -> np.ndarray:
        """Return the recommendation; until a cost is known, the baseline or the middle."""
        if self._final.begun:
            return self._final.best
        x = None
        if self._recommendation not in ("best_seen", "reevaluated"):
            x = self._own_recommendation()
        if x is None and len(self._best):
            x = self._best_points[0]
        if x is None:
            x = self._unknown
        return self._problem.space.clip(np.array(x, dtype=np.float64))

    def describe(self) -> dict[str, Any]:
        """Return the choices that all baselines have."""
        chosen: dict[str, Any] = {"recommendation": self._recommendation}
        if self._fraction:
            chosen["reevaluate_top"] = self._reevaluate_top
            chosen["reevaluate_fraction"] = self._fraction
        return chosen

    def state(self) -> Any:
        """Return everything, the subclass's part included."""
        return {**super().state(), "own": self._own_state()}

    def restore(self, state: Any) -> None:
        super().restore(state)
        self._own_restore(state["own"])
