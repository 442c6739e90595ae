"""Environments that break Gymnasium's rules get a message."""

import numpy as np
import pytest

from tests.envs.test_adapters import Drift
from zoac.core.errors import EnvironmentContractError
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv

X = np.zeros(1)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        ((X, 0.0, False, {}), r"step returned 4 values, expected \(observation, reward, termin"),
        (X, r"step returned ndarray, expected \(observation"),
        ((X, 0.0, False, False, None), "info a dict"),
        ((np.zeros(2), 0.0, False, False, {}), "observation of 2 numbers, expected 1"),
    ],
)
def test_what_step_returns_is_checked(returned, message):
    class Odd(Drift):
        def step(self, action):
            return returned

    envs = GymnasiumVecEnv([Odd()], 5)
    envs.reset(seed=[0])
    with pytest.raises(EnvironmentContractError, match=message):
        envs.step(np.zeros((1, 1)))


@pytest.mark.parametrize("returned", [X, (X,), (X, 0.0)])
def test_what_reset_returns_is_checked(returned):
    class Odd(Drift):
        def reset(self, **options):
            return returned

    with pytest.raises(EnvironmentContractError, match=r"reset returned .*\(observation, info\)"):
        GymnasiumVecEnv([Odd()], 5).reset(seed=[0])
