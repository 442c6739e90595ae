"""Plants of the PID literature, and a simulation independent of `zoac.envs`.

The plants are drawn from a seed; `benchmarks.loop_specs` finds specs for each.

The simulation differs from `zoac.envs.linear_loop` in its method: python-control samples the plant
four times per sample, the dead time is a whole number of these, and the PID is written out again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import control
import numpy as np

FINE = 4
"""Steps of the simulation per sample."""

CLASSES = (
    "one lag", "two lags", "integrating", "many lags", "inverse response", "lightly damped",
    "unstable",
)  # fmt: skip
NAMES = ("Kp", "Ki", "Kd", "Tf")


@dataclass(frozen=True)
class Plant:
    """One plant of the suite.

    Args:
        index: Number in the suite.
        kind: One of `CLASSES`.
        system: Continuous, without its dead time.
        dead_time: A multiple of a quarter of the sample time [s].
        sample_time: [s].
        structure: "PI" or "PID".
        input_limits: Smallest and largest input.
        noise: Standard deviation of the measurement; the reference's step is 1.
        scale: Sum of time constants and dead time [s].
    """

    index: int
    kind: str
    system: Any = field(repr=False)
    dead_time: float
    sample_time: float
    structure: str
    input_limits: tuple[float, float]
    noise: float
    scale: float

    @cached_property
    def fine(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C at a quarter of the sample time."""
        space = control.sample_system(control.ss(self.system), self.sample_time / FINE, "zoh")
        return space.A, space.B[:, 0], space.C[0]

    @property
    def lag(self) -> int:
        """Dead time in quarters of a sample."""
        return round(self.dead_time * FINE / self.sample_time)


def draw(index: int, seed: int = 0) -> Plant:
    """Return one plant of the suite."""
    rng = np.random.default_rng([seed, index])
    kind = CLASSES[index % len(CLASSES)]
    unit = 10.0 ** rng.uniform(-1.0, 1.5)  # [s]
    gain = rng.choice([1.0, 1.0, 1.0, -1.0]) * 10.0 ** rng.uniform(-0.5, 0.7)
    s = control.tf([unit, 0], [1])
    dead = 10.0 ** rng.uniform(-1.0, 0.3)
    lags, extra = 1.0, 0.0
    if kind == "one lag":
        shape = 1 / (s + 1)
    elif kind == "two lags":
        second = rng.uniform(0.2, 1.0)
        shape, lags = 1 / ((s + 1) * (second * s + 1)), 1.0 + second
    elif kind == "integrating":
        second = rng.choice([0.0, rng.uniform(0.1, 0.6)])
        shape, lags = 1 / (s * (second * s + 1)), second
        dead = rng.uniform(0.3, 1.0)
    elif kind == "many lags":
        order = int(rng.integers(3, 9))
        shape, lags, dead = 1 / (s + 1) ** order, float(order), rng.uniform(0.0, 0.5)
    elif kind == "inverse response":
        extra = rng.uniform(0.3, 1.5)
        shape, lags, dead = (1 - extra * s) / (s + 1) ** 3, 3.0, rng.uniform(0.0, 0.5)
    elif kind == "lightly damped":
        zeta = rng.uniform(0.1, 0.4)
        shape = 1 / ((s * s + 2 * zeta * s + 1) * (s + 1))
        lags, dead = 3.0, rng.uniform(0.1, 0.5)
    else:
        dead = rng.uniform(0.05, 0.2)
        shape = 1 / (s - 1)
    scale = (lags + dead + extra) * unit
    sample_time = (dead + extra + 0.2 * lags) * unit / rng.uniform(6.0, 12.0)
    quarter = sample_time / FINE
    structure = str(rng.choice(["PI", "PID"])) if kind != "unstable" else "PID"
    # The input that the step needs at rest, or of an integrating plant to be done in `scale`.
    need = 1.0 / abs(gain) / (1.0 if kind != "integrating" else scale / unit)
    most = need * rng.uniform(2.0, 5.0) * (2.0 if kind == "unstable" else 1.0)
    other = most * rng.uniform(0.5, 1.0)
    return Plant(
        index,
        kind,
        gain * shape,
        round(dead * unit / quarter) * quarter,
        sample_time,
        structure,
        (-other, most) if gain > 0 else (-most, other),
        rng.uniform(0.001, 0.01),
        scale,
    )


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
    a, b, c = plant.fine
    kp, ki, kd, tf = (np.asarray(gains.get(name, 0.0), dtype=float) for name in NAMES)
    ts, rows = plant.sample_time, len(noises)
    low, high = plant.input_limits
    x, integral, filtered = np.zeros((rows, len(c))), np.zeros(rows), np.zeros(rows)
    past = [np.zeros(rows) for _ in range(plant.lag)]
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
    a, b, c = plant.fine
    quarters = [np.linalg.matrix_power(a, i) @ b for i in range(FINE)]
    powers = np.linalg.matrix_power(a, FINE)
    whole, rest = divmod(plant.lag, FINE)
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
    omega = np.logspace(-5, 0, 6000) * np.pi / plant.sample_time
    response = control.frequency_response(loop, omega)
    gain, phase, *_ = control.stability_margins(response, returnall=True)
    values = np.asarray(response.complex).reshape(-1)
    return {
        "gain_margin": float(gain[gain > 1].min(initial=np.inf)),
        "phase_margin": float(np.abs(phase).min(initial=np.inf)),
        "max_sensitivity": float((1 / np.abs(1 + values)).max()),
    }
