"""What `tuner="auto"` stands for."""

import numpy as np
import pytest

import zoac
from tests.support import CountingTask
from zoac import specs
from zoac.config.auto_tuner import MAX_COORDINATES, MIN_EPISODES, tuner_for
from zoac.core.parameters import Parameter, ParameterSpace


def task(dimension, with_specs=False):
    made = CountingTask(10)
    made.space = ParameterSpace([Parameter(f"p{k}", 0.0, 1.0) for k in range(dimension)])
    made.specs = (specs.peak("y", max=1.0),) if with_specs else ()
    return made


@pytest.mark.parametrize(
    ("dimension", "with_specs", "episodes", "name"),
    [
        (2, False, MIN_EPISODES, "cmaes_full"),
        (2, False, MIN_EPISODES - 1, "zoac"),
        (MAX_COORDINATES + 1, False, 10_000, "zoac"),
        (1, False, 10_000, "zoac"),
        (2, True, 5, "cmaes_full"),
        (1, True, 5, "nevergrad"),
    ],
)
def test_it_is_chosen_by_parameters_budget_and_specs(dimension, with_specs, episodes, name):
    chosen, settings = tuner_for(task(dimension, with_specs), 10 * episodes)
    assert chosen == name
    assert settings == ({"common_random_numbers": True} if name == "cmaes_full" and not with_specs
                        else {})  # fmt: skip


def test_it_is_the_default_and_is_recorded_by_name():
    result = zoac.tune(task="lqr", budget=20_000, quiet=True, final_episodes=2)
    assert np.isfinite(result.cost_mean)
    assert zoac.load_result(result.folder).record["tuner"] == "cmaes_full"
