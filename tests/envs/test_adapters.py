from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary
from gymnasium.wrappers import ClipAction, TimeLimit

from tests.support import same_segment
from zoac.controllers.user_controller import ScalarController
from zoac.core.errors import ConfigError, ControllerError
from zoac.core.measures import Metric
from zoac.core.segments import Proposal
from zoac.envs import gymnasium_adapter
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv
from zoac.envs.single_env import env_action
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.user_space import parse_space
from zoac.tasks.user_task import user_task


class Drift(gymnasium.Env):
    """x moves by the action and by noise; reward -x^2; ends beyond 3."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    action_space = Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.normal()
        return np.array([self.x]), {}

    def step(self, action):
        self.last_action = action
        self.x += float(action[0]) + 0.1 * self.np_random.normal()
        return np.array([self.x]), -(self.x**2), abs(self.x) > 3, False, {}


class Integrator:
    """A controller that remembers."""

    def reset(self):
        self.total = 0.0

    def act(self, params, obs):
        self.total += obs[0]
        return -params["k"] * self.total


SPACE, _, _ = parse_space({"k": (0.0, 1.0)})


def make_group(env_indices, controller=None, **options):
    given = {"env": Drift, "controller": controller or Integrator(), "space": SPACE, **options}
    task = user_task(max_episode_steps=9, **given)
    return RolloutEngine(task, env_indices, [100 + env_index for env_index in env_indices])


def plan(env_indices, **kind):
    return [Proposal(np.array([0.1]), env_index, **kind) for env_index in env_indices]


def test_cost_is_the_negative_reward_and_the_limit_truncates():
    (segment,) = make_group([0]).rollout(plan([0]))
    np.testing.assert_allclose(segment.costs, segment.observations[1:, 0] ** 2)
    assert (segment.length, segment.truncated, segment.terminated) == (9, True, False)


def test_a_controllers_memory_begins_anew_with_each_episode():
    one, two = make_group([0]).rollout(plan([0]) * 2)
    for segment in (one, two):
        k = SPACE.denormalise(np.array([0.1]))["k"]
        np.testing.assert_allclose(
            segment.commands[:, 0], -k * np.cumsum(segment.observations[:-1, 0])
        )


def test_environments_are_the_same_in_any_company():
    together = make_group([0, 1, 2]).rollout(plan([0, 1, 2]) * 2)
    for env_index in (0, 1, 2):
        alone = make_group([env_index]).rollout(plan([env_index]) * 2)
        assert same_segment(alone[0], together[env_index])
        assert same_segment(alone[1], together[3 + env_index])


def test_a_restored_segment_leaves_environment_and_controller_where_they_stood():
    branched, straight = make_group([0]), make_group([0])
    branched.rollout(plan([0], horizon=3))
    straight.rollout(plan([0], horizon=3))
    _, after = branched.rollout([*plan([0], horizon=4, restore=True), *plan([0], horizon=4)])
    assert same_segment(after, straight.rollout(plan([0], horizon=4))[0])


def test_actions_reach_the_environment_in_its_own_type_and_bounds():
    envs = GymnasiumVecEnv([env := Drift()], 5)
    envs.reset(seed=[0])
    envs.step(np.array([[9.0]]))
    assert env.last_action.dtype == np.float32
    assert env.last_action.tolist() == [1.0]


def test_discrete_actions_are_rounded_into_range():
    env = gymnasium.make("CartPole-v1")
    assert GymnasiumVecEnv([env], None).max_episode_steps == 500
    assert isinstance(env.action_space, Discrete)
    given = [env_action(env.action_space, np.array([a])) for a in (-3.0, 0.4, 0.6, 7.0)]
    assert given == [0, 0, 1, 1]


def test_spaces_that_cannot_be_tuned_on_are_named():
    class Odd(Drift):
        action_space = MultiBinary(3)

    with pytest.raises(ConfigError, match=r"actions are MultiBinary\(3\); expected a Box"):
        GymnasiumVecEnv([Odd()], 5)


def test_fixed_parameters_reach_the_controller():
    seen = {}

    def act(params, obs):
        seen.update(params)
        return 0.0

    space = {"k": (0.0, 1.0), "bias": 2.5, "steps": np.int64(3), "clip": True}
    make_group([0], act, space=space).rollout(plan([0], horizon=1))
    assert seen == {"k": pytest.approx(0.55), "bias": 2.5, "steps": 3, "clip": True}
    assert [type(seen[name]) for name in ("bias", "steps", "clip")] == [float, int, bool]


class Batched:
    """Pushes by a tuned and a fixed parameter, all environments at once."""

    def init(self, n):
        return {}

    def act(self, params, obs, memory):
        return np.stack([params["k"] + params["bias"]], axis=1), memory, {}


def test_a_batched_controller_gets_the_fixed_parameters_of_every_environment():
    task = user_task(
        env=Drift, controller=Batched(), space={"k": (0, 1), "bias": 0.25}, max_episode_steps=9
    )
    group = RolloutEngine(task, [0, 1], [100, 101])
    points = [
        Proposal(np.array([z]), env_index, horizon=3) for env_index, z in enumerate((-1.0, 0.0))
    ]
    one, two = group.rollout(points)
    assert one.actions.tolist() == [[0.25]] * 3
    assert two.actions.tolist() == [[0.75]] * 3


def test_a_controller_that_raises_is_told_with_its_parameters():
    def act(params, obs):
        raise ValueError("no plan")

    with pytest.raises(
        ControllerError, match=r"raised ValueError: no plan. Environment 0, .*k=0.55"
    ):
        make_group([0], act).rollout(plan([0], horizon=1))


def test_a_plain_function_has_no_memory():
    space, _, _ = parse_space({"k": (0, 1)})
    assert ScalarController(lambda params, obs: 0.0, {}, space).init(3) == {}


def test_every_way_to_write_a_space():
    space, fixed, start = parse_space(
        {
            "kp": (0, 5),
            "kd": (1e-3, 1e1, "log"),
            "ki": {"low": 0, "high": 1, "unit": "1/s", "baseline": 0.5},
            "bias": 2,
        },
        {"kp": 1.0, "kd": 0.1},
    )
    assert space.names == ("kp", "kd", "ki")
    assert [p.scale for p in space.parameters] == ["linear", "log", "linear"]
    assert space.parameters[2].unit == "1/s"
    assert (fixed, start) == ({"bias": 2.0}, {"ki": 0.5, "kp": 1.0, "kd": 0.1})


@pytest.mark.parametrize(
    ("entry", "message"),
    [("x", "expected"), ((1,), "expected low and high"), ({"lo": 0, "high": 1}, "expected low"),
     ((5, 0), "must be below"),
     ((0, 5, "linear", "N", "zzz"), r"space\['k'\]=.*expected at most low, high, scale, unit"),
     ({"low": 0, "high": 1, "baseline": "a"}, r"space\['k'\].baseline='a': expected a number"),
     ({"low": 0, "high": 1, "baseline": None}, r"space\['k'\].baseline=None: expected a number")],
)  # fmt: skip
def test_a_space_that_makes_no_sense_is_refused(entry, message):
    with pytest.raises(ConfigError, match=message):
        parse_space({"k": entry})


class Heavy(Drift):
    mass = 1.0


def masses(envs):
    return [env.unwrapped.mass for env in envs._envs]


def test_a_plant_that_varies_is_drawn_from_the_environments_seed():
    envs = GymnasiumVecEnv([Heavy(), Heavy(), Heavy()], 5, vary={"mass": (0.5, 2.0)})
    envs.reset(seed=[7, 7, 8])
    one, two, three = masses(envs)
    assert one == two != three
    assert all(0.5 <= mass <= 2.0 for mass in (one, three))
    state = envs.state([0])
    envs.reset()
    following = masses(envs)[0]
    assert following != one
    envs.restore([0], state)
    assert masses(envs)[0] == one
    envs.reset()
    assert masses(envs)[0] == following


def held(segment):
    return segment.costs


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metrics": [held]}, r"metrics: <function held.* is no Metric; .*metrics=\{'my_name'"),
        ({"metrics": held}, "metrics: <function held.* is no Metric"),
        ({"metrics": "tank.level"}, "metrics: 'tank.level' is no Metric"),
        ({"constraints": held}, "constraints: <function held.* is no Constraint"),
        ({"constraints": [Metric("m", held)]}, "is no Constraint"),
        ({"constraints": {"c": 3}}, "constraint 'c': expected a function of a segment, got 3"),
        ({"metrics": [Metric("m", held), Metric("m", held)]}, "metrics: names .* repeated: m"),
        ({"space": [("k", 0, 1)]}, "space=.*: expected bounds by name"),
        ({"baseline": "a"}, "baseline='a': expected values by name"),
        ({"baseline": {"k": "a"}}, "parameter 'k': expected a number from 0 to 1, got 'a'"),
        *(
            ({"max_episode_steps": steps}, "max_episode_steps=.*: expected 1 or more, a whole")
            for steps in (0, 3.5, "200", 10**30, [1])
        ),
        ({"plant": 3}, "plant=3: expected numbers by attribute"),
        ({"vary": [("k", 1, 2)]}, "vary=.*: expected numbers by attribute"),
    ],
)
def test_what_a_task_cannot_be_made_of_is_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        user_task(**{"env": Drift, "controller": Integrator(), "space": {"k": (0, 1)}, **changes})


class Restless(Heavy):
    """Its step and, unless told otherwise, its reset put a number of their own there."""

    def __init__(self, resets=True):
        self.mass, self.resets = 1.0, resets

    def reset(self, **options):
        self.mass = 1.0 if self.resets else self.mass
        return super().reset(**options)

    def step(self, action):
        self.mass *= 0.9
        return super().step(action)


@pytest.mark.parametrize("how", [{"plant": {"mass": 3.0}}, {"vary": {"mass": (2.0, 3.0)}}])
def test_a_number_that_reset_overwrites_is_refused_and_named(how):
    envs = GymnasiumVecEnv([Restless()], 5, **how)
    with pytest.raises(ConfigError, match=r"Restless.reset sets 'mass' to 1.0 itself"):
        envs.reset(seed=[0])


def test_a_plant_holds_at_the_start_of_every_episode():
    envs = GymnasiumVecEnv([Restless(resets=False)], 5, plant={"mass": 3.0})
    for _ in range(2):
        envs.reset(seed=[0])
        assert masses(envs) == [3.0]
        envs.step(np.zeros((1, 1)))


class Endless(Drift):
    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, False, False, info


def test_a_time_limit_anywhere_among_the_wrappers_is_found():
    assert GymnasiumVecEnv([ClipAction(TimeLimit(Drift(), 7))], None).max_episode_steps == 7
    assert GymnasiumVecEnv([TimeLimit(TimeLimit(Drift(), 7), 9)], None).max_episode_steps == 7


def test_an_episode_that_nothing_ends_is_an_error_and_one_that_ends_by_itself_is_none(monkeypatch):
    monkeypatch.setattr(gymnasium_adapter, "MAX_EPISODE_STEPS", 30)
    push = {"controller": lambda params, obs: 1.0, "space": {"k": (0, 1)}}
    ends, never = (RolloutEngine(user_task(env=env, **push), [0], [1]) for env in (Drift, Endless))
    assert ends.rollout(plan([0]))[0].terminated
    with pytest.raises(ConfigError, match="not ended after 30 steps.*give max_episode_steps") as e:
        never.rollout(plan([0]))
    faq = Path(__file__).parents[2] / "docs" / "faq.md"
    assert "the environment needs a time limit" in str(e.value)
    assert "the environment needs a time limit" in faq.read_text()


def test_steps_of_other_environments_do_not_count():
    envs = GymnasiumVecEnv([Drift(), Drift()], 3)
    envs.reset(seed=[0, 1])
    actions, alone = np.zeros((2, 1)), np.array([True, False])
    assert [envs.step(actions, alone)[3].tolist() for _ in range(3)][-1] == [True, False]
    assert [envs.step(actions, ~alone)[3].tolist() for _ in range(3)] == [
        [False, False], [False, False], [False, True],
    ]  # fmt: skip


class Blind(Drift):
    """Its observation is nan, and its episode over, once x has moved by an action of 1."""

    def step(self, action):
        observation, reward, _, cut, info = super().step(action)
        blind = float(action[0]) == 1.0
        return observation * (np.nan if blind else 1.0), reward, blind, cut, info


def test_where_an_observation_is_not_finite_the_environment_fails_and_its_last_one_stays():
    envs = GymnasiumVecEnv([Blind(), Blind()], 5)
    before, _ = envs.reset(seed=[0, 1])
    seen, rewards, terminated, truncated, infos = envs.step(np.array([[1.0], [0.0]]))
    assert seen[0] == before[0]
    assert seen[1] != before[1]
    assert list(infos["failures"]) == [0]
    assert "every number must be finite" in str(infos["failures"][0])
    assert (rewards[0], infos["cost"][0]) == (0.0, 0.0)
    assert rewards[1] < 0.0
    assert not terminated.any()
    assert not truncated.any()
    assert envs.state([0])["seen"] == before[0]
