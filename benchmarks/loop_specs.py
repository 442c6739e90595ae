"""Specs for the plants of `benchmarks.loop_plants`, each with gains that meet them as evidence.

    python -m benchmarks.loop_specs > benchmarks/loops.csv

A random search over the gains, two thousand points per plant, simulates each point with several
draws of the noise. Limits of overshoot and sensitivity are drawn; the settling time is that of the
best point within them, lengthened a little. The best point is the evidence.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loop_plants import (
    NAMES,
    Experiment,
    figures,
    margins,
    sampled_plant,
    simulate,
)
from zoac.tasks.suite.loops import Plant, draw

TABLE = Path(__file__).with_name("loops.csv")
PLANTS = 100
POINTS = {"PI": 800, "PID": 2000}
NOISES = 4
"""Draws of the noise that each point meets."""

BANDS = (0.02, 0.05)
RESERVE = 0.95
"""The evidence keeps the drawn limits times this."""


@dataclass(frozen=True)
class Specs:
    """Hard specs of a plant, and gains that meet them.

    Args:
        overshoot: Largest overshoot, a fraction of the step.
        settling_time: Largest settling time [s].
        band: Of the settling time.
        max_sensitivity: Largest Ms; infinite: not asked for.
        gain_margin: Smallest gain margin; 0: not asked for.
        phase_margin: Smallest phase margin [deg].
        evidence: Gains that meet all of them.
        part: Fraction of the searched points that meet them.
    """

    overshoot: float
    settling_time: float
    band: float
    max_sensitivity: float
    gain_margin: float
    phase_margin: float
    evidence: Mapping[str, float]
    part: float

    def broken(self, plant: Plant, gains: Mapping[str, float], seed: int, draws: int) -> list[str]:
        """Return the names of the specs that gains break, by simulation and by python-control."""
        load_at = math.ceil(max(3 * self.settling_time, 4 * plant.scale) / plant.sample_time)
        experiment = Experiment(load_at, load_at)
        noises = np.random.default_rng([seed, plant.index]).normal(
            0.0, plant.noise, (draws, load_at + 1)
        )
        y = simulate(plant, gains, experiment, noises)
        seen = figures(y, plant, experiment, self.band)
        reached = margins(plant, gains)
        kept = {
            "overshoot": seen["overshoot"].max() <= self.overshoot,
            "settling_time": seen["settling_time"].max() <= self.settling_time + 1e-9,
            "max_sensitivity": reached["max_sensitivity"] <= self.max_sensitivity * 1.001,
            "gain_margin": reached["gain_margin"] >= self.gain_margin * 0.999,
            "phase_margin": reached["phase_margin"] >= self.phase_margin - 0.05,
        }
        return [name for name, holds in kept.items() if not holds]


def found(plant: Plant, seed: int = 0) -> Specs:
    """Return specs of a plant by the random search."""
    rng = np.random.default_rng([seed, plant.index, 1])
    points = _points(plant, rng)
    load_at = math.ceil(8 * plant.scale / plant.sample_time)
    experiment = Experiment(load_at, load_at)
    noises = rng.normal(0.0, plant.noise, (NOISES, load_at + 1))
    rows = {name: np.repeat(values, NOISES) for name, values in points.items()}
    count = len(points["Kp"])
    y = simulate(plant, rows, experiment, np.tile(noises, (count, 1)))
    band = float(rng.choice(BANDS)) if plant.noise < 0.004 else 0.05
    seen = {
        name: values.reshape(count, NOISES)
        for name, values in figures(y, plant, experiment, band).items()
    }
    overshoot, settled = seen["overshoot"].max(axis=1), seen["settling_time"].max(axis=1)
    peak = _sensitivity(plant, points)
    good = np.isfinite(settled)
    unstable = plant.kind == "unstable"
    overshoots = (0.3, 0.5, 0.8) if unstable else (0.02, 0.05, 0.1, 0.2)
    most = {
        "overshoot": float(rng.choice(overshoots)),
        "peak": rng.uniform(2.5, 4.0) if unstable else rng.uniform(1.5, 2.2),
    }
    while True:
        within = (
            good & (overshoot <= RESERVE * most["overshoot"]) & (peak <= RESERVE * most["peak"])
        )
        if within.any():
            best = int(np.where(within, settled, np.inf).argmin())
            gains = {name: float(values[best]) for name, values in points.items()}
            specs = _specs(plant, gains, most, float(settled[best]), band, rng)
            if not specs.broken(plant, gains, seed + 1, 20):
                kept = within & (settled <= specs.settling_time)
                return replace(specs, part=float(kept.mean()))
        most = {name: 1.25 * limit for name, limit in most.items()}


def _specs(
    plant: Plant,
    gains: Mapping[str, float],
    most: Mapping[str, float],
    settled: float,
    band: float,
    rng: np.random.Generator,
) -> Specs:
    """Return limits around what the gains reach."""
    by_margins = rng.uniform() < 0.4 and plant.kind != "unstable"
    reached = margins(plant, gains)
    return Specs(
        overshoot=round(most["overshoot"], 4),
        settling_time=float(f"{settled * rng.uniform(1.15, 1.5):.4g}"),
        band=band,
        max_sensitivity=math.inf if by_margins else round(most["peak"], 3),
        gain_margin=round(0.9 * min(reached["gain_margin"], 5.0), 3) if by_margins else 0.0,
        phase_margin=round(0.9 * reached["phase_margin"], 1) if by_margins else 0.0,
        evidence=gains,
        part=0.0,
    )


def _points(plant: Plant, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return random gains (P,) each, around the frequency at which the phase is -180 degrees."""
    omega = np.geomspace(1e-3, 1.0, 3000) * math.pi / plant.sample_time
    system = plant.system
    response = np.asarray(system(1j * omega)).reshape(-1)
    sign = 1.0 if plant.input_limits[1] > -plant.input_limits[0] else -1.0
    phase = np.unwrap(np.angle(sign * response))
    phase = phase - omega * (plant.dead_time + plant.sample_time / 2)
    below = np.flatnonzero((phase[:-1] > -np.pi) & (phase[1:] <= -np.pi))
    k = below[0] if len(below) else len(omega) // 2
    count = POINTS[plant.structure]
    kp = sign / np.abs(response[k]) * 10.0 ** rng.uniform(-1.7, 0.0, count)
    points = {"Kp": kp, "Ki": kp * omega[k] * 10.0 ** rng.uniform(-2.3, 0.3, count)}
    if plant.structure == "PID":
        td = 10.0 ** rng.uniform(-1.2, 0.3, count) / omega[k]
        points |= {"Kd": kp * td, "Tf": td * 10.0 ** rng.uniform(-1.3, -0.3, count)}
    return points


def _sensitivity(plant: Plant, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return max |1 / (1 + L)| of each point, (P,)."""
    omega = np.geomspace(1e-4, 1.0, 800) * math.pi / plant.sample_time
    z, ts = np.exp(1j * omega * plant.sample_time), plant.sample_time
    response = np.asarray(sampled_plant(plant)(z)).reshape(-1)
    kp, ki, kd, tf = (points.get(name, np.zeros(1))[:, None] for name in NAMES)
    pid = kp + ki * ts / (z - 1) + kd * (z - 1) / ((tf + ts) * z - tf)
    return (1.0 / np.abs(1.0 + response * pid)).max(axis=1)


COLUMNS = (
    "index", "overshoot", "settling_time", "band", "max_sensitivity", "gain_margin",
    "phase_margin", *NAMES, "part",
)  # fmt: skip


def row(index: int, specs: Specs) -> dict[str, Any]:
    """Return a row of the table."""
    plain = {name: getattr(specs, name) for name in COLUMNS[1:7]}
    gains = {name: f"{specs.evidence[name]:.6g}" for name in specs.evidence}
    return {"index": index, **plain, **gains, "part": f"{specs.part:.4f}"}


def read(path: Path = TABLE) -> dict[int, Specs]:
    """Return the specs of the table by plant."""
    with path.open(newline="") as file:
        return {
            int(line["index"]): Specs(
                **{name: float(line[name]) for name in COLUMNS[1:7]},
                evidence={name: float(line[name]) for name in NAMES if line[name]},
                part=float(line["part"]),
            )
            for line in csv.DictReader(file)
        }


def main() -> None:
    """Print the table."""
    writer = csv.DictWriter(sys.stdout, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for index in range(PLANTS):
        writer.writerow(row(index, found(draw(index))))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
