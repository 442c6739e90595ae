"""Zeroth-order actor-critic: Algorithm 1 of the paper, with the values of its Table III.

Each iteration, n environments run H segments of N steps under perturbed parameters; a critic turns
them into advantages; the parameters follow the zeroth-order gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from zoac.algorithm.adam import START, descend
from zoac.algorithm.advantage import estimate
from zoac.algorithm.critic import Critic
from zoac.algorithm.gradient import standardised, zeroth_order_gradient
from zoac.algorithm.options import CriticOptions, Exploration, StepSize
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal, Segment
from zoac.core.state import Kept
from zoac.core.tuner import Problem, Tuner
from zoac.core.types import UnitInterval
from zoac.rollout.outcomes import step_costs

CRITIC_LIMIT = 1e15
"""What the critic, a network in float32, is shown lies within: squares of it do not overflow."""

_STARTS = {
    "random": "uniform in the mapped box, from the seed",
    "baseline": "the task's baseline parameters",
    "middle": "the middle of the mapped box",
}


class Zoac(Kept, Tuner):
    """The paper's method."""

    whole_episodes = False
    display_name = "ZOAC"
    kept = (
        "_rng _critic _critic_loss _theta _average _adam "
        "_iteration _skipped _worst_cost _directions"
    )

    def __init__(
        self,
        problem: Problem,
        *,
        exploration: Exploration = Exploration(),
        step_size: StepSize = StepSize(),
        critic: CriticOptions = CriticOptions(),
        start: Literal["random", "baseline", "middle"] = "random",
        gamma: UnitInterval = 0.99,
        lam: UnitInterval = 0.95,
        standardise_advantages: bool = True,
        project: bool = True,
        recommend: Literal["last", "average"] = "last",
        average_decay: UnitInterval = 0.97,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            exploration: Which segments an iteration runs.
            step_size: Of the parameters, over the iterations.
            critic: Its network and fit.
            start: Begin anywhere in the box (the paper), at the task's baseline parameters, or in
                the middle of the box.
            gamma: Discount factor.
            lam: lambda of generalised advantage estimation.
            standardise_advantages: Mean 0 and deviation 1 over an iteration's segments.
            project: Keep theta_m in Theta_m = [-1, 1]^d, as Algorithm 1 states it; False clips
                only where parameters are mapped, so that an iterate can wander outside, where
                perturbations change nothing and nothing draws it back.
            recommend: The last iterate, or an exponential average of the iterates.
            average_decay: Decay of that average per iteration.
        """
        self._problem = problem
        self._exploration, self._step_size = exploration, step_size
        self._gamma, self._lam = gamma, lam
        self._standardise, self._project = standardise_advantages, project
        self._recommend, self._decay = recommend, average_decay
        self._rng = problem.rng("tuner")
        if critic.epochs_before >= critic.epochs:
            raise ConfigError(
                f"critic.epochs_before={critic.epochs_before}: expected fewer than all "
                f"{critic.epochs} of critic.epochs"
            )
        self._epochs = critic.epochs_before, critic.epochs - critic.epochs_before
        self._critic = Critic(problem.observation_size, critic, problem.rng("critic"))
        dimension = problem.space.dimension
        self._start = start
        self._theta = self._rng.uniform(-1.0, 1.0, dimension)  # theta_m
        if start == "baseline":
            self._theta = problem.baseline_start("tuner.start=baseline")
        elif start == "middle":
            self._theta = np.zeros(dimension)
        self._average = self._theta.copy()
        self._adam = START
        self._iteration = self._skipped = 0
        self._worst_cost = 0.0
        self._pending: tuple[np.ndarray, np.ndarray] | None = None  # states and their targets
        self._critic_loss: float | None = None
        self._directions = np.empty((0, dimension))

    def ask(self) -> list[Proposal]:
        """Return n H segments around theta_m (Algorithm 1, lines 3 to 6)."""
        num_envs = self._problem.num_envs
        shape = (self._exploration.segments, num_envs, self._problem.space.dimension)
        epsilon = self._rng.standard_normal(shape)
        if self._exploration.mirrored:
            half = num_envs // 2
            epsilon[:, 1 : 2 * half : 2] = -epsilon[:, 0 : 2 * half : 2]
        self._directions = epsilon.reshape(-1, shape[-1])
        return [
            proposal
            for j in range(self._exploration.segments)
            for i in range(num_envs)
            for proposal in self._perturbed(self.sigma * epsilon[j, i], i)
        ]

    def _perturbed(self, offset: np.ndarray, env_index: int) -> list[Proposal]:
        """Return what is run for one direction."""
        horizon = self._exploration.segment_length
        return [Proposal(x=self._theta + offset, env_index=env_index, horizon=horizon)]

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Update critic and parameters (Algorithm 1, lines 7 to 13)."""
        self.background_update()
        segments = self._finite(segments)
        everything = within_float32(np.concatenate([s.observations for s in segments]))
        # In the paper advantages come from the critic as it was before this iteration's update, so
        # the update (line 11) can wait for a better moment: see `background_update`.
        values, advantages, targets = self._advantages(segments, everything)
        states = np.concatenate([s.observations[:-1] for s in segments])
        self._pending = within_float32(states), within_float32(np.concatenate(targets))
        if self._epochs[0]:
            self._critic.fit(*self._pending, self._epochs[0])
            values, advantages, _ = self._advantages(segments, everything)
        weights = self._weights(advantages)
        gradient = zeroth_order_gradient(weights, self._directions, self.sigma)  # eq. (10)
        step_size = self.step_size
        self._iteration += 1
        if np.isfinite(np.square(gradient)).all():
            self._move(gradient, step_size)
        else:
            self._skipped += 1
        loss = {} if self._critic_loss is None else {"critic_loss": self._critic_loss}
        skipped = {"skipped_updates": self._skipped} if self._skipped else {}
        return {
            **skipped,
            **loss,  # of the update before
            "advantage_mean": float(advantages.mean()),
            "advantage_std": float(advantages.std()),
            "gradient_norm": float(np.linalg.norm(gradient)),
            "step_size": step_size,
            "value_mean": float(values.mean()),
        }

    def _advantages(
        self, segments: Sequence[Segment], everything: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Return the critic's values of all observations, and by eq. (9) advantages and targets."""
        values = self._critic.values(everything)
        ends = np.cumsum([len(s.observations) for s in segments])[:-1]
        return values, *estimate(segments, np.split(values, ends), self._gamma, self._lam)

    def _move(self, gradient: np.ndarray, step_size: float) -> None:
        if self._step_size.rule == "adam":
            self._theta, self._adam = descend(self._theta, self._adam, gradient, step_size)
        else:
            self._theta = self._theta - step_size * gradient
        if self._project:
            self._theta = self._problem.space.clip(self._theta)
        self._average = self._decay * self._average + (1 - self._decay) * self._theta

    def background_update(self) -> None:
        """Update the critic (Algorithm 1, line 11): most of the time, and nobody waits for it."""
        if self._pending is None:
            return
        states, targets = self._pending
        self._pending = None
        self._critic_loss = self._critic.fit(states, targets, self._epochs[1])

    def _finite(self, segments: Sequence[Segment]) -> list[Segment]:
        """Replace costs that are not finite; see `step_costs`."""
        together = np.concatenate([s.costs for s in segments])
        costs, self._worst_cost = step_costs(together, self._worst_cost)
        parts = np.split(costs, np.cumsum([s.length for s in segments])[:-1])
        return [s.with_costs(part) for s, part in zip(segments, parts, strict=True)]

    def _weights(self, advantages: np.ndarray) -> np.ndarray:
        """Return what each direction counts in the gradient, from the segments' advantages."""
        return standardised(advantages) if self._standardise else advantages

    @property
    def sigma(self) -> float:
        """Standard deviation of the perturbation."""
        return self._exploration.sigma

    @property
    def step_size(self) -> float:
        """Annealed linearly, then held."""
        return self._step_size.at(self._iteration)

    def recommend(self) -> np.ndarray:
        """Return the last iterate, or the average, inside the mapped box."""
        chosen = self._theta if self._recommend == "last" else self._average
        return self._problem.space.clip(chosen)

    def state(self) -> dict[str, Any]:
        self.background_update()
        return super().state()

    def restore(self, state: Any) -> None:
        super().restore(state)
        self._pending = None

    def describe(self) -> dict[str, Any]:
        return {
            "start": _STARTS[self._start],
            "noise_model": f"advantages from a critic; perturbation {self.sigma:g}",
            "recommendation": {
                "last": "last iterate",
                "average": f"exponential average of the iterates, decay {self._decay:g}",
            }[self._recommend],
        }


def within_float32(values: np.ndarray) -> np.ndarray:
    """Return `values` within `CRITIC_LIMIT`, NaN as 0."""
    return np.clip(np.where(np.isnan(values), 0.0, values), -CRITIC_LIMIT, CRITIC_LIMIT)
