"""Environments in Ray actors."""

import threading

import pytest

from tests import support
from zoac.core.errors import ConfigError, ControllerError, WorkerError

pytest.importorskip("ray", reason="executor=ray is not installed: pip install 'zoac[ray]'")

import ray

from zoac.rollout.executors.ray import Ray


@pytest.fixture(scope="module", autouse=True)
def cluster():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="warning")
    yield
    ray.shutdown()


@pytest.fixture
def actors():
    executor = Ray(workers=2)
    yield executor
    executor.close()


def test_an_actor_killed_at_its_work_is_restarted_and_its_work_redone(actors):
    actors.start(support.SlowTask(), 3, seed=0)
    serial = support.engine(support.CountingTask(), [0, 1, 2])
    plan = [support.proposal(env_index, horizon=4) for env_index in (0, 1, 2)] * 3
    for victim in (0, None, 0, 1):  # the first dies before its first reply
        if victim is not None:
            doomed = actors._workers[victim]._actor
            timer = threading.Timer(0.3, ray.kill, [doomed], {"no_restart": False})
            timer.start()
        found = actors.rollout(plan)
        for one, two in zip(found, serial.rollout(plan), strict=True):
            assert support.same_segment(one, two)
        if victim is not None:
            timer.join()
    # The processes that replied: each actor has one more behind it than in front.
    assert [len(worker._seconds) for worker in actors._workers] == [2, 2]


def test_a_restored_state_survives_the_actor(actors):
    actors.start(support.CountingTask(), 3, seed=0)
    serial = support.engine(support.CountingTask(), [0, 1, 2])
    plan = [support.proposal(env_index, horizon=4) for env_index in (0, 1, 2)]
    serial.rollout(plan)
    actors.restore(serial.state())
    for worker in actors._workers:
        ray.kill(worker._actor, no_restart=False)
    for one, two in zip(actors.rollout(plan), serial.rollout(plan), strict=True):
        assert support.same_segment(one, two)


def test_work_that_kills_every_actor_ends_with_a_message(actors):
    actors.start(support.SuicidalTask(), 2, seed=0)
    with pytest.raises(WorkerError, match="environments 0 to 0 died 3 times on the same work"):
        actors.rollout([support.proposal(0)])


def test_an_error_in_an_actor_arrives_with_its_place(actors):
    actors.start(support.RaisingTask(), 2, seed=0)
    with pytest.raises(ControllerError, match="ZeroDivisionError: in the controller"):
        actors.rollout([support.proposal(0)])


def test_more_actors_than_cores_are_refused(actors):
    greedy = Ray(workers=3)
    with pytest.raises(ConfigError, match="need 3 cores; the Ray cluster has 2"):
        greedy.start(support.CountingTask(), 3, seed=0)
