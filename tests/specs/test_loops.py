"""Margins of linear loops against closed forms."""

import math

import numpy as np
import pytest

from zoac.core.errors import ConfigError
from zoac.specs import loops

control = pytest.importorskip("control")


def loop(k, *lags):
    """Return k / (s product of (lag s + 1))."""
    system = control.tf([k], [1, 0])
    for lag in lags:
        system = system * control.tf([1], [lag, 1])
    return system


def test_margins_of_an_integrator_with_two_lags_are_the_closed_form():
    # Im L = 0 at omega = 1 / sqrt(T1 T2): the gain margin is (T1 + T2) / (T1 T2 K).
    assert loops.gain_margin(loop(1.0, 1.0, 0.5)) == pytest.approx(3.0, rel=1e-6)
    omega = np.logspace(-2, 1, 200001)
    gain = np.abs(1 / (1j * omega * (1j * omega + 1) * (0.5j * omega + 1)))
    crossing = omega[np.argmin(np.abs(gain - 1))]
    exact = 90 - math.degrees(math.atan(crossing) + math.atan(crossing / 2))
    assert loops.phase_margin(loop(1.0, 1.0, 0.5)) == pytest.approx(exact, abs=0.01)


def test_a_loop_without_a_limit_of_gain_has_an_infinite_margin():
    assert loops.gain_margin(loop(5.0)) == math.inf


def test_sensitivity_is_one_over_the_distance_to_the_critical_point():
    omega = np.logspace(-3, 3, 400001)
    response = 1 / (1j * omega * (1j * omega + 1))
    exact = 1 / np.min(np.abs(1 + response))
    assert loops.max_sensitivity(loop(1.0, 1.0)) == pytest.approx(exact, rel=1e-4)


def test_a_disk_margin_is_below_what_gain_and_phase_alone_allow():
    system = loop(1.0, 1.0, 0.5)
    alpha = loops.disk_margin(system)
    assert 0 < alpha < 2
    assert (2 + alpha) / (2 - alpha) <= loops.gain_margin(system) * 1.001
    assert 2 * math.degrees(math.atan(alpha / 2)) <= loops.phase_margin(system) * 1.001


def test_bandwidth_of_an_integrator_in_a_loop_is_its_gain():
    assert loops.bandwidth(loop(2.0)) == pytest.approx(2.0, rel=0.01)


def test_a_discrete_loop_is_near_the_continuous_one_that_it_samples():
    system = loop(1.0, 1.0)
    sampled = control.sample_system(system, 0.001, "zoh")
    for figure in (loops.phase_margin, loops.max_sensitivity, loops.disk_margin):
        assert figure(sampled) == pytest.approx(figure(system), rel=0.01)


def test_an_unstable_closed_loop_has_no_margin():
    system = loop(10.0, 1.0, 0.5)
    assert not loops.is_stable(system)
    assert (loops.gain_margin(system), loops.phase_margin(system)) == (0.0, 0.0)
    assert (loops.disk_margin(system), loops.bandwidth(system)) == (0.0, 0.0)
    assert loops.max_sensitivity(system) == math.inf


def test_what_is_no_single_loop_is_refused():
    with pytest.raises(ConfigError, match="one input and one output"):
        loops.gain_margin(control.ss([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(ConfigError, match="expected a system of python-control"):
        loops.gain_margin(3.0)
