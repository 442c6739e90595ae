"""A few plants of the suite of loops, and the evidence that its specs can be met."""

import numpy as np
import pytest

from benchmarks import loop_plants
from benchmarks.loop_plants import Experiment, figures, simulate
from benchmarks.loop_specs import read
from benchmarks.loops import judged
from zoac.core.segments import Proposal
from zoac.pid import tuning
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.pid_loop import Design, designed
from zoac.tasks.suite.loops import draw

pytest.importorskip("control")

TABLE = read()


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(loop_plants, "FREQUENCIES", 1000)


def test_the_evidence_in_the_table_meets_its_specs():
    assert len(TABLE) == 100
    for index in range(0, 100, 15):  # one of each class
        plant, specs = draw(index), TABLE[index]
        assert specs.broken(plant, specs.evidence, 1, 10) == []


@pytest.mark.parametrize("index", range(7))
def test_the_other_simulation_agrees_with_what_is_tuned(index):
    plant = draw(index)
    design = Design(
        [plant.system], [plant.dead_time], plant.sample_time, plant.structure, plant.input_limits
    )
    task, _ = designed(design, TABLE[index].evidence)
    (segment,) = RolloutEngine(task, [0], [0]).rollout(
        [Proposal(task.space.normalise(task.baseline), 0)]
    )
    e = task.experiment
    same = Experiment(e.steps, e.load_at, e.reference, e.loads[0])
    y = simulate(plant, TABLE[index].evidence, same, np.zeros((1, e.steps + 1)))
    assert np.allclose(segment.observations[:, -1], y[0], rtol=1e-9, atol=1e-9)
    iae = figures(y, plant, same, 0.02)["iae"][0]
    assert segment.costs.sum() == pytest.approx(iae, rel=1e-9)


def test_a_plant_of_the_suite_gets_its_specs_and_beats_the_rules(monkeypatch):
    monkeypatch.setattr(tuning, "EPISODES", 250)  # too few to beat the evidence as well
    verdict = judged(draw(0), TABLE[0])
    assert verdict.broken == ""
    assert verdict.against.keys() == {"baseline", "ziegler_nichols", "simc", "evidence"}
    del verdict.against["evidence"]
    assert set(verdict.against.values()) == {"better"}
