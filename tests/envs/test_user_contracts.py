"""What a user gives in another shape than expected works, or gets one message that says how."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, Tuple

import zoac
from tests.envs.test_adapters import Drift
from zoac.controllers.neural import linear
from zoac.core.errors import ConfigError, ControllerError, EnvironmentContractError
from zoac.core.measures import Constraint, Metric
from zoac.core.segments import Proposal
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv
from zoac.envs.single_env import env_action
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.horizon import horizon_of
from zoac.tasks.user_space import parse_space
from zoac.tasks.user_task import user_task


def task(env=Drift, controller=lambda params, obs: 0.0, **options):
    return user_task(
        **{"env": env, "controller": controller, "space": {"k": (0, 1)}, "max_episode_steps": 5}
        | options
    )


def segment(env=Drift, **options):
    return RolloutEngine(task(env, **options), [0], [1]).rollout([Proposal(np.zeros(1), 0)])[0]


class Needs(Drift):
    def __init__(self, mass):
        self.mass = mass


class OldGym:
    observation_space, action_space = Drift.observation_space, Drift.action_space

    def reset(self):
        return np.zeros(1)

    def step(self, action):
        return np.zeros(1), 0.0, False, {}


def vector():
    return gymnasium.vector.SyncVectorEnv([Drift, Drift])


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (lambda: None, "it makes None, expected a gymnasium.Env"),
        (OldGym, "it makes .*OldGym.*old Gym must be wrapped"),
        (3, "it is 3, expected a gymnasium.Env"),
        (vector, "it makes SyncVectorEnv.*give a single environment"),
        (vector(), "it is SyncVectorEnv.*give a single environment"),
        (Needs, "making it raised TypeError: .*'mass'; expected .* without arguments"),
        ("Pendulumm-v1", "env='Pendulumm-v1': making it raised NameNotFound"),
        ("no_such_module:Thing-v0", "making it raised ModuleNotFoundError"),
    ],
)
def test_what_is_no_environment_is_told_by_what_it_is(env, message):
    with pytest.raises(ConfigError, match=message):
        segment(env)
    with pytest.raises(ConfigError, match=message):
        linear(env)


class NoSeed(Drift):
    def reset(self):
        return super().reset()


class OnlySeed(Drift):
    def reset(self, seed=None):
        return super().reset(seed=seed)


class NoSeedWrapper(gymnasium.Wrapper):
    def reset(self):
        return self.env.reset()


@pytest.mark.parametrize("env", [NoSeed, lambda: NoSeedWrapper(Drift())])
def test_a_reset_without_a_seed_is_refused_with_what_it_must_look_like(env):
    with pytest.raises(ConfigError, match=r"NoSeed.*reset\(\) takes no seed.*seed=None, options="):
        segment(env)


def test_a_reset_that_takes_no_options_will_do():
    assert segment(OnlySeed).length == 5


class Typed(Drift):
    """Rewards and ends come as arrays of one number."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, np.array([reward]), np.bool_(terminated), np.array(truncated), info


def test_arrays_of_one_number_count_as_numbers():
    assert segment(Typed).costs.tolist() == segment(Drift).costs.tolist()


@pytest.mark.parametrize(
    "observation", [{"x": 1.0}, "x", [[1.0], [2.0, 3.0]], np.array(["x"]), np.array([{}])]
)
def test_an_observation_that_is_no_number_is_told(observation):
    class Odd(Drift):
        def step(self, action):
            return observation, 0.0, False, False, {}

    with pytest.raises(EnvironmentContractError, match="the observation .* expected 1 numbers"):
        segment(Odd)


@pytest.mark.parametrize("dtype", [np.int64, np.int8, np.uint8])
def test_actions_of_whole_numbers_are_rounded(dtype):
    space = Box(0, 5, (1,), dtype)
    given = [env_action(space, np.array([a])) for a in (-3.0, 0.4, 0.6, 2.9999999, 3.7, 300.0)]
    assert np.concatenate(given).tolist() == [0, 0, 1, 3, 4, 5]
    assert given[0].dtype == dtype


class Picture(Drift):
    observation_space = Box(-np.inf, np.inf, (2, 3))
    action_space = Box(-1.0, 1.0, (2, 2))

    def reset(self, **options):
        super().reset(**options)
        return np.zeros((2, 3)), {}

    def step(self, action):
        assert action.shape == (2, 2)
        return np.arange(6.0).reshape(2, 3), 0.0, False, False, {}


def test_what_is_put_in_a_row_is_said(capsys):
    remarks = GymnasiumVecEnv([Picture()], 5).remarks
    assert remarks == (
        "observations of shape (2, 3) are 6 numbers to the controller, row by row",
        "actions of shape (2, 2) are 4 numbers to the controller, row by row",
    )
    assert GymnasiumVecEnv([Drift()], 5).remarks == ()
    zoac.tune(env=Picture, controller=lambda p, o: np.zeros(4), space={"k": (0, 1)}, budget=10,
              num_envs=1, episodes=1, final_episodes=1, max_episode_steps=5,
              tuner="random")  # fmt: skip
    assert remarks[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    "space", [Dict({"x": Drift.observation_space}), Tuple([Drift.observation_space]), Discrete(3)]
)
def test_observations_of_another_kind_are_refused_with_the_wrapper(space):
    class Odd(Drift):
        observation_space = space

    with pytest.raises(ConfigError, match=r"observations are .*\.FlattenObservation"):
        segment(Odd)


@pytest.mark.parametrize(
    ("entry", "kind"),
    [
        (np.array([0.0, 5.0]), "real"), ((np.float32(0), np.float64(5)), "real"),
        (np.array([0, 5]), "real"), ((np.int64(0), np.int64(5), "integer"), "integer"),
        ({"low": np.array(0.0), "high": np.float64(5)}, "real"),
        ({"choices": np.array([0, 5])}, "choice"),
    ],
)  # fmt: skip
def test_bounds_of_numpy_are_numbers(entry, kind):
    space, fixed, _ = parse_space({"k": entry, "bias": np.array(2.5)})
    (parameter,) = space.parameters
    assert (parameter.kind, fixed) == (kind, {"bias": 2.5})
    ends = parameter.options or (parameter.low, parameter.high)
    assert list(ends) == [0, 5]
    assert all(type(end) in (int, float) for end in ends)


def test_start_values_for_some_parameters_only_are_refused_by_what_is_missing():
    space = {"kp": {"low": 0, "high": 5, "baseline": 1.0}, "kd": (0, 5), "ki": (0, 5)}
    for options in ({"space": space}, {"space": space, "baseline": {"kd": 1.0}}):
        missing = "ki" if "baseline" in options else "kd, ki"
        with pytest.raises(ConfigError, match=rf"\(s\) {missing}; values .* all of kp, kd, ki"):
            task(**options)
    with pytest.raises(ConfigError, match="did you mean 'kp'"):
        task(space={"kp": (0, 5)}, baseline={"kpp": 1.0})


def broken(segment):
    return segment.diagnostics["effort"]


def test_a_metric_or_constraint_that_raises_is_named_with_what_a_segment_has():
    one = segment()
    for quantity in (Metric("effort", broken), Constraint("effort", broken)):
        with pytest.raises(ConfigError) as caught:
            quantity.values(one)
        told = str(caught.value)
        kind = type(quantity).__name__.lower()
        assert told.startswith(f"{kind} 'effort' raised KeyError: 'effort'; a segment has")
        assert "observations (6, 1), actions (5, 1), costs (5,), and diagnostics: none" in told
        assert isinstance(caught.value.__cause__, KeyError)


def test_a_controller_that_forgets_to_return_is_told_so():
    with pytest.raises(ControllerError, match="act returned None, expected a number"):
        segment(controller=lambda params, obs: None)


def test_a_function_that_makes_the_same_environment_again_is_refused():
    one = Drift()
    with pytest.raises(ConfigError, match="returned the same Drift again; expected a new one"):
        task(env=lambda: one).make_env(2)


class InPlace(Drift):
    """Changes its action, after it has used it."""

    def step(self, action):
        answer = super().step(action)
        action += 1.0
        return answer


def test_what_an_environment_does_with_its_action_is_not_recorded():
    assert np.array_equal(segment(InPlace).actions, segment(Drift).actions)


class Told(Drift):
    """Ends its episode by a value of any kind."""

    def __init__(self, ended):
        self.ended = ended

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, self.ended, False, info


@pytest.mark.parametrize("ended", [1, np.True_, np.ones(1), np.array(1)])
def test_an_episode_ends_by_any_truth_value(ended):
    assert segment(lambda: Told(ended)).terminated


@pytest.mark.parametrize("ended", ["False", np.zeros(2), [], {}])
def test_what_is_no_truth_value_is_told(ended):
    with pytest.raises(EnvironmentContractError, match="as terminated, expected True or False"):
        segment(lambda: Told(ended))


class Stuck(Drift):
    def close(self):
        raise OSError("no viewer")


def test_an_environment_that_cannot_be_closed_is_tuned_all_the_same():
    given = task(Stuck, signals={"y": zoac.observation(0)}, sample_time=0.1)
    given.make_env(2).close()
    assert given.shortest_horizon is not None


@pytest.mark.parametrize(("steps", "limit"), [(3, 3), (9, 4), (None, 4)])
def test_the_smaller_of_two_time_limits_counts(steps, limit):
    limited = task(lambda: gymnasium.wrappers.TimeLimit(Drift(), 4), max_episode_steps=steps)
    assert limited.make_env(1).max_episode_steps == horizon_of(limited).steps == limit


@pytest.mark.parametrize("name", [1, "", None])
def test_the_name_of_a_parameter_is_text(name):
    with pytest.raises(ConfigError, match="the name of a parameter must be text"):
        parse_space({name: (0, 1)})
