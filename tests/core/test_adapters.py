import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary

from tests.support import same_segment
from zoac.adapters import ScalarController, UserTask, parse_space
from zoac.errors import ConfigError, ControllerError, EnvironmentContractError
from zoac.gymnasium_lanes import GymnasiumLanes, env_action
from zoac.rollout import LaneGroup
from zoac.segments import Proposal


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


def make_group(lanes, controller=None, **options):
    task = UserTask(Drift, controller or Integrator(), SPACE, max_episode_steps=9, **options)
    return LaneGroup(task, lanes, [100 + lane for lane in lanes])


def plan(lanes, **kind):
    return [Proposal(np.array([0.1]), lane, **kind) for lane in lanes]


def test_cost_is_the_negative_reward_and_the_limit_truncates():
    (segment,) = make_group([0]).rollout(plan([0]))
    np.testing.assert_allclose(segment.costs, segment.observations[1:, 0] ** 2)
    assert (segment.length, segment.truncated, segment.terminated) == (9, True, False)


def test_cost_in_info_comes_first():
    class Costly(Drift):
        def step(self, action):
            observation, *rest, _ = super().step(action)
            return observation, *rest, {"cost": 7.0}

    lanes = GymnasiumLanes([Costly()], 5)
    lanes.reset(seed=[0])
    assert lanes.step(np.zeros((1, 1)))[4]["cost"].tolist() == [7.0]


def test_a_controllers_memory_begins_anew_with_each_episode():
    one, two = make_group([0]).rollout(plan([0]) * 2)
    for segment in (one, two):
        k = SPACE.physical(np.array([0.1]))["k"]
        np.testing.assert_allclose(
            segment.actions[:, 0], -k * np.cumsum(segment.observations[:-1, 0])
        )


def test_lanes_are_the_same_in_any_company():
    together = make_group([0, 1, 2]).rollout(plan([0, 1, 2]) * 2)
    for lane in (0, 1, 2):
        alone = make_group([lane]).rollout(plan([lane]) * 2)
        assert same_segment(alone[0], together[lane])
        assert same_segment(alone[1], together[3 + lane])


def test_a_branch_leaves_environment_and_controller_where_they_stood():
    branched, straight = make_group([0]), make_group([0])
    branched.rollout(plan([0], horizon=3))
    straight.rollout(plan([0], horizon=3))
    _, after = branched.rollout([*plan([0], horizon=4, branch=True), *plan([0], horizon=4)])
    assert same_segment(after, straight.rollout(plan([0], horizon=4))[0])


def test_restored_lanes_go_on_to_the_same_bits():
    group, twin = make_group([0, 1]), make_group([0, 1])
    group.rollout(plan([0, 1], horizon=4))
    twin.restore(group.state())
    for one, two in zip(group.rollout(plan([0, 1])), twin.rollout(plan([0, 1])), strict=True):
        assert same_segment(one, two)


def test_actions_reach_the_environment_in_its_own_type_and_bounds():
    lanes = GymnasiumLanes([env := Drift()], 5)
    lanes.reset(seed=[0])
    lanes.step(np.array([[9.0]]))
    assert env.last_action.dtype == np.float32
    assert env.last_action.tolist() == [1.0]


def test_discrete_actions_are_rounded_into_range():
    env = gymnasium.make("CartPole-v1")
    assert GymnasiumLanes([env], None).max_episode_steps == 500
    assert isinstance(env.action_space, Discrete)
    given = [env_action(env.action_space, np.array([a])) for a in (-3.0, 0.4, 0.6, 7.0)]
    assert given == [0, 0, 1, 1]


def test_spaces_that_cannot_be_tuned_on_are_named():
    class Odd(Drift):
        action_space = MultiBinary(3)

    with pytest.raises(ConfigError, match=r"actions are MultiBinary\(3\); expected a Box"):
        GymnasiumLanes([Odd()], 5)


def test_an_observation_of_the_wrong_size_is_refused():
    class Wrong(Drift):
        def reset(self, **options):
            super().reset(**options)
            return np.zeros(2), {}

    with pytest.raises(EnvironmentContractError, match="observation of 2 numbers, expected 1"):
        GymnasiumLanes([Wrong()], 5).reset(seed=[0])


def test_fixed_parameters_reach_the_controller():
    seen = {}

    def act(params, obs):
        seen.update(params)
        return 0.0

    make_group([0], act, fixed={"bias": 2.5}).rollout(plan([0], horizon=1))
    assert seen == {"k": pytest.approx(0.55), "bias": 2.5}


def test_a_controller_that_raises_is_told_with_its_parameters():
    def act(params, obs):
        raise ValueError("no plan")

    with pytest.raises(ControllerError, match=r"raised ValueError: no plan. Lane 0, .*k=0.55"):
        make_group([0], act).rollout(plan([0], horizon=1))


def test_a_plain_function_has_no_memory():
    assert ScalarController(lambda params, obs: 0.0, {}).init(3) == {}


def test_every_way_to_write_a_space():
    space, fixed, start = parse_space(
        {
            "kp": (0, 5),
            "kd": (1e-3, 1e1, "log"),
            "ki": {"low": 0, "high": 1, "unit": "1/s", "start": 0.5},
            "bias": 2,
        }
    )
    assert space.names == ("kp", "kd", "ki")
    assert [p.scale for p in space.parameters] == ["linear", "log", "linear"]
    assert space.parameters[2].unit == "1/s"
    assert (fixed, start) == ({"bias": 2.0}, {"ki": 0.5})


@pytest.mark.parametrize(
    ("entry", "message"),
    [("x", "expected"), ((1,), "expected low and high"), ({"lo": 0, "high": 1}, "expected low"),
     ((5, 0), "must be below")],
)  # fmt: skip
def test_a_space_that_makes_no_sense_is_refused(entry, message):
    with pytest.raises(ConfigError, match=message):
        parse_space({"k": entry})


class Heavy(Drift):
    mass = 1.0


def masses(lanes):
    return [env.unwrapped.mass for env in lanes._envs]


def test_a_plant_that_varies_is_drawn_from_the_lanes_seed():
    lanes = GymnasiumLanes([Heavy(), Heavy(), Heavy()], 5, vary={"mass": (0.5, 2.0)})
    lanes.reset(seed=[7, 7, 8])
    one, two, three = masses(lanes)
    assert one == two != three
    assert all(0.5 <= mass <= 2.0 for mass in (one, three))
    state = lanes.state([0])
    lanes.reset()
    following = masses(lanes)[0]
    assert following != one
    lanes.restore([0], state)
    assert masses(lanes)[0] == one
    lanes.reset()
    assert masses(lanes)[0] == following


def test_a_plant_is_set_and_what_it_has_not_is_named():
    assert masses(GymnasiumLanes([Heavy()], 5, plant={"mass": 3.0})) == [3.0]
    env = Heavy()
    env.mass = 1.0  # an attribute of its own, so that it can be listed
    with pytest.raises(ConfigError, match="no number 'mas' to set; did you mean 'mass'"):
        GymnasiumLanes([env], 5, plant={"mas": 3.0})
    with pytest.raises(ConfigError, match=r"vary.mass=\[2.0, 1.0\]"):
        GymnasiumLanes([env], 5, vary={"mass": (2.0, 1.0)})
