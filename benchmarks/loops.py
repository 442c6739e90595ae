"""Tune a PID for each plant of the suite, and judge the answers by another simulation.

    python -m benchmarks.loops                 # 100 plants
    python -m benchmarks.loops --plants 0:7 --out loops_run.csv

Every answer is judged on noise that tuning did not see, by the simulation of
`benchmarks.loop_plants` and by python-control's margins. It beats other gains if it keeps all hard
specs and they do not, or, where both or neither keep them, if its integral of the absolute error is
smaller. A rule without an answer for a plant is beaten.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loop_plants import Experiment, figures, simulate
from benchmarks.loop_specs import Specs, read
from zoac import specs as requirements
from zoac.controllers import tuning_rules
from zoac.core.errors import ConfigError
from zoac.pid.tuning import PidResult, tune_pid
from zoac.tasks.suite.loops import Plant, draw

DRAWS = 20
"""Draws of the noise on which an answer is judged."""

JUDGES = 12345
"""Seed of the noise on which an answer is judged."""


@dataclass(frozen=True)
class Verdict:
    """What became of one plant.

    Args:
        index: Number in the suite.
        kind: Class of the plant.
        structure: "PI" or "PID".
        broken: Hard specs that the answer breaks.
        against: "better", "equal" or "worse", by whom it is compared with: the baseline,
            Ziegler-Nichols, SIMC, and the evidence that the specs can be met.
        iae: Of the answer, and of those that it is compared with; infinite without an answer.
        kept: Whether those keep all hard specs.
        seconds: CPU time of tuning.
    """

    index: int
    kind: str
    structure: str
    broken: str
    against: Mapping[str, str]
    iae: Mapping[str, float]
    kept: Mapping[str, bool]
    seconds: float

    @property
    def row(self) -> dict[str, Any]:
        """A row of the table."""
        plain = asdict(self)
        against, iae, kept = (plain.pop(name) for name in ("against", "iae", "kept"))
        return {
            **plain,
            **{f"kept_{who}": held for who, held in kept.items()},
            **{f"against_{who}": told for who, told in against.items()},
            **{f"iae_{who}": f"{value:.5g}" for who, value in iae.items()},
        }


def tuned(plant: Plant, specs: Specs, seed: int = 0) -> PidResult:
    """Return the answer of `tune_pid` with its defaults."""
    hard = [
        requirements.overshoot("y", "r", max=specs.overshoot),
        requirements.settling_time("y", "r", band=specs.band, max=specs.settling_time),
    ]
    if math.isfinite(specs.max_sensitivity):
        hard.append(requirements.max_sensitivity(max=specs.max_sensitivity))
    if specs.gain_margin:
        hard.append(requirements.gain_margin(min=specs.gain_margin))
        hard.append(requirements.phase_margin(min=specs.phase_margin))
    return tune_pid(
        plant.system,
        dead_time=plant.dead_time,
        sample_time=plant.sample_time,
        structure=plant.structure,
        input_limits=plant.input_limits,
        noise=plant.noise,
        specs=hard,
        seed=seed,
    )


def judged(plant: Plant, specs: Specs, seed: int = 0) -> Verdict:
    """Tune a PID for a plant and judge the answer."""
    begun = time.process_time()
    result = tuned(plant, specs, seed)
    seconds = time.process_time() - begun
    gains: dict[str, Mapping[str, float] | None] = {
        "answer": result.parameters,
        "baseline": result.baseline,
        "ziegler_nichols": by_rule("ziegler_nichols", plant),
        "simc": by_rule("simc", plant),
        "evidence": specs.evidence,
    }
    task = result.run.task
    experiment = task.experiment  # type: ignore[union-attr]
    same = Experiment(
        experiment.steps, experiment.load_at, experiment.reference, experiment.loads[0]
    )
    noises = np.random.default_rng([JUDGES, plant.index]).normal(
        0.0, plant.noise, (DRAWS, same.steps + 1)
    )
    iae, broken = {}, {}
    for who, values in gains.items():
        iae[who], broken[who] = math.inf, ["no answer"]
        if values is not None:
            y = simulate(plant, values, same, noises)
            iae[who] = float(figures(y, plant, same, specs.band)["iae"].mean())
            broken[who] = specs.broken(plant, values, JUDGES, DRAWS)
    against = {
        who: compared(iae["answer"], broken["answer"], iae[who], broken[who])
        for who in gains if who != "answer"
    }  # fmt: skip
    return Verdict(
        plant.index,
        plant.kind,
        plant.structure,
        " ".join(broken["answer"]),
        against,
        iae,
        {who: not broken[who] for who in against},
        seconds,
    )


def compared(iae: float, broken: list[str], other: float, other_broken: list[str]) -> str:
    """Return "better", "equal" or "worse": feasibility first, then the objective."""
    if bool(broken) != bool(other_broken):
        return "worse" if broken else "better"
    return "better" if iae < other else "equal" if iae == other else "worse"


def by_rule(rule: str, plant: Plant) -> dict[str, float] | None:
    """Return the gains of a rule; None if it has no answer."""
    try:
        gains = tuning_rules.gains(
            rule, plant.system, plant.structure, plant.dead_time, plant.sample_time
        )
    except ConfigError:
        return None
    return gains if all(map(math.isfinite, gains.values())) and gains["Kp"] else None


def report(verdicts: list[Verdict]) -> str:
    """Return what all plants came to, some lines of text."""
    count = len(verdicts)
    met = sum(not v.broken for v in verdicts)
    lines = [f"hard specs met: {met} of {count}"]
    for who in ("baseline", "ziegler_nichols", "simc", "evidence"):
        told = [v.against[who] for v in verdicts]
        ratios = [v.iae["answer"] / v.iae[who] for v in verdicts if math.isfinite(v.iae[who])]
        lines.append(
            f"against {who}: better {told.count('better')}, equal {told.count('equal')}, worse "
            f"{told.count('worse')}; IAE over theirs, median {np.median(ratios):.3f}, smaller in "
            f"{sum(r < 1 for r in ratios)} of {len(ratios)}"
        )
        rivals = [v for v in verdicts if v.kept[who]]
        lines.append(
            f"  {who} keeps all hard specs on {len(rivals)} plants; the answer does too, with a "
            f"smaller IAE, on {sum(v.against[who] == 'better' for v in rivals)} of them"
        )
    seconds = [v.seconds for v in verdicts]
    lines.append(f"CPU seconds a plant: median {np.median(seconds):.2f}, most {max(seconds):.2f}")
    return "\n".join(lines)


def main() -> None:
    """Tune for the plants that the command line names, print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", default="0:100", help="first:last, the last not included")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="CSV file, a row per plant")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    table = read()
    verdicts = []
    for index in range(*map(int, arguments.plants.split(":"))):
        verdicts.append(judged(draw(index), table[index], arguments.seed))
        told = verdicts[-1]
        print(index, told.kind, told.structure, told.broken or "met", dict(told.against),
              f"{told.seconds:.1f} s", flush=True)  # fmt: skip
    if arguments.out:
        with arguments.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, verdicts[0].row)
            writer.writeheader()
            writer.writerows(v.row for v in verdicts)
    print(report(verdicts))


if __name__ == "__main__":
    main()
