"""Numbers that are set in a user's environment keep their kind, or are refused and named."""

import math

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from zoac.core.errors import ConfigError
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv


class Tank(Drift):
    """Has numbers of every kind."""

    def __init__(self):
        self.pumps, self.delay, self.mass, self.windy = 2, np.int8(3), 1.0, False
        self._area = 0.5

    @property
    def area(self):
        return self._area

    @property
    def level(self):
        return 1.0

    @level.setter
    def level(self, value):
        if value < 0:
            raise ValueError("below the bottom")

    def reset(self, **options):
        self.history = [0.0] * self.pumps  # a float would raise here
        return super().reset(**options)


def tank(seeds=(0,), **numbers):
    env = Tank()
    envs = GymnasiumVecEnv([env], 5, **numbers)
    for seed in seeds:
        envs.reset(seed=[seed])
        yield env


@pytest.mark.parametrize(
    ("name", "given", "kept"),
    [("pumps", 3, 3), ("pumps", 3.0, 3), ("delay", 4.0, 4), ("mass", 2, 2.0)],
)  # fmt: skip
def test_a_number_keeps_its_kind(name, given, kept):
    (env,) = tank(plant={name: given})
    assert getattr(env, name) == kept
    assert type(getattr(env, name)) is type(kept)


def test_whole_numbers_are_drawn_whole_and_to_both_ends():
    drawn = [env.pumps for env in tank(range(100), vary={"pumps": (1, 3)})]
    assert set(drawn) == {1, 2, 3}
    assert {type(number) for number in drawn} == {int}


def test_a_whole_number_varies_in_a_run():
    result = zoac.tune(
        env=Tank, controller=lambda p, o: -p["k"] * o[0], space={"k": (0, 1)}, budget=100,
        num_envs=2,
        vary={"pumps": (1, 4)}, max_episode_steps=10, episodes=1, final_episodes=2, quiet=True,
    )  # fmt: skip
    assert result.env_steps >= 100


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"plant": {"pumps": 2.5}}, r"plant.pumps=2.5: .* has 2 there; expected a whole number"),
        ({"plant": {"windy": 1}}, "no number 'windy' to set"),
        ({"plant": {"pumps": True}}, "plant.pumps=True: expected a finite number"),
        ({"plant": {"mass": math.inf}}, "plant.mass=inf: expected a finite number"),
        ({"plant": {"mass": math.nan}}, "plant.mass=nan: expected a finite number"),
        ({"plant": {"mass": "2"}}, "plant.mass='2': expected a finite number"),
        ({"plant": {"area": 2.0}}, "Tank.area cannot be set .*; did you mean '_area'"),
        ({"vary": {"area": (1, 2)}}, "Tank.area cannot be set .*; did you mean '_area'"),
        ({"plant": {"level": -1}}, "Tank.level cannot be set to -1.0 .*below the bottom"),
        ({"vary": {"pump": (1, 2)}}, "no number 'pump' to set; did you mean 'pumps'"),
        ({"vary": {"pumps": (1.5, 3)}}, r"vary.pumps=\(1.5, 3\): .*expected a whole number"),
        ({"vary": {"mass": (1, math.inf)}}, r"vary.mass=\(1, inf\): expected a finite number"),
        ({"vary": {"mass": (-1e308, 1e308)}}, "expected .* a finite distance apart"),
        ({"vary": {"mass": (2, 1)}}, r"vary.mass=\(2, 1\): expected \[low, high\]"),
        ({"vary": {"mass": (1, 2, 3)}}, r"vary.mass=\(1, 2, 3\): expected \[low, high\]"),
        ({"plant": {1: 2.0}}, "Tank has no number 1 to set"),
        ({"vary": {(1,): (1, 2)}}, r"Tank has no number \(1,\) to set"),
        ({"plant": {"mass": 10**400}}, "plant.mass=1000.*: expected a finite number"),
        ({"vary": {"mass": 1.0}}, r"vary.mass=1.0: expected \[low, high\]"),
    ],
)
def test_a_number_that_cannot_be_set_is_refused_and_named(numbers, message):
    with pytest.raises(ConfigError, match=message):
        list(tank(**numbers))
