"""Plants that are slow for their sample time, and answers whose loop is unstable."""

import re

import numpy as np
import pytest

import zoac
from zoac import specs
from zoac.core.errors import ConfigError
from zoac.pid import tuning
from zoac.tasks.pid_loop import Design, design, designed

control = pytest.importorskip("control")

LIMITS = {"none": (-np.inf, np.inf), "weak": (-1.2, 1.2)}


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Short episodes show the same, sooner."""
    monkeypatch.setattr(design, "MAX_STEPS", 100)
    monkeypatch.setattr(tuning, "EPISODES", 24)


@pytest.mark.parametrize(
    ("plant", "dead_time", "limits", "required", "said"),
    [
        (control.tf([1], [1, 1]), 3.0, "none", [], "the dead time is 3 s"),
        (control.tf([2], [60, 1]), 20.0, "none", [], "the dead time is 20 s"),
        (control.tf([1], [10, 1]), 0.05, "none", [specs.settling_time(max=20)], "allows 20 s"),
        (control.tf([1], [10, 1]), 0.05, "weak", [], "a good loop takes about"),
    ],
)
def test_a_sample_time_too_small_for_the_plant_is_refused_with_one_that_is_not(
    plant, dead_time, limits, required, said
):
    def loop(sample_time):
        asked = Design([plant], [dead_time], sample_time, input_limits=LIMITS[limits])
        return designed(asked, "simc", required)[0]

    with pytest.raises(ConfigError, match=said) as refused:
        loop(0.001)
    sample_time = float(re.search(r"give a sample_time of (\S+) s or more", str(refused.value))[1])
    task = loop(sample_time)
    seconds = task.experiment.load_at * sample_time
    assert seconds >= max([2 * dead_time, *(spec.max for spec in required)])
    # The plant moves in that time: with its largest input the output comes past the reference.
    assert LIMITS[limits][1] * (1 - np.exp(-seconds / plant.den[0][0][0])) > 0.8


def test_an_unstable_loop_is_never_met():
    """What P stabilises, -P does not: at rest the sign of the integral's feedback is the other."""
    plant = control.tf([1], [1, 1])
    result = zoac.tune_pid(
        [plant, -plant], dead_time=0.1, sample_time=0.1, specs=[specs.overshoot(max=0.05)]
    )
    s = control.tf("s")
    pi = result.parameters["Kp"] + result.parameters["Ki"] / s
    poles = [control.feedback(sign * plant * pi, 1).poles().real.max() for sign in (1, -1)]
    assert max(poles) > 0
    assert "unstable" in result.warnings[0]
    assert not result.feasible
    assert True not in result.specs["met"].tolist()
    assert "NOT MET" in str(result)
