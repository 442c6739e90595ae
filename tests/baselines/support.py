"""A noisy quadratic to tune, and a driver without trainer."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

import zoac.conf
from zoac.config.files import configuration
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.seeding import stream_seed
from zoac.core.segments import Segment
from zoac.core.tuner import Problem, Tuner
from zoac.envs.base import ArrayVecEnv
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task

CONF = Path(zoac.conf.__path__[0])
STEPS = 10
NUM_ENVS = 5
TARGET = np.array([0.3, -0.5, 0.1, 0.6, -0.2])


def true_cost(x: np.ndarray) -> float:
    return float(((x - TARGET) ** 2).sum())


class QuadraticVecEnv(ArrayVecEnv):
    """An episode of ten steps costs the distance to TARGET squared, plus noise."""

    def __init__(self, n: int) -> None:
        box = Box(-np.inf, np.inf, (1,), np.float64)
        super().__init__(n, box, Box(-np.inf, np.inf, (5,), np.float64), STEPS)
        self.arrays = {"noise": np.zeros((n, 1))}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        self.arrays["noise"][env_index] = rng.normal(0.0, 0.1)

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cost = ((actions - TARGET) ** 2).sum(axis=1) + self.arrays["noise"][:, 0]
        return cost / STEPS, np.zeros(self.num_envs, dtype=bool)

    def _observe(self) -> np.ndarray:
        return np.ones((self.num_envs, 1))


class Pass:
    """Acts with the parameters themselves."""

    def init(self, n: int) -> dict[str, np.ndarray]:
        return {}

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        return np.stack(list(params.values()), axis=1), {}, {}


class Quadratic(Task):
    space = ParameterSpace([Parameter(name, -1.0, 1.0) for name in "abcde"])

    def make_env(self, n: int) -> QuadraticVecEnv:
        return QuadraticVecEnv(n)

    def make_controller(self) -> Pass:
        return Pass()


def problem(seed: int = 0, episodes: int = 100, **changes: Any) -> Problem:
    made = Problem(Quadratic.space, 1, NUM_ENVS, episodes * STEPS, STEPS, seed, np.zeros(5))
    return replace(made, **changes)


def engine(seed: int = 0, num_envs: int = NUM_ENVS) -> RolloutEngine:
    seeds = [stream_seed(seed, "lane", env_index) for env_index in range(num_envs)]
    return RolloutEngine(Quadratic(), range(num_envs), seeds)


@cache  # reading it is most of making a tuner
def tuner_config(name: str) -> dict[str, Any]:
    """The config of a tuner as the command line would resolve it, without a task's wishes."""
    return configuration(task=None, tuner=name)["tuner"]


def spoiled(segment: Segment, cost: float) -> Segment:
    return segment.with_costs(np.full(segment.length, cost))


def drive(tuner: Tuner, group: RolloutEngine, steps: int, spoil: Any = None) -> list[np.ndarray]:
    """Ask and tell for at least `steps` steps, if the tuner wants them; return what was asked.

    `spoil(i, segment)`, if given, returns what is told in place of the i-th segment.
    """
    asked: list[np.ndarray] = []
    while steps > 0 and (proposals := tuner.ask()):
        segments = group.rollout(proposals)
        steps -= sum(s.length for s in segments)
        if spoil is not None:
            segments = [spoil(len(asked) + i, s) for i, s in enumerate(segments)]
        tuner.tell(segments)
        asked += [p.x for p in proposals]
    return asked
