"""A simulation of the suite's loops that is independent of `zoac.envs`.

`benchmarks.loop_specs` finds specs for each plant of `zoac.tasks.suite.loops`. The simulation
differs from `zoac.envs.linear_loop` in its method: python-control samples the plant four times per
sample, the dead time is a whole number of these, and the PID is written out again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import control
import numpy as np

from zoac.tasks.suite.loops import Plant

FREQUENCIES = 6000
"""At which margins are looked for, logarithmic below the Nyquist frequency."""

FINE = 4
"""Steps of the simulation per sample."""

NAMES = ("Kp", "Ki", "Kd", "Tf")


@cache
def fine(plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B and C of a plant at a quarter of the sample time."""
    space = control.sample_system(control.ss(plant.system), plant.sample_time / FINE, "zoh")
    return space.A, space.B[:, 0], space.C[0]


def lag(plant: Plant) -> int:
    """Return the dead time of a plant in quarters of a sample."""
    return round(plant.dead_time * FINE / plant.sample_time)


@dataclass(frozen=True)
class Experiment:
    """A step of the reference, and later one of the load at the input.

    Args:
        steps: Samples in all.
        load_at: Sample at which the load begins.
        reference: Height of the reference's step.
        load: Height of the load's step.
    """

    steps: int
    load_at: int
    reference: float = 1.0
    load: float = 0.0


def simulate(
    plant: Plant, gains: Mapping[str, Any], experiment: Experiment, noises: np.ndarray
) -> np.ndarray:
    """Return the outputs (B, T + 1) at the samples.

    Args:
        plant: What is controlled.
        gains: Kp, Ki, Kd and Tf, each (B,) or a number; those missing are 0.
        experiment: What happens.
        noises: Errors of the measurement (B, T + 1).
    """
    a, b, c = fine(plant)
    kp, ki, kd, tf = (np.asarray(gains.get(name, 0.0), dtype=float) for name in NAMES)
    ts, rows = plant.sample_time, len(noises)
    low, high = plant.input_limits
    x, integral, filtered = np.zeros((rows, len(c))), np.zeros(rows), np.zeros(rows)
    past = [np.zeros(rows) for _ in range(lag(plant))]
    outputs, last = [], None
    for k in range(experiment.steps + 1):
        y = x @ c
        outputs.append(y)
        measured = y + noises[:, k]
        error = experiment.reference - measured
        slope = 0.0 if last is None else -(measured - last) / ts
        last = measured
        filtered = (tf * filtered + ts * slope) / (tf + ts)
        wanted = kp * error + integral + kd * filtered
        u = np.minimum(np.maximum(wanted, low), high)
        # Conditional integration: not further into a limit.
        held = ((wanted > high) & (ki * error > 0)) | ((wanted < low) & (ki * error < 0))
        integral = integral + np.where(held, 0.0, ki * ts * error)
        acting = u + (experiment.load if k >= experiment.load_at else 0.0)
        for _ in range(FINE):
            past.append(acting)
            x = x @ a.T + past.pop(0)[:, None] * b
        np.clip(x, -1e12, 1e12, out=x)
    return np.stack(outputs, axis=1)


def figures(y: np.ndarray, plant: Plant, experiment: Experiment, band: float) -> dict[str, Any]:
    """Return overshoot, settling time [s] and IAE of outputs (B, T + 1), each (B,)."""
    until = experiment.load_at + 1
    part = y[:, :until] / experiment.reference
    overshoot = np.maximum(0.0, part.max(axis=1) - 1.0)
    outside = np.abs(part - 1.0) > band
    last = until - 1 - np.argmax(outside[:, ::-1], axis=1)
    settled = np.where(outside[:, -1], np.inf, (last + 1) * plant.sample_time)
    settled = np.where(outside.any(axis=1), settled, 0.0)
    error = np.abs(experiment.reference - y)
    iae = plant.sample_time * (error.sum(axis=1) - 0.5 * (error[:, 0] + error[:, -1]))
    return {"overshoot": overshoot, "settling_time": settled, "iae": iae}


def sampled_plant(plant: Plant) -> Any:
    """Return the plant at the samples as a python-control system, its dead time included."""
    a, b, c = fine(plant)
    quarters = [np.linalg.matrix_power(a, i) @ b for i in range(FINE)]
    powers = np.linalg.matrix_power(a, FINE)
    whole, rest = divmod(lag(plant), FINE)
    # The last `rest` quarters of a step see the input one sample later than the first do.
    early = sum((quarters[i] for i in range(FINE - rest, FINE)), np.zeros_like(b))
    late = sum((quarters[i] for i in range(FINE - rest)), np.zeros_like(b))
    inputs = np.stack([late, early], axis=1)
    core = control.ss(powers, inputs, c[None], 0, plant.sample_time)
    # Outputs: the input, and the input one sample ago.
    both = control.ss([[0.0]], [[1.0]], [[0.0], [1.0]], [[1.0], [0.0]], plant.sample_time)
    system = core * both
    for _ in range(whole):
        system = system * control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], plant.sample_time)
    return system


def controller(gains: Mapping[str, float], sample_time: float) -> Any:
    """Return the PID at the samples as a python-control system."""
    kp, ki, kd, tf = (float(gains.get(name, 0.0)) for name in NAMES)
    pid = control.tf([kp, ki * sample_time - kp], [1, -1], sample_time)
    if kd:
        pid = pid + control.tf([kd, -kd], [tf + sample_time, -tf], sample_time)
    return control.ss(pid)


def margins(plant: Plant, gains: Mapping[str, float]) -> dict[str, float]:
    """Return gain margin, phase margin [deg] and Ms by python-control."""
    loop = sampled_plant(plant) * controller(gains, plant.sample_time)
    if np.abs(control.feedback(loop, 1).poles()).max() >= 1.0 - 1e-9:
        return {"gain_margin": 0.0, "phase_margin": 0.0, "max_sensitivity": np.inf}
    omega = np.logspace(-5, 0, FREQUENCIES) * np.pi / plant.sample_time
    response = control.frequency_response(loop, omega)
    gain, phase, *_ = control.stability_margins(response, returnall=True)
    values = np.asarray(response.complex).reshape(-1)
    return {
        "gain_margin": float(gain[gain > 1].min(initial=np.inf)),
        "phase_margin": float(np.abs(phase).min(initial=np.inf)),
        "max_sensitivity": float((1 / np.abs(1 + values)).max()),
    }
