"""How a tuner's throughput grows with environments and workers: `python -m
benchmarks.scaling_model`.

A discrete-event model of synchronous iterations. The tuner asks; every worker steps its group of
environments through their segments while the tuner learns from the last ones; the slowest worker
ends the iteration. The model draws the figures of `docs/scaling.md`. `--measure` compares it with
the executors themselves, with an environment that sleeps instead of computing.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from benchmarks.figures import FIGURES, pyplot, save
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.segments import Proposal
from zoac.envs.base import ArrayVecEnv
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.executors.process import Process
from zoac.rollout.task import Task


@dataclass(frozen=True)
class Plant:
    """What a step costs.

    Args:
        step: Seconds of one environment's environment step and control law.
        std: Standard deviation of a segment's duration over its mean, from simulators whose
            steps take unequal time.
        together: Whether environments of one worker are stepped in one vectorised call that takes
            as long as one environment's step, instead of one after the other.
    """

    step: float
    std: float = 0.0
    together: bool = False


@dataclass(frozen=True)
class Costs:
    """What the rest of an iteration costs, in seconds; `calibrate` measures all but the last.

    Args:
        message: To hand one worker its request and take its reply, in the main process.
        proposal: To do so for each proposal in it.
        vector_step: The engine's own time for a step of one worker's environments side by side.
        begin: The engine's own time to begin and end a segment.
        learning: The tuner's own time for each environment step (critic, gradient).
    """

    message: float = 1e-3
    proposal: float = 1.5e-4
    vector_step: float = 1.7e-4
    begin: float = 5e-5
    learning: float = 1.2e-4


def iteration_seconds(
    plant: Plant,
    costs: Costs,
    num_envs: int,
    workers: int,
    segment: int,
    segments: int,
    rng: np.random.Generator,
) -> float:
    """Return how long one iteration takes: one event per request sent, segment ended, reply taken.

    Args:
        plant: The simulator.
        costs: The rest.
        environments: Environments n.
        workers: Processes or actors; 0: all environments in the main process.
        segment: Steps N of a segment.
        segments: Segments H of an environment in an iteration.
        rng: For the segments' durations.
    """
    groups = [len(g) for g in np.array_split(np.arange(num_envs), min(workers, num_envs) or 1)]
    mean = plant.step * segment
    ends = []
    now = 0.0
    for group in groups:
        if workers:
            now += costs.message / 2 + costs.proposal * group * segments / 2
        durations = np.full((group, segments), mean)
        if plant.std:
            # Gamma: positive, with the given std; a simulator that stalls stalls for long.
            durations = rng.gamma(plant.std**-2, mean * plant.std**2, durations.shape)
        # Side by side: the slowest environment of each step counts. One after the other: they add
        # up.
        spent = durations.max(axis=0).sum() if plant.together else durations.sum()
        engine = segments * (segment * costs.vector_step + group * costs.begin)
        ends.append((now + spent + engine, group))
    # The critic learns from the last iteration while workers run, else when they have run.
    learning = costs.learning * num_envs * segment * segments
    if workers:
        now += learning
    for end, group in sorted(ends):
        now = max(now, end)
        if workers:
            now += costs.message / 2 + costs.proposal * group * segments / 2
    return now if workers else now + learning


def throughput(
    plant: Plant,
    costs: Costs,
    num_envs: int,
    workers: int,
    segment: int = 20,
    segments: int = 5,
    rounds: int = 50,
) -> float:
    """Return environment steps per second of wall clock, over `rounds` iterations."""
    rng = np.random.default_rng(0)
    spent = sum(
        iteration_seconds(plant, costs, num_envs, workers, segment, segments, rng)
        for _ in range(rounds if plant.std else 1)
    )
    return (rounds if plant.std else 1) * num_envs * segment * segments / spent


class SleepingVecEnv(ArrayVecEnv):
    """One number that nothing changes; a step takes `seconds` for each active environment."""

    def __init__(self, n: int, seconds: float) -> None:
        box = Box(-np.inf, np.inf, (1,), np.float64)
        super().__init__(n, box, box, max_episode_steps=1_000_000)
        self._seconds = seconds
        self.arrays = {"x": np.zeros((n, 1))}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        self.arrays["x"][env_index] = 0.0

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        time.sleep(self._seconds * self.num_envs)
        return np.zeros(self.num_envs), np.full(self.num_envs, False)

    def _observe(self) -> np.ndarray:
        return self.arrays["x"].copy()


class _Idle:
    """A controller that does nothing."""

    def init(self, n: int) -> dict[str, np.ndarray]:
        return {}

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        return np.zeros((len(obs), 1)), memory, {}


class SleepingTask(Task):
    """A simulator that keeps a clock busy, not a core."""

    space = ParameterSpace([Parameter("a", 0.0, 1.0)])

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def make_env(self, n: int) -> SleepingVecEnv:
        return SleepingVecEnv(n, self._seconds)

    def make_controller(self) -> _Idle:
        return _Idle()


def measured(executor: Executor, num_envs: int, segment: int, segments: int, rounds: int) -> float:
    """Return the least seconds of an iteration's rollout; the executor is started."""
    plan = [
        Proposal(np.zeros(1), env_index, segment)
        for _ in range(segments)
        for env_index in range(num_envs)
    ]
    executor.rollout(plan)
    spent = []
    for _ in range(rounds):
        begun = time.perf_counter()
        executor.rollout(plan)
        spent.append(time.perf_counter() - begun)
    return min(spent)


def calibrate(rounds: int = 25) -> Costs:
    """Return the costs of this machine, from rollouts of an environment that takes no time."""
    num_envs = 8
    seconds = {}
    for name, executor in (("serial", Serial()), ("process", Process(workers=1))):
        executor.start(SleepingTask(0.0), num_envs, seed=0)
        for segment, segments in ((1, 1), (1, 33), (97, 1)):
            seconds[name, segment, segments] = measured(
                executor, num_envs, segment, segments, rounds
            )
        executor.close()
    vector_step = (seconds["serial", 97, 1] - seconds["serial", 1, 1]) / 96
    begin = ((seconds["serial", 1, 33] - seconds["serial", 1, 1]) / 32 - vector_step) / num_envs
    wire = {n: seconds["process", 1, n] - seconds["serial", 1, n] for n in (1, 33)}
    proposal = (wire[33] - wire[1]) / (num_envs * 32)
    return Costs(max(0.0, wire[1] - num_envs * proposal), proposal, vector_step, begin, 0.0)


def compare(worker_counts: Sequence[int], rounds: int) -> list[float]:
    """Print measured and modelled seconds of iterations; return their ratios."""
    costs = calibrate()
    print(costs)
    ratios = []
    num_envs, segment, segments = 8, 10, 2
    for asked in (5e-4, 2e-3, 1e-2):
        # A sleep oversleeps: what it really takes is an input of the model.
        slept = []
        for _ in range(30):
            begun = time.perf_counter()
            time.sleep(asked * num_envs)
            slept.append(time.perf_counter() - begun)
        plant = Plant(min(slept) / num_envs)
        for workers in worker_counts:
            executor: Executor = Process(workers=workers) if workers else Serial()
            executor.start(SleepingTask(asked), num_envs, seed=0)
            found = measured(executor, num_envs, segment, segments, rounds)
            executor.close()
            rng = np.random.default_rng(0)
            told = iteration_seconds(plant, costs, num_envs, workers, segment, segments, rng)
            ratios.append(found / told)
            print(
                f"step {asked:.0e} s, {workers or 'no'} workers: measured {found:.4f} s, "
                f"model {told:.4f} s, ratio {found / told:.2f}",
                flush=True,
            )
    return ratios


def draw(costs: Costs, folder: Path = FIGURES) -> None:
    """Write the figures of `docs/scaling.md`."""
    plt = pyplot()
    counts = np.array([1, 2, 4, 8, 16, 32, 64, 128, 256])

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for step in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0):
        plant = Plant(step)
        alone = throughput(plant, costs, 256, 0)
        ups = [throughput(plant, costs, 256, int(w)) / alone for w in counts]
        axes[0].loglog(counts, ups, label=f"{step:g} s")
    axes[0].loglog(counts, counts, color="0.6", linestyle=":", marker="", label="Ideal")
    axes[0].set(
        xlabel="Workers", ylabel="Speed-up over one process", title="256 environments, equal steps"
    )
    axes[0].legend(title="One step takes", fontsize=7, title_fontsize=7)
    for std in (0.0, 0.2, 0.5, 1.0, 2.0):
        plant = Plant(0.1, std)
        alone = throughput(plant, costs, 256, 0)
        ups = [throughput(plant, costs, 256, int(w)) / alone for w in counts]
        axes[1].loglog(counts, ups, label=f"{std:g}")
    axes[1].loglog(counts, counts, color="0.6", linestyle=":", marker="")
    axes[1].set(xlabel="Workers", title="256 environments, 0.1 s a step, segments of unequal time")
    axes[1].legend(title="Std / mean", fontsize=7, title_fontsize=7)
    save(figure, folder / "scaling_workers.svg")

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    budget = 500_000
    for step in (1e-4, 1e-3, 1e-2, 1e-1, 1.0):
        plant = Plant(step)
        hours = [budget / throughput(plant, costs, 256, int(w)) / 3600 for w in counts]
        (line,) = axes[0].loglog(counts, hours, label=f"{step:g} s")
        ten = budget / throughput(plant, costs, 10, 10) / 3600
        axes[0].scatter([10], [ten], s=45, facecolors="none", edgecolors=line.get_color())
    axes[0].set(
        xlabel="Workers",
        ylabel="Hours",
        title="500,000 steps, 256 environments (o: 10 with 10 workers)",
    )
    axes[0].legend(title="One step takes", fontsize=7, title_fontsize=7)
    some = np.array([1, 2, 4, 10, 20, 50, 100, 256])
    for segment, segments in ((5, 1), (10, 4), (20, 5)):
        updates = budget / (some * segment * segments)
        axes[1].loglog(some, updates, label=f"N = {segment}, H = {segments}")
    axes[1].set(
        xlabel="Environments", ylabel="Updates of the parameters", title="What 500,000 steps buy"
    )
    axes[1].legend(fontsize=7)
    save(figure, folder / "scaling_time.svg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure", action="store_true", help="hold the model to the executors")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--out", type=Path, default=FIGURES)
    options = parser.parse_args()
    if options.measure:
        ratios = compare((0, 1, 2, 4, 8), options.rounds)
        print(f"measured / model: from {min(ratios):.2f} to {max(ratios):.2f}")
        return
    draw(Costs(), options.out)


if __name__ == "__main__":
    main()
