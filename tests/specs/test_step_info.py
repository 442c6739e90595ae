"""Figures of a response against closed forms and python-control, and where they have no value."""

import math

import numpy as np
import pytest

from zoac.specs import requirements
from zoac.specs import step_info as of
from zoac.specs.signals import Episode

T = np.linspace(0.0, 10.0, 2001)


def second_order(zeta, omega, height=1.0):
    """Return the step response of omega^2 / (s^2 + 2 zeta omega s + omega^2), zeta < 1."""
    damped = omega * math.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * T)
    ripple = np.cos(damped * T) + zeta / math.sqrt(1 - zeta**2) * np.sin(damped * T)
    return height * (1.0 - decay * ripple)


@pytest.mark.parametrize("zeta", [0.2, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("height", [1.0, -3.0])
def test_overshoot_of_a_second_order_response_is_the_closed_form(zeta, height):
    y = second_order(zeta, 3.0, height)
    exact = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert of.overshoot(T, y, height) == pytest.approx(exact, abs=1e-4)


def test_settling_and_rise_of_a_first_order_response_are_the_closed_form():
    y = 1.0 - np.exp(-T / 0.7)
    assert of.settling_time(T, y, 1.0) == pytest.approx(0.7 * math.log(50), abs=0.01)
    assert of.rise_time(T, y, 1.0) == pytest.approx(0.7 * math.log(9), abs=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_random_responses_have_the_figures_of_python_control(seed):
    control = pytest.importorskip("control")
    rng = np.random.default_rng(seed)
    y = second_order(rng.uniform(0.15, 0.95), rng.uniform(1.0, 6.0), rng.choice([-2.0, 0.5, 4.0]))
    theirs = control.step_info(y, T, final_output=y[-1])
    assert of.overshoot(T, y, y[-1]) == pytest.approx(theirs["Overshoot"] / 100, abs=1e-9)
    assert of.settling_time(T, y, y[-1]) == pytest.approx(theirs["SettlingTime"], abs=2 * T[1])
    assert of.rise_time(T, y, y[-1]) == pytest.approx(theirs["RiseTime"], abs=2 * T[1])
    assert of.peak(T, y) == pytest.approx(theirs["Peak"])


def test_integrals_of_an_exponential_error_are_the_closed_form():
    y = 1.0 - np.exp(-2.0 * T)
    assert of.iae(T, y, 1.0) == pytest.approx(1 / 2, rel=1e-4)
    assert of.ise(T, y, 1.0) == pytest.approx(1 / 4, rel=1e-4)
    assert of.itae(T, y, 1.0) == pytest.approx(1 / 4, rel=1e-4)


def test_a_reference_may_be_samples():
    r = np.where(T < 5.0, 1.0, 2.0)
    assert of.iae(T, np.zeros_like(T), r) == pytest.approx(15.0, abs=0.01)
    assert of.steady_state_error(T, np.zeros_like(T), r) == pytest.approx(2.0)


def test_the_rest_against_sums_by_hand():
    t, y = np.array([0.0, 0.5, 1.0]), np.array([1.0, -2.0, 0.0])
    assert of.total_variation(t, y) == 5.0
    assert of.rate(t, y) == 6.0
    assert of.rms(t, y) == pytest.approx(math.sqrt(5 / 3))
    assert of.peak(t, y) == 2.0


def test_a_response_that_never_settles_or_rises_takes_for_ever():
    y = np.sin(T)
    assert of.settling_time(T, y, 1.0) == math.inf
    assert of.rise_time(T, 0.5 * (1 - np.exp(-T)), 1.0) == math.inf


def test_without_an_overshoot_it_is_zero():
    assert of.overshoot(T, 1.0 - np.exp(-T), 1.0) == 0.0


def test_a_step_of_no_height_is_kept_or_not():
    still, moved = np.ones(5), np.array([1.0, 1.2, 1.0, 1.0, 1.0])
    t = np.arange(5.0)
    assert of.overshoot(t, still, 1.0) == 0.0
    assert of.overshoot(t, moved, 1.0) == math.inf
    assert (of.settling_time(t, still, 1.0), of.settling_time(t, moved, 1.0)) == (0.0, 2.0)
    assert of.rise_time(t, moved, 1.0) == 0.0


REFERENCED = (
    of.overshoot, of.settling_time, of.rise_time, of.steady_state_error, of.iae, of.ise, of.itae,
)  # fmt: skip
ALONE = (of.peak, of.rms, of.total_variation, of.rate)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_sample_that_is_not_finite_breaks_every_limit(bad):
    y = np.linspace(0.0, 1.0, 11)
    y[4] = bad
    t = np.arange(11.0)
    assert {figure(t, y, 1.0) for figure in REFERENCED} == {math.inf}
    assert {figure(t, y) for figure in ALONE} == {math.inf}


@pytest.mark.parametrize("start", [0.0, 20.0, -3.0])
@pytest.mark.parametrize("side", [-0.02, 0.02])
def test_a_response_on_the_edge_of_the_band_has_settled_and_one_beyond_has_not(start, side):
    t = np.arange(0.0, 1.0, 0.01)
    edge, beyond = (np.where(t < 0.5, start, start + 1.0 + by) for by in (side, 1.001 * side))
    assert of.settling_time(t, edge, start + 1.0) == pytest.approx(0.5)
    assert of.settling_time(t, beyond, start + 1.0) == math.inf


def test_means_weigh_time_whatever_the_spacing_of_the_samples():
    t = np.concatenate([np.linspace(0.0, 1.0, 2001)[:-1], np.linspace(1.0, 4.0, 601)])
    t = np.sort(np.append(t, np.linspace(3.6, 3.7, 3000)))
    y = np.exp(-t)
    assert of.rms(t, y) == pytest.approx(math.sqrt((1 - math.exp(-8.0)) / 8.0), rel=2e-3)
    exact = (math.exp(-3.6) - math.exp(-4.0)) / 0.4
    assert of.steady_state_error(t, y, 0.0) == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("count", [1, 2, 5, 100, 250, 2001])
def test_means_of_evenly_spaced_samples_are_those_of_the_samples(count):
    t, y = 0.02 * np.arange(count), np.random.default_rng(count).normal(size=count)
    assert of.rms(t, y) == np.sqrt(np.mean(y**2))
    part = max(1, round(0.1 * count))
    assert of.steady_state_error(t, y, 0.5) == np.mean(np.abs(0.5 - y)[-part:])


def test_the_jump_from_rest_to_the_first_sample_counts_as_no_change():
    t, u = 0.1 * np.arange(3), np.array([2.0, 1.9, 1.9])
    assert of.rate(t, u) == pytest.approx(1.0)
    assert of.total_variation(t, u) == pytest.approx(0.1)


def test_what_the_docs_name_beside_a_rate_sees_the_jump_from_rest():
    u = np.array([2.0, 1.9, 1.9])
    signals = {"u": u, "du": np.diff(u, prepend=0.0)}
    episode = Episode(0.1 * np.arange(3), signals)
    first = requirements.peak("u", max=0.1, window=(0, 0.05))
    changes = requirements.peak("du", max=0.1)
    assert [spec.of_episode(episode) for spec in (first, changes)] == [2.0, 2.0]
