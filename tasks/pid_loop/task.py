"""A PID in a loop with linear plants, as a task."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from zoac.controllers.pid import PID
from zoac.controllers.pid_loop import LoopsPID, SampledLoop
from zoac.core.parameters import ParameterSpace
from zoac.envs.linear_loop import LoopVecEnv, SampledPlant
from zoac.rollout.task import Task
from zoac.specs.judge import Judge
from zoac.specs.spec import Spec
from zoac.tasks.pid_loop.requirements import closed_loops, fitted, objective_of, signals_of

STRICT_DRAWS = 7
"""Draws of a larger noise, beside the one that was asked for, on which the search judges hard
specs: those that hold there hold for the noise that was asked for in many more episodes than a
search can spend."""

RESERVE = 1.75
"""The larger noise over the one that was asked for."""


@dataclass(frozen=True)
class Experiment:
    """What one episode is.

    Args:
        steps: Its length.
        load_at: Step at which a load begins to act at the input.
        reference: Height of the reference's step.
        loads: Heights of the load's step, one per plant.
        noise: Standard deviation of the measurement.
        settled: Steps that a good loop takes to settle, its dead time included; 0: not known.
    """

    steps: int
    load_at: int
    reference: float
    loads: tuple[float, ...]
    noise: float = 0.0
    settled: int = 0

    @property
    def noises(self) -> tuple[float, ...]:
        """Standard deviations of the draws that each plant meets at once, `noise` the first."""
        larger = STRICT_DRAWS if self.noise else 0
        return (self.noise, *[RESERVE * self.noise] * larger)


class PidLoop(Task):
    """The gains of one PID that is to serve every plant of a list: the worst one counts."""

    def __init__(
        self,
        plants: Sequence[SampledPlant],
        pid: PID,
        space: ParameterSpace,
        experiment: Experiment,
        baseline: Mapping[str, float] | None = None,
        specs: Sequence[Spec] = (),
        objective: str | Spec = "iae",
    ) -> None:
        """
        Args:
            plants: From `zoac.envs.linear_loop.sampled`, all of one sample time.
            space: Of the gains, in the form of `pid`.
            baseline: Present gains.
            specs: Hard specs of `y`, `r` and `u`, and of the loop.
            objective: "iae", "ise" or "itae" of `y` and `r`, or a spec without a limit.

        Raises:
            ConfigError: If the objective is neither.
        """
        self.plants, self.pid, self.space = tuple(plants), pid, space
        self.experiment, self.baseline = experiment, baseline
        self.sample_time = pid.sample_time
        self.shortest_horizon = experiment.settled
        asked = range(0, self.loops, len(experiment.noises))
        self.signals = signals_of(self.loops, asked)
        larger = signals_of(self.loops, [k for k in range(self.loops) if k not in asked])
        self._closed = partial(closed_loops, [SampledLoop(plant) for plant in self.plants], pid)
        load_at = experiment.load_at * pid.sample_time
        minimised = objective_of(objective, len(self.plants))
        self.specs = (*(fitted(spec, self._closed, load_at) for spec in specs), minimised)
        self.objective = str(minimised)
        # On the larger noise; without any, all episodes are the same.
        hard = [spec for spec in self.specs if spec.hard and experiment.noise]
        self.strict = Judge(hard, larger, pid.sample_time, experiment.steps, space.named)

    @property
    def loops(self) -> int:
        """Number of loops m that stand side by side in one environment."""
        return len(self.plants) * len(self.experiment.noises)

    def make_env(self, n: int) -> LoopVecEnv:
        """Return `n` environments of m loops each."""
        e = self.experiment
        return LoopVecEnv(
            self.plants,
            n,
            max_episode_steps=e.steps,
            load_at=e.load_at,
            reference=e.reference,
            loads=e.loads,
            input_limits=self.pid.output_limits,
            noises=e.noises,
        )

    def is_stable(self, gains: Mapping[str, float]) -> bool:
        """Return whether these gains stabilise every plant, in a loop without limits."""
        return all(loop.stable for loop in self._closed(gains))

    def make_controller(self) -> Any:
        """Return the PID in each loop."""
        return LoopsPID(self.pid, self.loops)
