"""Which signal is minimised: chosen, said, and never guessed where two differ."""

import functools

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TransformReward

import zoac
from tests.envs.test_adapters import Drift
from zoac.core.errors import ConfigError, EnvironmentContractError
from zoac.core.segments import Proposal
from zoac.envs.objective import Objective
from zoac.rollout.engine import RolloutEngine
from zoac.runs.schema import read_run
from zoac.tasks.user_task import user_task


class Told(Drift):
    """Its info is what a function makes of observation, reward and step."""

    def __init__(self, info):
        self.info, self.count = info, 0

    def reset(self, **options):
        self.count = 0
        return super().reset(**options)

    def step(self, action):
        observation, reward, *rest, _ = super().step(action)
        self.count += 1
        return observation, reward, *rest, self.info(observation[0], reward, self.count)


def safety(x, reward, step):
    return {"cost": float(x > 0), "energy": 2.0 * x**2}


def mixed(x, reward, step):
    return {"cost": 5.0} if step == 3 else {}


def consistent(x, reward, step):
    return {"cost": np.float32(-reward)}


def segment(env, objective="auto", penalty=None):
    task = user_task(env=env, controller=lambda params, obs: 0.0, space={"k": (0, 1)},
                     max_episode_steps=5, objective=objective)  # fmt: skip
    task.failure_penalty = penalty
    return RolloutEngine(task, [0], [100]).rollout([Proposal(np.zeros(1), 0)])[0]


def told(info):
    return functools.partial(Told, info)


def test_every_objective_is_the_signal_that_it_names():
    one = segment(told(safety), "reward")
    x = one.observations[1:, 0]
    np.testing.assert_allclose(one.costs, x**2)
    np.testing.assert_allclose(segment(told(safety), "cost").costs, x > 0)
    np.testing.assert_allclose(segment(told(safety), "info:energy").costs, 2.0 * x**2)
    assert segment(told(consistent)).costs.tolist() == one.costs.tolist()


@pytest.mark.parametrize("penalty", [None, 50.0])
@pytest.mark.parametrize(
    "env",
    [
        told(safety),
        told(lambda x, reward, step: {"cost": {"hazards": 1.0}}),
        told(lambda x, reward, step: {"cost": np.array([1.0, 2.0])}),
        lambda: TransformReward(Told(consistent), lambda r: r + 1.0),
        lambda: TransformReward(gymnasium.make("zoac/PidAcc-v0"), lambda r: 2.0 * r),
    ],
)
def test_two_signals_that_differ_are_refused_until_one_is_chosen(env, penalty):
    with pytest.raises(ConfigError, match=r'"cost"\] is .* step 1 .*objective="reward".*="cost"'):
        segment(env, penalty=penalty)
    assert np.isfinite(segment(env, "reward").costs).all()


def test_a_cost_that_comes_at_some_steps_only_is_refused_by_the_step():
    with pytest.raises(ConfigError, match=r'info\["cost"\] is 5.0 at step 3 of an episode'):
        segment(told(mixed))
    with pytest.raises(ConfigError, match=r"every step; at step 1 .* info has: \(nothing\)"):
        segment(told(mixed), "cost")
    with pytest.raises(ConfigError, match=r'"speed"\], which .* at step 1 .* info has: cost, ener'):
        segment(told(safety), "info:speed")


def test_numbers_may_come_as_arrays_of_one_and_nothing_else_may():
    objective = Objective("cost")
    assert objective.cost(0.0, {"cost": np.array([2.0])}, 1) == 2.0
    assert Objective().cost(np.array([[2.0]], np.float32), {}, 1) == -2.0
    assert Objective().cost(2, {"cost": None}, 1) == -2.0
    for reward in (None, "much", np.zeros(2), {"a": 1.0}):
        with pytest.raises(EnvironmentContractError, match=r"reward is .* step 4 .* one number"):
            Objective().cost(reward, {}, 4)
    with pytest.raises(EnvironmentContractError, match=r'info\["cost"\] is \{.* expected one numb'):
        objective.cost(0.0, {"cost": {"a": 1.0}}, 1)
    with pytest.raises(ConfigError, match="objective is info"):
        objective.cost(0.0, {"cost": None}, 1)


@pytest.mark.parametrize("name", ["costs", "info:", "info", "", None, 3, np.ones(2)])
def test_an_unknown_objective_is_refused_with_the_known_ones(name):
    with pytest.raises(ConfigError, match="objective=.* known: auto, cost, info:<key>, reward"):
        user_task(env=Drift, controller=lambda p, o: 0.0, space={"k": (0, 1)}, objective=name)


def tune(**options):
    return zoac.tune(**{
        "env": told(safety), "controller": lambda params, obs: -params["k"] * obs[0],
        "space": {"k": (0, 2)}, "budget": 100, "num_envs": 2, "episodes": 1, "final_episodes": 2,
        "max_episode_steps": 5, "tuner": "random", **options,
    })  # fmt: skip


def test_the_first_line_and_run_json_say_what_is_minimised(capsys):
    for objective, text in (("reward", "-reward"), ("cost", 'info["cost"]')):
        result = tune(objective=objective)
        first = capsys.readouterr().out.splitlines()[0]
        assert first.endswith(f"100 steps, minimising {text}")
        assert read_run(result.folder)["objective"] == text


@pytest.mark.parametrize("executor", ["serial", "process"])
def test_tune_refuses_two_signals_in_every_executor(executor, forked_workers):
    with pytest.raises(ConfigError, match=r'objective="reward"'):
        tune(executor=executor, quiet=True)


def test_another_objective_is_another_run(tmp_path):
    tune(objective="reward", folder=tmp_path, quiet=True)
    with pytest.raises(
        zoac.core.errors.RunFolderError, match="task.objective: 'reward' there, 'cost'"
    ):
        tune(objective="cost", folder=tmp_path, quiet=True)
    with pytest.raises(ConfigError, match=r"not \['objective'\]"):
        zoac.tune(task="pid_acc", objective="cost", budget=10, quiet=True)
