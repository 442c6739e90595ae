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
    assert loops.gain_margin(loop(1.0, 1.0, 0.5)) == pytest.approx(3.0, rel=1e-5)
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
    assert not loops.open_loop(system).stable
    assert (loops.gain_margin(system), loops.phase_margin(system)) == (0.0, 0.0)
    assert (loops.disk_margin(system), loops.bandwidth(system)) == (0.0, 0.0)
    assert loops.max_sensitivity(system) == math.inf


def test_what_is_no_single_loop_is_refused():
    with pytest.raises(ConfigError, match="one input and one output"):
        loops.gain_margin(control.ss([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(ConfigError, match="expected a system of python-control"):
        loops.gain_margin(3.0)


@pytest.mark.parametrize(("k", "lag"), [(1.0, 1.0), (1e6, 0.05), (1e7, 0.1), (1e-8, 1.0)])
def test_sensitivity_is_the_closed_form_also_where_the_gain_is_1_far_beyond_the_corners(k, lag):
    # L = k / (s (lag s + 1)), of damping ratio zeta (Astrom and Hagglund, Advanced PID Control).
    z = 1 / (4 * k * lag)  # zeta^2
    root = math.sqrt(8 * z + 1)
    exact = math.sqrt((root**2 + (4 * z + 1) * root) / (root**2 + (4 * z - 1) * root))
    assert loops.max_sensitivity(loop(k, lag)) == pytest.approx(exact, rel=1e-4)
    # The disk margin is 1 / max |S - 1/2|.
    inverse = 1 / loops.disk_margin(loop(k, lag))
    assert exact - 0.501 < inverse < exact + 0.501


@pytest.mark.parametrize("zeta", [0.05, 0.002, 0.0005, 1e-5])
def test_the_peak_of_a_weakly_damped_mode_is_found(zeta):
    system = control.tf([0.5], [1, 1]) - control.tf([1.8 * zeta * 2500], [1, 100 * zeta, 2500])
    omega = 50 * (1 + zeta * np.linspace(-5, 5, 100001))
    response = system(1j * omega)
    exact = 1 / np.min(np.abs(1 + response))
    assert exact > 1.4
    assert loops.max_sensitivity(system) == pytest.approx(exact, rel=2e-4)
    exact = 2 * np.min(np.abs((1 + response) / (1 - response)))
    assert loops.disk_margin(system) == pytest.approx(exact, rel=2e-4)


@pytest.mark.parametrize("seed", range(30))
def test_a_gain_may_grow_by_its_margin_and_no_further_whether_the_plant_is_stable_or_not(seed):
    rng = np.random.default_rng(seed)
    den = np.poly(np.append(-rng.uniform(0.1, 20.0, 3), rng.choice([-1.0, 1.0])))
    num = 10 ** rng.uniform(1.0, 3.5) * np.poly(-rng.uniform(0.1, 3.0, 1))

    def is_stable(factor):
        return np.roots(np.polyadd(den, factor * num)).real.max() < 0

    margin = loops.gain_margin(control.tf(num, den))
    if not is_stable(1.0):
        assert margin == 0.0
        return
    assert margin > 1.0
    held = [1.0 + part * (min(margin, 1e6) - 1.0) for part in (0.01, 0.1, 0.5, 0.99, 0.9999)]
    assert all(is_stable(factor) for factor in held)
    assert margin == math.inf or not is_stable(1.0001 * margin)


def test_a_gain_that_only_must_not_fall_has_an_infinite_margin():
    assert loops.gain_margin(control.tf([10], [1, -1])) == math.inf
    assert loops.gain_margin(control.tf([-0.5], [1, 1])) == pytest.approx(2.0)  # unstable at rest


@pytest.mark.parametrize(("kp", "ki", "delay"), [(0.12, 0.053, 19), (0.155, 0.075, 9), (2, 1, 1)])
def test_the_margins_of_a_discrete_loop_are_those_of_its_response(kp, ki, delay):
    ts = 0.04
    a, b = math.exp(-ts / 0.4), 1 - math.exp(-ts / 0.4)
    system = (
        control.tf([b], [1, -a], ts)
        * control.tf([kp, ki * ts - kp], [1, -1], ts)
        * control.tf([1], [1] + [0] * delay, ts)
    )
    z = np.exp(1j * np.logspace(-6, math.log10(math.pi), 400001))
    response = b / (z - a) * (kp + ki * ts / (z - 1)) * z**-delay
    above = np.abs(response) > 1
    phase = np.degrees(np.abs(np.angle(-response[:-1][above[:-1] != above[1:]]))).min()
    assert loops.phase_margin(system) == pytest.approx(phase, abs=0.02)
    real = response.real[:-1][np.diff(np.sign(response.imag)) != 0]
    assert loops.gain_margin(system) == pytest.approx((-1 / real[real < 0]).min(), rel=1e-3)


@pytest.mark.parametrize("gain", [1e-6, 0.1, 0.6])
def test_the_bandwidth_of_a_discrete_integrator_in_a_loop_is_the_closed_form(gain):
    # |T| = gain / |z - 1 + gain| is 1 / sqrt(2).
    cosine = (1 + (1 - gain) ** 2 - 2 * gain**2) / (2 * (1 - gain))
    found = loops.bandwidth(control.tf([gain], [1, -1], 0.1))
    assert found == pytest.approx(math.acos(cosine) / 0.1, rel=1e-4)


@pytest.mark.parametrize("gain", [1e-8, 1.0, 1e8])
def test_the_bandwidth_of_an_integrator_scales_with_its_gain(gain):
    assert loops.bandwidth(loop(gain)) == pytest.approx(gain, rel=1e-6)


def test_an_undamped_mode_does_not_look_like_a_gain_margin():
    # The response passes through infinity at the mode, from one side of the axis to the other.
    system = control.tf([1, 1.2, 1], [1, 0, 1]) * control.tf([1.0], [1, 0])
    assert loops.open_loop(system).stable
    assert loops.gain_margin(system) == math.inf


FIGURES = (
    loops.gain_margin, loops.phase_margin, loops.disk_margin, loops.max_sensitivity,
    loops.bandwidth,
)  # fmt: skip


@pytest.mark.parametrize("figure", FIGURES)
def test_a_state_space_model_has_the_figures_of_its_transfer_function(figure):
    system = loop(1.3, 1.0, 0.5) * control.tf([1, 2], [1, 3])
    assert figure(control.ss(system)) == pytest.approx(figure(system), rel=1e-6)
    sampled = control.sample_system(system, 0.05)
    assert figure(control.ss(sampled)) == pytest.approx(figure(sampled), rel=1e-5)


def test_a_loop_at_its_limit_has_no_gain_to_spare():
    # k / (s + 1)^3 is at its limit for k = 8; rounding decides whether it is stable.
    for k in (8.0, 8.0 - 1e-12, 8.0 + 1e-12):
        found = loops.gain_margin(control.tf([k], [1, 3, 3, 1]))
        assert found == 0.0 or found == pytest.approx(1.0)


def test_a_loop_that_is_a_number_has_no_limit_of_phase_and_of_its_disk():
    static = control.tf([1.0], [1.0])
    assert (loops.gain_margin(static), loops.phase_margin(static)) == (math.inf, math.inf)
    assert loops.disk_margin(static) == math.inf
    assert loops.max_sensitivity(static) == pytest.approx(0.5)
