"""Tune a PID for a plant: `zoac.tune_pid`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.controllers.pid import PID
from zoac.controllers.pid_export import export_pid
from zoac.core.errors import ConfigError
from zoac.core.types import is_number
from zoac.envs.single_env import EnvSource
from zoac.rollout.horizon import horizon_of
from zoac.rollout.task import Task
from zoac.run.api import tune
from zoac.runs.result import Result
from zoac.specs.signals import action, observation
from zoac.specs.spec import Spec
from zoac.tasks.pid_loop import Design, PidLoop, designed
from zoac.tasks.pid_loop.design import space_around, widened
from zoac.tasks.pid_loop.plants import gains_of
from zoac.tasks.pid_loop.requirements import objective_of
from zoac.tasks.user_specs import specs_of
from zoac.tasks.user_task import user_task

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

EPISODES = 1000
"""Simulated experiments per plant; measured on `benchmarks/loops.py`."""

EPISODES_IN_ENVIRONMENT = 400
"""In a user's environment, which may be slow."""

UNSTABLE = (
    "The loop with these gains is unstable, so no spec counts as met. Try another structure, or "
    "plants that differ less."
)

POPULATION = 24
"""Points of a generation, simulated side by side."""


@dataclass(frozen=True)
class PidResult:
    """A tuned PID.

    Args:
        parameters: Gains by name, in parallel form: `Kp`, `Ki`, `Kd`, `Tf`.
        baseline: The gains that it is compared with.
        controller: The PID that these gains belong to, with its limits and anti-windup.
        run: The tuning run, with its folder.
        warnings: What is wrong with the answer or the baseline, one sentence each.
        stable: Whether the gains stabilise every plant; True in an environment, where it is not
            known.
    """

    parameters: dict[str, float]
    baseline: dict[str, float]
    controller: PID
    run: Result = field(repr=False)
    warnings: list[str] = field(default_factory=list)
    stable: bool = True

    @property
    def specs(self) -> pd.DataFrame:
        """What became of each spec; see `Result.specs`. An unstable loop meets none."""
        table = self.run.specs
        if not self.stable:
            table["met"] = [None if met is None else False for met in table["met"]]
        return table

    @property
    def feasible(self) -> bool:
        """Whether the gains stabilise every plant and keep every hard spec."""
        return self.stable and self.run.feasible

    @property
    def folder(self) -> Path:
        """Where the run lies, such as for a report."""
        return self.run.folder

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the responses before and after, with the limits; see `Result.plot`."""
        return self.run.plot(path)

    def standard(self) -> dict[str, float]:
        """Return the gains in standard form, K (1 + 1 / (Ti s) + Td s / (Td / N s + 1))."""
        k, ki, kd, tf = self.controller.gains(self.parameters)
        ti, td = (k / ki if ki else math.inf), kd / k
        return {"K": k, "Ti": ti, "Td": td, "N": td / tf if tf else math.inf}

    def export(self, path: str | Path) -> Path:
        """Write the controller as `.h`, `.m` or `.py`; see `export_pid`."""
        return export_pid(self.controller, self.parameters, path)

    def __str__(self) -> str:
        """Return a table for a terminal: gains and specs, before and after."""
        rows = [("", "baseline", "tuned", "limit", "")]
        rows += [
            (name, f"{self.baseline[name]:.4g}", f"{value:.4g}", "", "")
            for name, value in self.parameters.items()
        ]
        for spec in self.specs.to_dict("records"):
            met = {True: "met", False: "NOT MET"}.get(spec["met"], "")
            values = (f"{spec[which]:.4g}" for which in ("baseline", "value"))
            rows.append((spec["spec"], *values, spec["limit"] or "", met))
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines = [
            f"{row[0]:<{widths[0]}}  {row[1]:>{widths[1]}}  {row[2]:>{widths[2]}}  "
            f"{row[3]:<{widths[3]}}  {row[4]}".rstrip()
            for row in rows
        ]
        return "\n".join([*lines, *(f"warning: {warning}" for warning in self.warnings)])


def tune_pid(
    plant: Any,
    *,
    sample_time: float,
    dead_time: float | Sequence[float] = 0.0,
    structure: str = "PI",
    input_limits: tuple[float, float] | None = None,
    noise: float = 0.0,
    specs: Sequence[Spec] = (),
    objective: str | Spec = "iae",
    baseline: str | Mapping[str, float] = "simc",
    seed: int = 0,
) -> PidResult:
    """Tune a PID for a plant: the specs first, then the objective.

        result = zoac.tune_pid(control.tf([2], [0.1, 0.7, 1]), dead_time=0.1, sample_time=0.05)

    Each experiment is a step of the reference and later a step of a load at the plant's input. The
    signals are `y` (without the noise), `r` and `u`. Specs of the reference's step are judged until
    the load begins. Margins need no `loop=` and cost no simulation.

    Args:
        plant: A continuous system of python-control with one input and one output; or a list of
            such, of which the worst counts. Or a Gymnasium environment (its id, a function that
            makes it, or itself) whose observation is (y, r, ...) and whose action is u.
        sample_time: Sample time of the controller [s].
        dead_time: Dead time of the plant [s], or a list with one for each plant.
        structure: "P", "PI", "PD" or "PID".
        input_limits: Smallest and largest input, as deviations from the input at rest. The PID
            has anti-windup at these limits.
        noise: Standard deviation of the measurement, in the unit of y.
        specs: Requirements, such as `zoac.specs.overshoot("y", "r", max=0.05)`.
        objective: "iae", "ise" or "itae" of `y` and `r`, or a spec without a limit.
        baseline: "ziegler_nichols", "simc" or "tyreus_luyben", or your present gains by name. The
            answer is never worse on held-out episodes. An environment needs gains.
        seed: Seed of all random numbers.

    Raises:
        ConfigError: If something given cannot be used.
    """
    limits = (-math.inf, math.inf) if input_limits is None else input_limits
    pair = isinstance(limits, tuple | list) and len(limits) == 2 and all(map(is_number, limits))
    if not (pair and limits[0] < limits[1]):
        raise ConfigError(f"input_limits={input_limits!r}: expected (low, high), such as (-12, 12)")
    limits = (float(limits[0]), float(limits[1]))
    required = specs_of(specs)
    systems = list(plant) if isinstance(plant, list | tuple) else [plant]
    if not systems:
        raise ConfigError("plant=[]: expected a system of python-control, or several")
    if not hasattr(systems[0], "poles"):
        for name, value in (("dead_time", dead_time), ("noise", noise)):
            if not is_number(value) or value:
                raise ConfigError(f"{name}={value!r}: an environment has its own")
        pid = PID(sample_time=sample_time, r=1, output_limits=limits)
        in_environment = _in_environment(plant, pid, structure, required, objective, baseline)
        return _tuned(in_environment, pid, EPISODES_IN_ENVIRONMENT, seed, [])
    dead_times = _dead_times(dead_time, len(systems))
    design = Design(systems, dead_times, sample_time, structure, limits, noise)
    task, remarks = designed(design, baseline, required, objective)
    result = _tuned(task, task.pid, EPISODES, seed, remarks)
    space = widened(task.space, result.parameters)
    if result.run.feasible or space.parameters == task.space.parameters:
        return result
    task = PidLoop(
        task.plants, task.pid, space, task.experiment, task.baseline, required, objective
    )
    return _tuned(task, task.pid, EPISODES, seed, remarks)


def _dead_times(given: Any, plants: int) -> list[float]:
    """Return a dead time [s] for each plant."""
    if is_number(given):
        return [given] * plants
    if not isinstance(given, list | tuple | np.ndarray) or np.ndim(given) != 1:
        raise ConfigError(f"dead_time={given!r}: expected seconds, or a list with one per plant")
    if len(given) != plants:
        raise ConfigError(f"{len(given)} dead times for {plants} plants")
    return list(given)


def _in_environment(
    env: EnvSource,
    pid: PID,
    structure: str,
    specs: Sequence[Spec],
    objective: str | Spec,
    baseline: str | Mapping[str, float],
) -> Task:
    """Return a PID in a user's environment as a task; see `tune_pid`."""
    if isinstance(baseline, str):
        raise ConfigError(
            f"baseline={baseline!r}: rules need a system of python-control; for an environment "
            "give the gains of today, such as {'Kp': 1.0, 'Ki': 0.5}"
        )
    gains = gains_of(structure, baseline)
    return user_task(
        env=env,
        controller=pid,
        space=space_around(gains, gains, pid.sample_time),
        baseline=gains,
        signals={"y": observation(0), "r": observation(1), "u": action(0)},
        sample_time=pid.sample_time,
        specs=specs,
        objective=objective_of(objective, 1),
    )


def _tuned(task: Task, pid: PID, episodes: int, seed: int, remarks: list[str]) -> PidResult:
    """Tune a task, the baseline among the candidates for the answer."""
    options: dict[str, Any] = {
        "start": "middle",
        "recommendation": "reevaluated",
        "reevaluate_top": 30,
        "reevaluate_fraction": 0.2,
    }
    alone = task.space.dimension == 1  # CMA-ES needs two parameters or more
    if not alone:
        options |= {"population": POPULATION, "initial_sigma": 0.5}
    run = tune(
        task=task,
        tuner="nevergrad" if alone else "cmaes_full",
        tuner_options=options,
        budget=episodes * horizon_of(task).steps,
        num_envs=POPULATION,
        common_random_numbers=True,
        eval_every=episodes * horizon_of(task).steps,
        episodes=1,
        final_episodes=20,
        seed=seed,
        quiet=True,
    )
    assert task.baseline is not None
    warnings, stable = [*remarks, *run.warnings], True
    if isinstance(task, PidLoop):
        # A loop that diverges slowly may keep every spec as long as an episode lasts.
        stable = task.is_stable(run.parameters)
        warnings = warnings if stable else [UNSTABLE, *warnings]
        if not task.is_stable(task.baseline):
            warnings.append("The loop with the baseline is not stable.")
    return PidResult(run.parameters, dict(task.baseline), pid, run, warnings, stable)
