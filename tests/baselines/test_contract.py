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
EPISODES = {"bo": 25, "optuna": 100, "cmaes": 400, "nevergrad": 300, "botorch": 15, "smac": 40}
OPTIONS = {
    "optuna": {"sampler": "tpe"},
    "botorch": {"initial_design": 5},
    "smac": {"initial_design": 5},
}


def make(name, seed=0, episodes=None):
    config = tuner_config(name) | OPTIONS.get(name, {})
    try:
        return build_tuner_for(
            config, problem(seed, episodes or EPISODES.get(name, 600)), Settings()
        )
    except ConfigError as error:
        if "pip install" in str(error):
            pytest.skip(str(error))
        raise


def short(name):
    """Steps that show a tuner past its first batches."""
    return STEPS * {"bo": 8, "optuna": 30, "botorch": 10, "smac": 10}.get(name, 60)


def same(one, other):
    return len(one) == len(other) and all(map(np.array_equal, one, other))


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_asks_the_same_whatever_others_draw(name):
    first = drive(make(name), engine(), short(name))
    np.random.seed(5)  # noqa: NPY002
    assert same(first, drive(make(name), engine(), short(name)))


@pytest.mark.parametrize("name", SEARCHING)
def test_other_seeds_ask_otherwise(name):
    assert not same(drive(make(name), engine(), 1), drive(make(name, seed=1), engine(), 1))


@pytest.mark.parametrize("name", NAMES)
def test_a_restored_tuner_continues_bit_for_bit(name):
    """And the state that it was restored from does not change when it goes on."""
    tuner, group = make(name), engine()
    drive(tuner, group, short(name))
    kept, recommended = tuner.state(), tuner.recommend()
    encoded = encode((kept, group.state()))
    assert bool(encoded.objects) == (name in NEED_A_PICKLE)
    state, env_states = decode(encoded)
    twin, twin_group = make(name), engine()
    twin.restore(state)
    twin_group.restore(env_states)
    assert np.array_equal(twin.recommend(), recommended)
    np.random.seed(5)  # noqa: NPY002
    further = STEPS if name == "botorch" else short(name)
    assert same(drive(tuner, group, further), drive(twin, twin_group, further))
    assert np.array_equal(tuner.recommend(), twin.recommend())
    tuner.restore(kept)
    assert np.array_equal(tuner.recommend(), recommended)


@pytest.mark.parametrize("name", NAMES)
def test_recommending_and_describing_change_nothing(name):
    watched, left_alone = make(name), make(name)
    group, other_group = engine(), engine()
    for _ in range(2):  # the first points of a model are asked for in the second
        watched.recommend()
        watched.describe()
        one = drive(watched, group, short(name) // 2)
        assert same(one, drive(left_alone, other_group, short(name) // 2))


@pytest.mark.parametrize("name", NAMES)
def test_recommendation_lies_in_the_box_from_the_start(name):
    tuner, group = make(name), engine()
    for _ in range(3):
        x = tuner.recommend()
        assert x.shape == (5,)
        assert np.all(np.abs(problem().space.clip(x)) <= 1.0)
        assert np.isfinite(x).all()
        drive(tuner, group, short(name) // 3)


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
    "at first": lambda i, first: i < first,
    "later": lambda i, first: i >= first,
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
        drive(tuner, engine(), short(name), spoil)
    assert np.isfinite(tuner.recommend()).all()
    assert all(np.isfinite(p.x).all() for p in tuner.ask())


# Of the others, those that recommend a point that they evaluated.
RECALLING = [
    n for n in SEARCHING if n not in ("es", "zoac", "zoac_plus", "cmaes_full", "cmaes_plus")
]


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


@pytest.mark.parametrize("name", NAMES)
def test_its_choices_can_be_logged(name):
    json.dumps(make(name).describe())


# Halving measures few points often, for costs with more noise: `tests/study/test_halving.py`.
@pytest.mark.parametrize("name", [n for n in SEARCHING if n not in ("random", "halving")])
def test_beats_random_search_on_a_noisy_quadratic(name):
    """On the mean over two seeds, with as many episodes."""
    episodes = EPISODES.get(name, 600)
    mine = [found(name, seed, episodes) for seed in (0, 1)]
    assert np.mean(mine) < np.mean([found("random", seed, episodes) for seed in (0, 1)])


@cache
def found(name, seed, episodes):
    tuner = make(name, seed, episodes)
    drive(tuner, engine(seed), episodes * STEPS)
    return true_cost(problem().space.clip(tuner.recommend()))
