"""Starting from today's gains: how far to search, and whether to accept what was found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zoac.errors import ConfigError
from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment
from zoac.tuner import Problem, Tuner

WIDEST, NARROWEST = 0.3, 0.03
"""Standard deviation of the search in the mapped box at trust 0 and at trust 1."""

CONFIDENCE = 0.95
"""One-sided, with which a candidate must be better than the start."""


def spread(trust: float) -> float:
    """Return the search's standard deviation in the mapped box, geometric in `trust` in [0, 1]."""
    return WIDEST * (NARROWEST / WIDEST) ** trust


def trusted(options: Mapping[str, Any], trust: float) -> dict[str, Any]:
    """Return a tuner's options with the search set by how far the start values are trusted.

    The tuner begins at the nominal parameters; `sigma` or `spread`, whichever it has, follows from
    `trust`, ZOAC's step sizes in proportion; a choice among random starting points is left out.

    Args:
        options: Of the tuner, by name.
        trust: 0: good values may lie far away; 1: these are nearly right.

    Raises:
        ConfigError: If the tuner cannot be told a start and a spread.
    """
    width = next((name for name in ("sigma", "spread") if name in options), None)
    if width is None or "start" not in options:
        raise ConfigError(
            "trust needs a tuner with a start and a spread: zoac, zoac_plus, es, cmaes or nevergrad"
        )
    chosen = {**options, "start": "nominal", width: spread(trust)}
    if width == "sigma":
        factor = spread(trust) / options["sigma"]
        steps = {k: v for k, v in options.items() if k.startswith("step_size") and v is not None}
        chosen |= {k: v * factor for k, v in steps.items()}
    if "race_share" in options:
        chosen["race_share"] = 0.0
    return chosen


class Gate(Tuner):
    """A tuner whose answer must beat the start values on held-out episodes, or they stay.

    The last share of the budget goes to pairs of episodes from common seeds that the search never
    saw: one with the start values, one with what the tuner recommends. The recommendation is
    accepted if its mean cost is lower with 95% confidence (one-sided paired t test).
    """

    def __init__(self, tuner: Tuner, problem: Problem, share: float) -> None:
        """
        Args:
            tuner: Who searches; its own problem has the budget that is left for it.
            problem: What is tuned, with the whole budget and nominal parameters, the start.
            share: Of the budget, for held-out episodes.

        Raises:
            ConfigError: If there are no start values.
        """
        if problem.nominal is None:
            raise ConfigError("gate: there are no start values (nominal parameters) to compare to")
        self._tuner, self._problem, self._start = tuner, problem, problem.nominal
        self._share = share
        self._search_steps = search_budget(problem.budget, share)
        self._steps = 0
        self._candidate: np.ndarray | None = None
        self._costs = np.empty((0, 2))  # of each pair: start, candidate

    def ask(self) -> list[Proposal]:
        """Return what the tuner asks, and at last pairs of held-out episodes."""
        if self._candidate is None:
            proposals = self._tuner.ask() if self._steps < self._search_steps else []
            if proposals:
                return proposals
            self._candidate = self._tuner.recommend().copy()
        lanes, done = self._problem.lanes, len(self._costs)
        pairs = range(done, done + max(1, lanes // 2))
        return [
            Proposal(z, i % lanes, seed=stream_seed(self._problem.seed, "gate", pair))
            for i, (pair, z) in enumerate(
                (pair, z) for pair in pairs for z in (self._start, self._candidate)
            )
        ]

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Hand on what the tuner asked for, or count pairs."""
        if self._candidate is None:
            self._steps += sum(segment.length for segment in segments)
            return self._tuner.tell(segments)
        costs = np.reshape([segment.costs.sum() for segment in segments], (-1, 2))
        self._costs = np.concatenate([self._costs, costs])
        start, candidate = self._costs.mean(axis=0)
        return {"gate_start_cost": float(start), "gate_candidate_cost": float(candidate)}

    def meanwhile(self) -> None:
        """See `Tuner.meanwhile`."""
        self._tuner.meanwhile()

    @property
    def accepted(self) -> bool:
        """Whether the candidate has proved better than the start."""
        return better(self._costs[:, 1] - self._costs[:, 0])

    def recommend(self) -> np.ndarray:
        """Return the tuner's recommendation while it searches; then what passed the gate."""
        if self._candidate is None:
            return self._tuner.recommend()
        return (self._candidate if self.accepted else self._start).copy()

    def outcome(self) -> dict[str, Any]:
        """Return the gate's verdict for `result.json`."""
        start, candidate = self._costs.mean(axis=0) if len(self._costs) else (None, None)
        verdict = {
            "accepted": self.accepted,
            "pairs": len(self._costs),
            "start_cost_mean": start,
            "candidate_cost_mean": candidate,
        }
        return {**self._tuner.outcome(), "gate": verdict}

    def state(self) -> Any:
        """Return the tuner's state and the pairs."""
        candidate = None if self._candidate is None else self._candidate.copy()
        return self._tuner.state(), self._steps, candidate, self._costs.copy()

    def restore(self, state: Any) -> None:
        """Put back what `state` returned."""
        inner, self._steps, candidate, costs = state
        self._tuner.restore(inner)
        self._candidate = None if candidate is None else candidate.copy()
        self._costs = costs.copy()

    def describe(self) -> dict[str, Any]:
        """Return the tuner's choices and the gate."""
        told = f"last {self._share:.0%} of the budget, against the start values"
        return {**self._tuner.describe(), "gate": told}


def search_budget(budget: int, share: float) -> int:
    """Return the environment steps that a gate leaves to the search."""
    return int(budget * (1.0 - share))


def better(differences: np.ndarray) -> bool:
    """Tell whether paired differences (n,), candidate minus start, are below zero on average.

    One-sided t test at `CONFIDENCE`; never with fewer than two pairs or a candidate that failed.
    """
    if len(differences) < 2 or not np.isfinite(differences).all():
        return False
    from scipy.stats import t  # not needed where nothing is gated

    error = float(differences.std(ddof=1)) / math.sqrt(len(differences))
    quantile = float(t.ppf(CONFIDENCE, len(differences) - 1))
    return bool(differences.mean() + quantile * error < 0)
