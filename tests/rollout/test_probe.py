"""Restoring is tried before it is relied on."""

import copy
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import EzPickle
from gymnasium.wrappers import (
    FrameStackObservation,
    NormalizeObservation,
    NormalizeReward,
    TimeLimit,
)

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, engine, proposal, same_segment
from zoac import check
from zoac.core.errors import ConfigError
from zoac.envs import gymnasium_adapter
from zoac.rollout.horizon import horizon_of
from zoac.runs.training.trainer import Trainer
from zoac.tasks.user_task import user_task

FILES = (Path(__file__).parents[2] / "conf" / "task").glob("*.yaml")
TASKS = sorted({p.stem for p in FILES} - {"program"})  # it has no environment


def task(env, **options):
    given = {"controller": lambda p, o: -p["k"] * o[0], "space": {"k": (0, 2)}}
    return user_task(env=env, **{**given, **options})


class Cart(gymnasium.Env):
    """A double integrator that begins at 3 to 5, and moves by at most 0.3 a step."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float64)

    def __init__(self):
        self.x = np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.array([self.np_random.uniform(3.0, 5.0), 0.0])
        return self.x.copy(), {}

    def step(self, action):
        speed = np.clip(self.x[1] + 0.1 * float(action[0]), -3.0, 3.0)
        self.x = np.array([self.x[0] + 0.1 * self.x[1], speed])
        return self.x.copy(), -float(self.x[0] ** 2), False, False, {}


class Rebuilt(Cart, EzPickle):
    """Built anew where it is copied, as all of Gymnasium's MuJoCo and Box2D environments."""

    def __init__(self):
        EzPickle.__init__(self)
        Cart.__init__(self)


class CopiedOnly(Rebuilt):
    """Copied by deepcopy, but built anew by pickle."""

    def __deepcopy__(self, memo):
        twin = CopiedOnly()
        twin.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return twin


SERVER: dict[int, np.ndarray] = {}


class Remote(Cart):
    """Its state is kept by a server that it knows by a number."""

    def __init__(self):
        self.number = len(SERVER)
        SERVER[self.number] = np.zeros(2)

    @property
    def x(self):
        return SERVER[self.number]

    @x.setter
    def x(self, value):
        SERVER[self.number] = value


class Handle:
    def __init__(self):
        self.pushes = 0.0

    def __deepcopy__(self, memo):
        return self


class Shared(Cart):
    """Its copies share a part of it, which only some steps show."""

    def __init__(self):
        super().__init__()
        self.handle = Handle()

    def step(self, action):
        self.handle.pushes += float(action[0])
        observation, reward, *rest = super().step(action)
        return observation, reward - 1e-9 * self.handle.pushes, *rest


COURSE = {"length": 0.0}


class OnCourse(Cart):
    """Its reset writes what every instance then reads."""

    def reset(self, **options):
        observation, info = super().reset(**options)
        COURSE["length"] = float(self.np_random.uniform())
        return observation, info

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward - COURSE["length"], *rest


class Bolted(Cart):
    def __deepcopy__(self, memo):
        raise TypeError("bolted to the bench")


@pytest.mark.parametrize(
    ("env", "told"),
    [
        (Rebuilt, "goes on otherwise at step 1: deepcopy"),
        (lambda: TimeLimit(Rebuilt(), 9), "goes on otherwise"),
        (Remote, "goes on otherwise at step 1"),
        (Shared, "goes on otherwise"),
        (OnCourse, "goes on otherwise"),
        (Bolted, "copying it raised TypeError: bolted to the bench"),
    ],
)
def test_an_environment_that_is_not_restored_is_found_out(env, told):
    sick = task(env, max_episode_steps=30)
    assert told in sick.restore_fault
    assert check.env_state(sick) == (False, sick.restore_fault)


@pytest.mark.parametrize(
    "env",
    [Cart, Drift, "Pendulum-v1", "CartPole-v1", lambda: FrameStackObservation(Cart(), 3),
     lambda: TimeLimit(Cart(), 1)],
)  # fmt: skip
def test_an_environment_that_is_restored_is_trusted(env):
    sound = task(env, max_episode_steps=30)
    assert (sound.restore_fault, sound.save_fault) == (None, None)
    assert check.env_state(sound)[0]


@pytest.mark.parametrize("name", TASKS)
def test_built_in_tasks_are_restored_and_saved(name):
    built_in = zoac.make_task(name)
    assert (built_in.restore_fault, built_in.save_fault) == (None, None)


def test_a_pickle_is_tried_apart_from_a_copy():
    half = task(CopiedOnly, max_episode_steps=30)
    assert half.restore_fault is None
    assert "pickle misses a part" in half.save_fault


def test_what_box2d_cannot_go_on_with_is_tuned():
    pytest.importorskip("Box2D", reason="LunarLander-v3 needs Box2D")
    lander = task("LunarLander-v3")
    assert "step raised AssertionError" in lander.restore_fault
    result = zoac.tune(task=lander, tuner="zoac_plus", budget=600, num_envs=2, episodes=1,
                       final_episodes=2, quiet=True)  # fmt: skip
    assert result.env_steps >= 600


def test_mujoco_environments_of_gymnasium_are_restored():
    pytest.importorskip("imageio", reason="Gymnasium's MuJoCo environments need imageio")
    for name in ("InvertedPendulum-v5", "Ant-v5"):
        assert task(name).save_fault is None


@pytest.mark.parametrize("executor", ["serial", "process"])
def test_no_tuner_sees_a_jump_that_the_plant_cannot_make(executor, capfd, forked_workers):
    jumps = []

    def jump(segment):
        jumps.append(np.abs(np.diff(segment.observations[:, 0])).max())
        return np.zeros(segment.length)

    zoac.tune(
        task=task(Rebuilt, max_episode_steps=50, constraints={"jump": jump}), tuner="zoac_plus",
        budget=2000, num_envs=4, episodes=1, final_episodes=1, quiet=True, executor=executor,
    )  # fmt: skip
    assert max(jumps) < 0.31
    told = capfd.readouterr().err
    assert told.count("cannot be saved") == 1
    assert "Tuners cannot try two parameter vectors from one state." in " ".join(told.split())
    note = told[told.index("note: ") : told.index("counts that.")]
    assert max(map(len, note.splitlines())) <= 80


class Rig(Cart):
    def __init__(self, gain=1.0):
        super().__init__()
        self.gain = gain


class RebuiltRig(Rig, EzPickle):
    def __init__(self, gain=1.0):
        EzPickle.__init__(self, gain)
        Rig.__init__(self, gain)


def test_an_environment_object_whose_copy_is_another_is_refused():
    env, sick = Rig(), RebuiltRig()
    env.gain = sick.gain = 0.01
    assert task(env).make_env(1)._envs[0].gain == 0.01
    with pytest.raises(ConfigError, match=r"in a copy 'gain' is 1.0, not 0.01; give a function"):
        task(sick).make_env(1)
    with pytest.raises(ConfigError, match="copying raised TypeError: bolted .*; give a function"):
        task(Bolted()).make_env(1)


class SelfTruncating(Cart):
    def reset(self, **options):
        self.steps = 0
        return super().reset(**options)

    def step(self, action):
        self.steps += 1
        observation, reward, *_ = super().step(action)
        return observation, reward, False, self.steps >= 30, {}


FEW = {"num_envs": 2, "budget": 300, "episodes": 1, "final_episodes": 2}


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "bo"])
def test_episodes_that_the_environment_truncates_by_itself_are_measured(tuner, capsys):
    result = zoac.tune(task=task(SelfTruncating), tuner=tuner, **FEW)
    assert set(result.record["episode_lengths"]) == {30}
    told = capsys.readouterr().out
    assert "  episodes: truncated by the environment itself after 30 steps\n" in told
    assert tuner != "bo" or "evaluations: 10" in told


def test_a_time_limit_is_taken_from_who_gives_it():
    assert horizon_of(task(Cart, max_episode_steps=7)) == (7, "limit")
    assert horizon_of(task(lambda: TimeLimit(Cart(), 9))) == (9, "limit")
    assert horizon_of(task("Pendulum-v1")) == (200, "limit")
    assert horizon_of(CountingTask(5)) == (5, "limit")
    assert horizon_of(task(SelfTruncating)) == (30, "truncation")


def test_the_length_of_episodes_that_terminate_is_measured_with_the_start_values():
    class Tank(Cart):
        def step(self, action):
            self.level = getattr(self, "level", 0.0) + abs(float(action[0]))
            return np.zeros(2), -1.0, self.level > 1.0, False, {}

        def reset(self, **options):
            self.level = 0.0
            return super().reset(**options)

    act = {"controller": lambda p, o: p["k"], "space": {"k": (0, 2)}}
    assert horizon_of(task(Tank, **act)) == (2, "termination")
    slow = task(Tank, **act, baseline={"k": 0.125})
    assert horizon_of(slow) == (9, "termination")
    assert "9 steps in the longest of 3" in horizon_of(slow).remark


def test_an_environment_that_never_ends_is_refused_before_the_run(monkeypatch):
    monkeypatch.setattr(gymnasium_adapter, "MAX_EPISODE_STEPS", 1000)
    monkeypatch.setattr(Trainer, "run", lambda self: pytest.fail("the run began"))
    with pytest.raises(ConfigError, match="not ended after 1,000 steps.*give max_episode_steps"):
        zoac.tune(task=task(Cart), tuner="random", quiet=True, **FEW)


@pytest.mark.parametrize("wrapper", [NormalizeReward, NormalizeObservation])
def test_running_statistics_in_the_environment_are_warned_of(wrapper, capsys):
    def make(running=True):
        env = wrapper(Cart())
        env.update_running_mean = running
        return TimeLimit(env, 20)

    zoac.tune(task=task(make), tuner="random", quiet=True, **FEW)
    told = capsys.readouterr().err
    assert told.count(wrapper.__name__) == 1
    assert "remove the wrapper, or set its update_running_mean to False" in told
    zoac.tune(task=task(lambda: make(running=False)), tuner="random", quiet=True, **FEW)
    assert capsys.readouterr().err == ""


def test_environments_do_not_notice_the_trial():
    tried, fresh = CountingTask(), CountingTask()
    group, twin = engine(tried, [0, 1]), engine(fresh, [0, 1])
    plan = [proposal(env_index, horizon=3) for env_index in (0, 1)]
    before = group.rollout(plan)
    assert tried.save_fault is None
    for one, two in zip(
        before + group.rollout(plan), twin.rollout(plan) + twin.rollout(plan), strict=True
    ):
        assert same_segment(one, two)
