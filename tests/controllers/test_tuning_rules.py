"""Rules of the trade against their published values."""

import math

import numpy as np
import pytest
from scipy.stats import gamma

from zoac.controllers import tuning_rules
from zoac.core.errors import ConfigError

control = pytest.importorskip("control")


def test_the_ultimate_gain_of_three_equal_lags_is_eight():
    gain, period = tuning_rules.ultimate(control.tf([1], [1, 3, 3, 1]), 0.0)
    assert gain == pytest.approx(8.0, rel=1e-6)
    assert period == pytest.approx(2 * math.pi / math.sqrt(3), rel=1e-6)


def test_a_dead_time_counts_exactly():
    # An integrator with dead time L oscillates at omega = pi / (2 L).
    gain, period = tuning_rules.ultimate(control.tf([1], [1, 0]), 0.5)
    assert period == pytest.approx(2.0, rel=1e-6)
    assert gain == pytest.approx(math.pi, rel=1e-6)


def test_a_plant_of_negative_gain_gets_negative_gains():
    plant = control.tf([1], [1, 3, 3, 1])
    there = tuning_rules.gains("ziegler_nichols", plant)
    here = tuning_rules.gains("ziegler_nichols", -plant)
    assert here == pytest.approx({name: -value for name, value in there.items()}, rel=1e-6)


def test_ziegler_and_nichols_of_a_pid():
    found = tuning_rules.gains("ziegler_nichols", control.tf([1], [1, 3, 3, 1]), "PID")
    period = 2 * math.pi / math.sqrt(3)
    assert found["Kp"] == pytest.approx(4.8, rel=1e-6)
    assert found["Ki"] == pytest.approx(4.8 / (period / 2), rel=1e-6)
    assert found["Kd"] == pytest.approx(4.8 * period / 8, rel=1e-6)


def test_simc_of_a_first_order_plant_with_dead_time_is_skogestads():
    found = tuning_rules.gains("simc", control.tf([2], [4, 1]), "PI", dead_time=0.5)
    assert found["Kp"] == pytest.approx(4 / (2 * 1.0), rel=0.02)
    assert found["Kp"] / found["Ki"] == pytest.approx(4.0, rel=0.02)


def test_simc_of_an_integrating_plant_is_skogestads():
    found = tuning_rules.gains("simc", control.tf([0.5], [1, 0]), "PI", dead_time=1.0)
    assert found["Kp"] == pytest.approx(1 / (0.5 * 2.0), rel=0.02)
    assert found["Kp"] / found["Ki"] == pytest.approx(8.0, rel=0.02)


@pytest.mark.parametrize("rule", ["ziegler_nichols", "tyreus_luyben", "simc"])
@pytest.mark.parametrize("structure", ["P", "PI", "PD", "PID"])
def test_a_loop_by_the_rules_is_stable(rule, structure):
    plant = control.tf([2], [0.1, 0.7, 1])
    found = tuning_rules.gains(rule, plant, structure, dead_time=0.1)
    s = control.tf("s")
    controller = found["Kp"] + found["Ki"] / s + found["Kd"] * s / (found["Tf"] * s + 1)
    loop = plant * controller * control.tf(*control.pade(0.1, 6))
    assert np.all(control.feedback(loop, 1).poles().real < 0)
    assert ("I" in structure) == (found["Ki"] != 0)
    assert ("D" in structure) == (found["Kd"] != 0)


def test_a_plant_that_is_not_for_a_rule_is_refused_with_another():
    with pytest.raises(ConfigError, match="no ultimate gain. Use baseline='simc'"):
        tuning_rules.gains("ziegler_nichols", control.tf([1], [1, 1]))
    with pytest.raises(ConfigError, match="unstable.*'ziegler_nichols'"):
        tuning_rules.gains("simc", control.tf([1], [1, -1]), dead_time=0.1)
    with pytest.raises(ConfigError, match="did you mean 'simc'"):
        tuning_rules.gains("simk", control.tf([1], [1, 1]))


@pytest.mark.filterwarnings("error")  # nothing is computed before the refusal
@pytest.mark.parametrize("rule", ["ziegler_nichols", "tyreus_luyben", "simc"])
@pytest.mark.parametrize(
    ("plant", "said"),
    [
        (control.tf([1, 0], [1, 2, 1]), "a static gain of 0"),
        (control.tf([0], [1, 1]), "a static gain of 0"),
        (control.tf([1], [1, 0, 1]), "complex poles without damping"),
        (control.tf([1], [1, -0.2, 1]), "complex poles without damping"),
        (control.tf([1], [1, 0, 0]), "integrates twice"),
        (control.ss(control.tf([1], [1, 1, 0, 0])), "integrates twice"),
    ],
)
def test_a_plant_without_an_answer_by_any_rule_is_refused(rule, plant, said):
    """With a dead time no proportional loop of theirs is stable, or none holds a reference."""
    with pytest.raises(ConfigError, match=f"{said}.*Give gains"):
        tuning_rules.gains(rule, plant, "PI", dead_time=0.1)


def test_many_equal_lags_are_a_dead_time_and_a_lag():
    """The step response of n lags of 1 s is the distribution function of a gamma variable."""
    plant = control.tf([1], np.poly([-1.0] * 16))
    found = tuning_rules.first_order(plant, 0.0)
    early, late = gamma.ppf((0.283, 0.632), 16)
    assert found.tau == pytest.approx(1.5 * (late - early), rel=0.02)
    assert found.theta == pytest.approx(late - found.tau, rel=0.02)
