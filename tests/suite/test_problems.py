"""The problems on which tuners are compared."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

import zoac
from zoac.config.files import choices
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.suite import reactor
from zoac.tasks.suite.problems import LANDER, land

NAMES = [name for name in choices("task") if name.startswith("suite/")]
MORE_LOOPS = {f"suite/loop_{index}" for index in (7, 8, 9, 42, 43, 47)}
"""Beside one of each class."""
NEEDS = {"loop": "control", "lunar": "Box2D", "swimmer": "mujoco", "reacher": "mujoco",
         "half_cheetah": "mujoco"}  # fmt: skip


@pytest.mark.parametrize("name", sorted({*NAMES} - MORE_LOOPS))
def test_every_tuner_may_take_the_problem_none_is_told_gains_and_gains_differ_in_cost(name):
    for part, module in NEEDS.items():
        if part in name:
            pytest.importorskip(module, reason=f"{name} needs {module}")
    task = zoac.make_task(name)
    assert task.baseline is None
    assert not task.specs  # which tuners of parts of episodes would refuse
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4, task.space.dimension))
    engine = RolloutEngine(task, range(4), range(4))
    costs = [s.costs.sum() for s in engine.rollout([Proposal(x, k) for k, x in enumerate(points)])]
    assert np.isfinite(costs).all()
    assert len(set(costs)) > 1 or name == "suite/acrobot"  # where a random policy never arrives


def test_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ConfigError, match=r"pip install 'zoac\[suite\]'"):
        zoac.make_task("suite/loop_0")


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


def test_the_stirred_tank_rests_at_the_textbooks_operating_point():
    """T_c = 300 K keeps C = 0.8773 mol/L and T = 324.48 K, where both balances are zero."""
    env = reactor.StirredTank()
    env.reset(seed=0)
    env.c, env.t = 0.8773, 324.48
    for _ in range(reactor.STEPS):
        env.step([0.0])
    assert math.isclose(env.c, 0.8773, abs_tol=2e-4)
    assert math.isclose(env.t, 324.48, abs_tol=0.05)


def test_the_rule_of_auto_was_chosen_on_problems_that_are_not_held_out():
    folder = Path(zoac.__file__).parents[1] / "conf" / "experiment"
    chosen_on, longer, held_out = (
        set(OmegaConf.load(folder / f"{name}.yaml").hydra.sweeper.params["task"].split(","))
        for name in ("suite", "suite_long", "suite_held_out")
    )
    assert chosen_on | held_out <= set(NAMES)
    assert chosen_on == longer
    assert not chosen_on & held_out
