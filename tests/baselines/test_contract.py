"""What every tuner must keep: found through its file in conf/tuner."""

import json
import warnings
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

from tests.baselines.support import (
    CONF,
    NUM_ENVS,
    STEPS,
    drive,
    engine,
    problem,
    spoiled,
    true_cost,
    tuner_config,
)
from tests.support import needs_its_library
from zoac.config.factory import baseline_use, build_tuner_for
from zoac.config.settings import Settings
from zoac.core.errors import ConfigError
from zoac.core.state import decode, encode

NAMES = sorted(path.stem for path in (CONF / "tuner").glob("*.yaml"))
NEED_A_PICKLE = {"bo", "optuna"}  # docs/resuming.md names them
SEARCHING = [name for name in NAMES if name != "nominal"]
# Asks of bo are slow. The other sampler of optuna runs in test_bayes.py.
EPISODES = {"bo": 25, "optuna": 40, "cmaes": 300, "cmaes_full": 100, "cmaes_plus": 100, "es": 300,
            "nevergrad": 100, "zoac_plus": 100}  # fmt: skip
OPTIONS = {
    "optuna": {"sampler": "tpe"},
    "botorch": {"initial_design": 5},
    "smac": {"initial_design": 5},
}
FEW_ENVS = {"botorch": 1}  # each point of a batch takes it a quarter of a second


def make(name, seed=0, episodes=None):
    config = tuner_config(name) | OPTIONS.get(name, {})
    try:
        return build_tuner_for(
            config,
            problem(seed, episodes or EPISODES.get(name, 400), num_envs=envs_of(name)),
            Settings(),
        )
    except ConfigError as error:
        if "pip install" in str(error):
            pytest.skip(str(error))
        raise


def envs_of(name):
    return FEW_ENVS.get(name, NUM_ENVS)


def short(name):
    """Steps that show a tuner past its first batches; BoTorch up to its first model."""
    few = {"bo": 8, "botorch": 5, "smac": 10, "optuna": 20, "cmaes": 30, "nevergrad": 30,
           "cmaes_full": 40}  # fmt: skip
    return STEPS * few.get(name, 60)


def same(one, other):
    return len(one) == len(other) and all(map(np.array_equal, one, other))


def parts_of(name):
    return short(name), STEPS if name == "botorch" else short(name)


@cache
def run_of(name):
    """Run in two parts; return what each asked, and state and recommendation at the end of each."""
    tuner, group, parts = make(name), engine(num_envs=envs_of(name)), []
    for steps in parts_of(name):
        asked = drive(tuner, group, steps)
        parts.append((asked, (tuner.state(), group.state()), tuner.recommend()))
    return parts


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_asks_the_same_whatever_others_draw_and_ask_of_it(name):
    """Recommending and describing change nothing; a recommendation lies in the box at any time."""
    np.random.seed(5)  # noqa: NPY002
    tuner, group = make(name), engine(num_envs=envs_of(name))
    for steps, (asked, _, recommended) in zip(parts_of(name), run_of(name), strict=True):
        x = tuner.recommend()
        assert x.shape == (5,)
        assert np.isfinite(x).all()
        json.dumps(tuner.describe())
        assert same(asked, drive(tuner, group, steps))
        assert np.array_equal(tuner.recommend(), recommended)
        assert np.all(np.abs(problem().space.clip(recommended)) <= 1.0)


def first_of(name, seed=0):
    return drive(make(name, seed), engine(num_envs=envs_of(name)), 1)


@pytest.mark.parametrize("name", SEARCHING)
def test_other_seeds_ask_otherwise(name):
    assert not same(first_of(name), first_of(name, 1))


@pytest.mark.parametrize("name", NAMES)
def test_a_restored_tuner_continues_bit_for_bit(name):
    """And the state that it was restored from did not change when the tuner went on."""
    (_, state, recommended), (further, _, answer) = run_of(name)
    encoded = encode(state)
    assert bool(encoded.objects) == (name in NEED_A_PICKLE)
    of_tuner, of_environments = decode(encoded)
    twin, group = make(name), engine(num_envs=envs_of(name))
    twin.restore(of_tuner)
    group.restore(of_environments)
    assert np.array_equal(twin.recommend(), recommended)
    np.random.seed(5)  # noqa: NPY002
    assert same(further, drive(twin, group, parts_of(name)[1]))
    assert np.array_equal(twin.recommend(), answer)
    twin.restore(of_tuner)
    assert np.array_equal(twin.recommend(), recommended)


NOT_THE_START = "compared with the answer; the search does not begin there"
START = np.array([0.8, -0.8, 0.8, -0.8, 0.8])


@pytest.mark.parametrize("recommendation", ["its own", "best_seen"])
@pytest.mark.parametrize("name", SEARCHING)
def test_a_tuner_that_is_given_start_values_begins_there_or_says_that_it_only_compares(
    name, recommendation
):
    """There is: its first points are centred there, or the start is one of them."""
    config = tuner_config(name) | OPTIONS.get(name, {})
    needs_its_library(config["_target_"])
    if recommendation == "best_seen" and "recommendation" in config:
        config["recommendation"] = recommendation
    takes_a_start = "start" in config
    config |= {"start": "baseline"} if takes_a_start else {}
    tuner = build_tuner_for(config, problem(start=START, baseline=START), Settings())
    told = baseline_use(config, SimpleNamespace(baseline={"a": 0.0}), Settings())["baseline values"]
    if not takes_a_start:
        assert told == NOT_THE_START
        return
    assert told.startswith("the search begins there")
    assert np.array_equal(tuner.recommend(), START)
    points = np.stack([p.x for p in tuner.ask()])
    among_them = np.abs(points - START).max(axis=1).min() < 1e-6
    assert among_them or np.linalg.norm(points.mean(axis=0) - START) < 0.6


@pytest.mark.parametrize("name", SEARCHING)
def test_a_tuner_that_is_not_told_to_begin_at_the_start_values_says_so(name):
    task = SimpleNamespace(baseline={"a": 0.0})
    told = baseline_use(tuner_config(name), task, Settings())["baseline values"]
    assert told.startswith(NOT_THE_START)
    assert baseline_use(tuner_config(name), SimpleNamespace(baseline=None), Settings()) == {}


WHEN = {
    "first and third batch": lambda i, first: i // first in (0, 2),
    "now and then": lambda i, first: i % 3 == 0,
    "always": lambda i, first: True,
}


@pytest.mark.parametrize(
    ("name", "when"),
    # BoTorch's asks take seconds, and one class replaces the costs for all of these.
    [(name, when) for name in SEARCHING for when in WHEN
     if name != "botorch" or when == "now and then"],
)  # fmt: skip
def test_costs_that_are_not_finite_do_not_break_it(name, when):
    tuner = make(name)
    first = len(make(name).ask())
    bad = cycle((np.nan, np.inf, -np.inf))

    def spoil(i, segment):
        return spoiled(segment, next(bad)) if WHEN[when](i, first) else segment

    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        drive(tuner, engine(num_envs=envs_of(name)), short(name), spoil)
    assert np.isfinite(tuner.recommend()).all()
    assert all(np.isfinite(p.x).all() for p in tuner.ask())


# Of the others, those that recommend a point that they evaluated; the extras do as `random` does.
RECALLING = [
    n for n in SEARCHING
    if n not in ("es", "zoac", "zoac_plus", "cmaes_full", "cmaes_plus", "botorch", "smac")
]  # fmt: skip


@pytest.mark.parametrize("bad", ["violates", -np.inf])
@pytest.mark.parametrize("name", RECALLING)
def test_a_bad_episode_is_never_overtaken_by_costlier_good_ones(name, bad):
    """Bad episodes come first, when nothing is known; each good one costs ten times the last."""
    tuner, good = make(name), []

    def spoil(i, segment):
        if i % 2 == 0 or i < 3:
            cheap = spoiled(segment, 0.0 if bad == "violates" else bad)
            return replace(cheap, violation=0.001) if bad == "violates" else cheap
        good.append(segment.proposal.x)
        return spoiled(segment, 10.0 ** min(len(good), 16))

    drive(tuner, engine(), STEPS * 10, spoil)
    assert any(np.allclose(tuner.recommend(), x, atol=1e-6) for x in good)


def installed(name):
    _, extra, rest = tuner_config(name)["_target_"].partition("zoac.baselines.extras.")
    return not extra or find_spec(rest.partition(".")[0]) is not None


def test_every_tuner_has_a_name_of_its_own_for_tables_and_figures():
    names = [make(name).display_name for name in NAMES if installed(name)]
    assert all(names)
    assert len(set(names)) == len(names)


# Halving measures few points often, for costs with more noise: `tests/study/test_halving.py`.
# BoTorch and SMAC find what is best in test_discrete.py.
@pytest.mark.parametrize(
    "name", [n for n in SEARCHING if n not in ("random", "halving", "botorch", "smac")]
)
def test_beats_random_search_on_a_noisy_quadratic(name):
    episodes = EPISODES.get(name, 400)
    assert found(name, 0, episodes) < found("random", 0, episodes)


@cache
def found(name, seed, episodes):
    tuner = make(name, seed, episodes)
    drive(tuner, engine(seed), episodes * STEPS)
    return true_cost(problem().space.clip(tuner.recommend()))
