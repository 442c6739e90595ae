"""What tells one function, class or object from another, whatever its name."""

import copy
import functools
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from tests.envs.test_adapters import Drift, Integrator
from zoac.config.fingerprint import CannotTellError, described, told
from zoac.core.measures import Constraint

ROOT = Path(__file__).parents[2]
GAIN = 1.0


class Plant(Drift):
    def __init__(self, gain=1.0):
        super().__init__()
        self.gain = gain


class Gains:
    def __init__(self, **gains):
        self.__dict__.update(gains)

    def act(self, params, obs):
        return -params["k"] * obs[0]


@dataclass(frozen=True)
class Frozen:
    table: tuple
    names: frozenset


def closure(limit):
    return lambda s: s.costs - limit


def default(params, obs, gain=GAIN):
    return gain * obs


def reads_a_global(params, obs):
    return helper(obs)


def helper(obs):
    return GAIN * obs


def scaled(env, factor):
    return gymnasium.wrappers.TransformReward(env, functools.partial(np.multiply, factor))


def heavier():
    env = gymnasium.make("Pendulum-v1")
    env.unwrapped.m = 2.0
    return env


def with_code(body):
    """Return a class that is made from source text, always under the same name."""
    space = {"__name__": __name__}
    exec(f"class Made:\n    def step(self, a):\n        {body}", space)
    return space["Made"]


ALIKE = {
    "partial": lambda: functools.partial(Plant, 1.0),
    "lambda": lambda: lambda p, o: -p["k"] * o[0],
    "closure": lambda: closure(1.0),
    "object": lambda: Gains(a=1.0, table=np.arange(3.0), nested={"x": [1, {2, 3}]}),
    "environment": lambda: Plant(2.0),
    "gym.make": lambda: gymnasium.make("Pendulum-v1"),
    "wrapped": lambda: scaled(gymnasium.make("Pendulum-v1"), 2.0),
    "constraint": lambda: Constraint("x", closure(1.0)),
    "method": lambda: Gains(a=1.0).act,
    "class": lambda: Plant,
    "made": lambda: with_code("return 1.0"),
    "sets": lambda: Frozen((1, "a"), frozenset("abcdefgh")),
    "global": lambda: reads_a_global,
}

OTHERWISE = {
    "partial's argument": (functools.partial(Plant, 1.0), functools.partial(Plant, 0.01)),
    "partial's keyword": (functools.partial(Plant, gain=1.0), functools.partial(Plant, gain=2.0)),
    "lambda": (lambda p, o: -p["k"] * o[0], lambda p, o: -p["k"] * o[1]),
    "constant": (lambda p, o: 1.0 * o[0], lambda p, o: 2.0 * o[0]),
    "closure": (closure(1.0), closure(2.0)),
    "attribute": (Gains(a=1.0), Gains(a=2.0)),
    "array": (Gains(a=np.zeros(3)), Gains(a=np.array([0.0, 0.0, 1e-300]))),
    "array's type": (Gains(a=np.zeros(2, np.float32)), Gains(a=np.zeros(1))),
    "number's type": (Gains(a=1), Gains(a=1.0)),
    "environment": (Plant(1.0), Plant(2.0)),
    "id": (gymnasium.make("Pendulum-v1"), gymnasium.make("CartPole-v1")),
    "argument of gym.make": (gymnasium.make("Pendulum-v1"), gymnasium.make("Pendulum-v1", g=9.0)),
    "attribute set after gym.make": (gymnasium.make("Pendulum-v1"), heavier()),
    "wrapper": (
        scaled(gymnasium.make("Pendulum-v1"), 1.0), scaled(gymnasium.make("Pendulum-v1"), 2.0)
    ),
    "constraint's limit": (Constraint("x", closure(1.0)), Constraint("x", closure(2.0))),
    "constraint's scale": (Constraint("x", np.ravel), Constraint("x", np.ravel, scale=2.0)),
    "method's object": (Gains(a=1.0).act, Gains(a=2.0).act),
    "code of a class": (with_code("return 1.0"), with_code("return 2.0")),
    "instance of such a class": (with_code("return 1.0")(), with_code("return 2.0")()),
    "cached function": (functools.cache(closure(1.0)), functools.cache(closure(2.0))),
}  # fmt: skip


@pytest.mark.parametrize("make", ALIKE.values(), ids=ALIKE)
def test_what_is_made_alike_is_described_alike(make):
    assert described(make()) == described(make())


@pytest.mark.parametrize(("one", "other"), OTHERWISE.values(), ids=OTHERWISE)
def test_what_does_otherwise_is_described_otherwise(one, other):
    assert described(one) != described(other)
    assert described(one).partition("@")[2] != described(other).partition("@")[2]


@pytest.mark.parametrize("name", ["default", "reads_a_global"])
def test_a_default_and_a_global_that_is_read_count(monkeypatch, name):
    before = described(globals()[name])
    monkeypatch.setattr(default, "__defaults__", (2.0,))
    monkeypatch.setitem(globals(), "GAIN", 2.0)
    assert described(globals()[name]) != before


def test_every_process_describes_alike():
    text = (
        "from tests.config.test_fingerprint import ALIKE, described\n"
        "print(*(described(make()) for make in ALIKE.values()))"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", text], cwd=ROOT, check=True, text=True,
        capture_output=True, env={**os.environ, "PYTHONHASHSEED": "1"},
    )  # fmt: skip
    assert done.stdout.split() == [described(make()) for make in ALIKE.values()]


def test_an_id_stands_for_itself_and_a_name_comes_first():
    assert described("Pendulum-v1") == "Pendulum-v1"
    assert described(functools.partial(Plant, 1.0)).startswith(f"{__name__}.Plant@")
    assert described(gymnasium.make("Pendulum-v1")).startswith("Pendulum-v1@")


def test_a_copy_and_one_that_was_seeded_are_the_same():
    env = gymnasium.make("Pendulum-v1")
    assert described(copy.deepcopy(env)) == described(env)
    fresh, seeded = Plant(), Plant()
    seeded.np_random = np.random.default_rng(3)
    assert described(fresh) == described(seeded)


def test_an_environment_whose_spaces_were_printed_is_the_same():
    class Own(Plant):
        observation_space = Box(-1.0, 1.0, (1,))

    before = described(Own())
    assert str(Own.observation_space)
    assert described(Own()) == before


def test_what_holds_itself_is_described():
    one, other = Gains(a=1.0), Gains(a=2.0)
    one.me, other.me = one, other
    assert described(one) != described(other)
    assert described(one) == described(copy.deepcopy(one))


def test_what_cannot_be_compared_is_named_by_its_place():
    with pytest.raises(CannotTellError, match="attribute 'b' of attribute 'a' is a lock"):
        described(Gains(a=Gains(b=threading.Lock())))
    texts, doubts = told({"controller": Integrator(), "metrics": {"m": Gains(a=threading.Lock())}})
    assert "@" in texts["controller"]
    assert doubts == ["metrics.m: attribute 'a' is a lock, which cannot be compared"]
