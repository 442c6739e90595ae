"""The problems and the table on which the rule of `tuner="auto"` rests."""

import numpy as np
import pytest

from benchmarks.auto_problems import HELD_OUT, LANDER, PROBLEMS, land, without_baseline
from benchmarks.auto_tuner import EXPERIMENTS, MODELS, TUNERS, jobs, scores, table

EVERYWHERE = {
    name: make
    for name, make in {**PROBLEMS, **HELD_OUT}.items()
    if not any(other in name for other in ("Lander", "Swimmer", "loop"))
}


@pytest.mark.parametrize("name", EVERYWHERE)
def test_no_tuner_is_told_gains_and_every_tuner_may_take_the_problem(name):
    task = without_baseline(EVERYWHERE[name])
    assert task.baseline is None
    assert not task.specs  # which tuners of parts of episodes would refuse


def test_the_rule_was_chosen_on_other_problems():
    assert not PROBLEMS.keys() & HELD_OUT.keys()


def test_the_lander_flies_by_gymnasiums_heuristic():
    pytest.importorskip("Box2D", reason="Gymnasium's lander needs Box2D, which has few wheels")
    from gymnasium.envs.box2d.lunar_lander import heuristic

    rng = np.random.default_rng(0)
    for _ in range(300):
        s = rng.normal(0.0, 0.4, 8)
        s[6:] = rng.uniform(size=2) < 0.2
        assert land(LANDER, s) == heuristic(_Discrete, s)


class _Discrete:
    """What the heuristic asks of an environment."""

    class unwrapped:
        continuous = False


def test_jobs_leave_out_what_a_tuner_cannot_do_or_takes_too_long_for():
    found = list(jobs({"loop 0, P": 1, "lqr": 2}, 2, TUNERS, EXPERIMENTS))
    assert len(found) == len(set(found))
    assert {tuner for name, tuner, *_ in found if name == "lqr"} == set(TUNERS)
    assert ("loop 0, P", "cmaes_full", 30, 0) not in found
    assert max(count for _, tuner, count, _ in found if tuner == "bo") == MODELS["bo"]
    assert {count for _, _, count, _ in found} == set(EXPERIMENTS)
    assert [seed for *_, seed in found] == sorted(seed for *_, seed in found)


def test_a_score_is_the_part_of_the_way_to_the_best_that_is_left():
    costs = {
        ("lqr", "cmaes_full", 30): [2.0, 6.0, 3.0],
        ("lqr", "bo", 30): [11.0, 12.0],
        ("pid_acc", "bo", 30): [-1.0],
    }
    found = scores(costs, {"lqr": 12.0, "pid_acc": 9.0})
    assert found["lqr", "cmaes_full", 30] == pytest.approx(0.1)
    assert found["lqr", "bo", 30] == pytest.approx(0.95)
    assert found["pid_acc", "bo", 30] == 0.0
    (row,) = (
        line
        for line in table(found, {"lqr": 2, "pid_acc": 4}, TUNERS).splitlines()
        if line.startswith("| lqr")
    )
    assert "**0.100**" in row
    assert "| 0.950 |" in row
