"""Requirements over episodes: their values, limits and relative excess."""

import math
import sys

import numpy as np
import pytest

from zoac import specs
from zoac.core.errors import ConfigError
from zoac.specs.signals import Episode

T = np.linspace(0.0, 5.0, 501)


def episode(y, ended=1.0):
    return Episode(T, {"y": y, "r": np.ones_like(T)}, ended)


def overshooting(by):
    return episode(1.0 - np.exp(-3 * T) + by * np.exp(-((T - 2.0) ** 2) * 40))


def test_a_figure_is_that_of_the_named_signals():
    assert specs.overshoot("y", "r").of_episode(overshooting(0.2)) == pytest.approx(0.2, abs=0.01)
    assert specs.peak("r").of_episode(overshooting(0.2)) == 1.0


def test_an_episode_that_ended_early_breaks_every_limit():
    late = episode(np.ones_like(T), ended=0.5)
    for spec in (specs.overshoot("y", "r", max=1.0), specs.rise_time("y", "r", min=0.1)):
        assert spec.excess(spec.of_episode(late)) > 0


@pytest.mark.parametrize(
    ("over", "value"),
    [("worst", 4.0), ("mean", 2.5), (specs.cvar(0.5), 3.5), (specs.cvar(0.9), 4.0)],
)
def test_values_over_episodes(over, value):
    spec = specs.peak("y", max=1.0, over=over)
    assert spec.over_episodes([1.0, 4.0, 2.0, 3.0]) == value


@pytest.mark.parametrize(
    ("limits", "value", "excess"),
    [
        ({"max": 0.05}, 0.10, 1.0),
        ({"max": 0.05}, 0.05, 0.0),
        ({"min": 2.0}, 1.0, 0.5),
        ({"max": 0.0}, 0.5, 0.5),
        ({"max": 2.0, "min": 1.0}, 1.5, 0.0),
        ({"max": 1.0}, math.inf, 1e6),
        ({}, math.inf, 0.0),
    ],
)
def test_the_excess_is_a_fraction_of_the_limit(limits, value, excess):
    assert specs.peak("y", **limits).excess(value) == pytest.approx(excess)


def test_figures_of_a_loop_need_no_episode():
    control = pytest.importorskip("control")
    spec = specs.gain_margin(lambda p: control.tf([p["k"]], [1, 3, 3, 1]), min=2.0)
    assert spec.of_parameters({"k": 2.0}) == pytest.approx(4.0, rel=1e-5)
    assert spec.excess(spec.of_parameters({"k": 8.0})) > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"max": math.nan}, "max=nan, expected a finite number"),
        ({"max": 1.0, "min": 2.0}, "min=2.0 lies above max=1.0"),
        ({"over": "best"}, "over='best'; expected 'worst', 'mean' or cvar"),
        ({"weight": 0.0}, "weight=0.0"),
        ({"window": (2.0, 1.0)}, r"window=\(2.0, 1.0\), expected \(from, to\) in seconds"),
        ({"window": 3}, r"peak: window=3, expected \(from, to\) in seconds"),
        ({"y": 0.5}, r"peak\(0.5\): expected the name of a signal; .* such as max=0.5"),
        ({"over": "worst"}, "over='worst' without a limit"),
        ({"max": "5%"}, "max='5%', expected a finite number"),
        ({"maximum": 1.0}, "peak: no argument 'maximum'; did you mean 'max'"),
    ],
)
def test_what_cannot_be_required_is_refused(arguments, said):
    with pytest.raises(ConfigError, match=said):
        specs.peak(**arguments)


def test_a_loop_needs_a_limit_and_has_no_window():
    with pytest.raises(ConfigError, match="gain_margin: a figure of a loop needs a limit"):
        specs.gain_margin(lambda p: None)
    with pytest.raises(
        ConfigError, match="gain_margin: no argument .window.; known: loop, max, min"
    ):
        specs.gain_margin(lambda p: None, min=2.0, window=(0.0, 1.0))


def test_limits_read_as_people_write_them():
    assert specs.peak("y", max=0.05).limit == "<= 0.05"
    assert specs.peak("y", min=1.0, max=2.0).limit == ">= 1 and <= 2"
    assert str(specs.overshoot("y", "r")) == "overshoot(y, r)"


def test_without_python_control_one_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    spec = specs.phase_margin(lambda p: object(), min=30.0)
    with pytest.raises(ConfigError, match=r"pip install 'zoac\[control\]'"):
        spec.of_parameters({"k": 1.0})


def test_a_loop_that_asks_for_an_unknown_parameter_is_told_which_there_are():
    with pytest.raises(ConfigError, match="asked for 'kp'; known: k, Ti"):
        specs.gain_margin(lambda p: p["kp"], min=2.0).of_parameters({"k": 1.0, "Ti": 2.0})


def test_a_window_looks_at_a_part_of_the_episode():
    y = np.where(T < 3.0, 1.0, 2.0)  # a disturbance at 3 s
    assert specs.peak("y", window=(0.0, 2.99)).of_episode(episode(y)) == 1.0
    assert specs.peak("y", window=(0.0, 3.0)).of_episode(episode(y)) == 2.0
    assert specs.iae("y", "r", window=(3.0, 4.0)).of_episode(episode(y)) == pytest.approx(1.0)
    with pytest.raises(ConfigError, match="no sample there; it lasts 5 s"):
        specs.peak("y", window=(6.0, 7.0)).of_episode(episode(y))


def test_of_loops_side_by_side_the_worst_counts_and_of_an_objective_the_mean():
    y = np.stack([np.full_like(T, 3.0), np.full_like(T, 1.0), np.full_like(T, 2.0)], axis=1)
    assert specs.peak("y", max=1.0).of_episode(episode(y)) == 3.0
    assert specs.peak("y", min=1.0).of_episode(episode(y)) == 1.0
    assert specs.peak("y", min=1.9, max=2.9).of_episode(episode(y)) == 1.0  # breaks by more
    assert specs.peak("y").of_episode(episode(y)) == 2.0
    assert specs.iae("y", "r").of_episode(episode(y)) == pytest.approx(5.0)


def test_a_figure_may_be_a_function_of_ones_own():
    def crossings(t, y, r):
        return np.count_nonzero(np.diff(np.sign(y - r)))

    spec = specs.Spec("crossings", ("y", "r"), crossings, max=1)
    value = spec.of_episode(episode(1.0 + np.cos(2 * np.pi * T + 0.1)))
    assert value == 10
    assert spec.excess(value) == 9.0
    assert spec.label == "crossings(y, r) <= 1"


@pytest.mark.parametrize(
    ("values", "told"),
    [([1.0, math.inf], math.inf), ([-math.inf, math.inf], math.inf), ([1.0, 2.0], 1.5)],
)
def test_a_mean_over_episodes_without_a_value_is_the_worst(values, told):
    assert specs.peak("y").over_episodes(values) == told


def test_worst_over_episodes_with_two_limits_is_the_one_that_breaks_by_more():
    spec = specs.peak("y", min=1.0, max=2.0)
    assert spec.over_episodes([1.5, 0.2, 2.1]) == 0.2
    assert spec.over_episodes([1.5, 0.9, 2.8]) == 2.8
    assert specs.rms("y", min=1.0).over_episodes([3.0, 1.0, 2.0]) == 1.0


def test_the_later_an_episode_ends_the_less_it_breaks_and_always_more_than_any_excess():
    spec = specs.overshoot("y", "r", max=0.05)
    early, late = (spec.violation_of(episode(T, ended=e), math.inf) for e in (0.1, 0.9))
    without_bound = spec.violation_of(episode(np.full_like(T, np.nan)), math.inf)
    assert 1.0 < without_bound < 2.0 < late < early <= 3.0


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: specs.overshoot(max=5), "max=5 is 500% of the step; write 5% as max=0.05"),
        (lambda: specs.settling_time("y", "r", 2.0), "band=2.0, expected a fraction of the step"),
        (
            lambda: specs.rise_time(low=10, high=90),
            "low=10, high=90, expected fractions of the step",
        ),
        (lambda: specs.rise_time(low=0.9, high=0.1), "low=0.9, high=0.1, .* 0 <= low < high <= 1"),
        (lambda: specs.steady_state_error(last=5), "last=5, expected a part of the episode"),
        (lambda: specs.steady_state_error(last=-0.1), "last=-0.1, .* above 0 and up to 1"),
        (lambda: specs.steady_state_error(last="0.1"), "last='0.1', expected a part"),
        (lambda: specs.phase_margin(45), r"phase_margin\(45\): a limit has a name"),
    ],
)
def test_slips_of_people_who_come_from_elsewhere_are_named(make, told):
    with pytest.raises(ConfigError, match=told):
        make()


def test_signals_that_are_not_named_are_y_r_and_u():
    assert specs.overshoot(max=0.05) == specs.overshoot("y", "r", max=0.05)
    assert specs.peak().signals == ("y",)
    assert specs.total_variation().signals == ("u",)


@pytest.mark.parametrize("most", [1.0, 5.0, 20.0, 1e4])
@pytest.mark.parametrize("make", [specs.settling_time, specs.rise_time])
def test_an_infinite_time_breaks_any_limit_and_the_nearer_response_breaks_it_by_less(make, most):
    spec = make("y", "r", max=most)
    found = []
    for end in (0.89, 0.8, 0.3):
        response = episode(end * (1.0 - np.exp(-3 * T)))
        value = spec.of_episode(response)
        assert value == math.inf
        assert not spec.met(value)
        found.append(spec.violation_of(response, value))
    assert 1.0 < found[0] < found[1] < found[2] < 2.0


def test_a_response_that_never_rises_keeps_a_lower_limit():
    spec = specs.rise_time("y", "r", min=20.0)
    response = episode(0.5 * (1.0 - np.exp(-3 * T)))
    assert spec.met(spec.of_episode(response))
    assert spec.violation_of(response, math.inf) == 0.0


def test_a_loop_that_cannot_be_made_or_judged_is_told_with_its_spec():
    control = pytest.importorskip("control")
    continuous, discrete = control.tf([1], [1, 1]), control.tf([1], [1, -0.5], 0.1)
    mixed = specs.gain_margin(lambda p: p["k"] * continuous * discrete, min=2.0)
    with pytest.raises(ConfigError, match=r"gain_margin: loop\(\{'k': 2\.0\}\) raised ValueError"):
        mixed.of_parameters({"k": 2.0})
    measured = specs.phase_margin(lambda p: control.frd([1, 2, 3], [1, 2, 3]), min=30.0)
    with pytest.raises(ConfigError, match="expected a transfer function or a state-space model"):
        measured.of_parameters({"k": 2.0})
