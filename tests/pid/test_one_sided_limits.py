"""Inputs that act in one direction only: heaters, coolers, valves."""

import numpy as np
import pytest

from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.pid_loop import Design, design, designed

control = pytest.importorskip("control")

HEATED, COOLED = control.tf([2], [1, 1]), control.tf([-2], [1, 1])
FILLED, DRAINED = control.tf([1], [1, 0]), control.tf([-1], [1, 0])


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(design, "MAX_STEPS", 200)


def loop(plants, limits):
    asked = Design(plants, [0.1] * len(plants), 0.05, "PI", limits)
    return designed(asked, "simc")[0]


@pytest.mark.parametrize(
    ("plant", "limits", "expected"),
    [
        (HEATED, (0.0, 5.0), 1.0),
        (COOLED, (0.0, 5.0), -1.0),
        (HEATED, (-5.0, 0.0), -1.0),
        (COOLED, (-0.3, 0.0), 0.4),  # two thirds of what the input can hold
        (COOLED, (0.0, 0.3), -0.4),
        (FILLED, (0.0, 5.0), 1.0),
        (DRAINED, (0.0, 5.0), -1.0),
        (COOLED, (-5.0, 5.0), 1.0),
    ],
)
def test_the_reference_steps_to_where_the_input_can_bring_the_output(plant, limits, expected):
    task = loop([plant], limits)
    assert task.experiment.reference == pytest.approx(expected)
    (segment,) = RolloutEngine(task, [0], [0]).rollout(
        [Proposal(task.space.normalise(task.baseline), 0)]
    )
    y = segment.observations[task.experiment.load_at, -1]
    assert abs(y - expected) < 0.5 * abs(expected)


def test_the_cooler_is_the_heater_with_the_other_sign():
    up, down = loop([HEATED], (0.0, 5.0)), loop([COOLED], (0.0, 5.0))
    assert up.experiment.steps == down.experiment.steps
    assert np.allclose(up.experiment.loads, down.experiment.loads)
    mirrored = {name: -value for name, value in up.baseline.items()}
    assert down.baseline == pytest.approx(mirrored, rel=1e-6)


def test_plants_that_one_input_moves_in_opposite_directions_are_refused():
    with pytest.raises(ConfigError, match="only up and of others only down"):
        loop([HEATED, COOLED], (0.0, 5.0))
