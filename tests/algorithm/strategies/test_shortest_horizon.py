"""Who says after how many steps an episode can tell good parameters from bad ones."""

import pytest

from tests.specs.loops_to_tune import FirstOrder, proportional
from zoac.config.factory import build_settings, build_tuner
from zoac.config.files import configuration
from zoac.core.errors import ConfigError
from zoac.tasks.given_task import make_task
from zoac.tasks.pid_loop import Design, designed
from zoac.tasks.user_task import user_task


class Slow(FirstOrder):
    metadata = {"shortest_horizon": 12}


def task_of(env):
    return user_task(
        env=env, controller=proportional, space={"k": (0.5, 12.0)}, max_episode_steps=40
    )


def first_horizon(task):
    """Return the horizon of the first proposals of zoac_plus."""
    config = configuration(task=None, tuner="zoac_plus", preset=None)
    config |= {"budget": 20_000, "num_envs": 2}
    return build_tuner(config["tuner"], task, build_settings(config)).ask()[0].horizon


def test_an_environment_says_it_and_successive_halving_looks_no_shorter():
    assert first_horizon(task_of(FirstOrder)) == 1
    assert first_horizon(task_of(Slow)) == 12
    assert make_task("lqr").shortest_horizon == 0


def test_a_loop_needs_its_dead_time_and_as_long_as_a_good_one_takes_to_settle():
    control = pytest.importorskip("control")
    plant = control.tf([1.0], [1.0, 1.0])
    quick, late = (
        designed(Design([plant], [dead_time], 0.1), "simc")[0] for dead_time in (0.0, 1.0)
    )
    assert 0 < quick.shortest_horizon < 10 < late.shortest_horizon < late.experiment.load_at


def test_what_is_no_number_of_steps_is_refused():
    class Wrong(FirstOrder):
        shortest_horizon = 2.5

    with pytest.raises(ConfigError, match="shortest_horizon=2.5: expected steps"):
        _ = task_of(Wrong).shortest_horizon
