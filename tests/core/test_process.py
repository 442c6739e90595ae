import os
import signal
import time

import pytest

from tests import support
from zoac.errors import ControllerError
from zoac.process import Process, WorkerError


@pytest.fixture
def processes():
    executor = Process(workers=2)
    yield executor
    executor.close()


def test_a_killed_worker_is_replaced_and_its_work_redone(processes):
    processes.start(support.CountingTask(), 3, seed=0)
    serial = support.lane_group(support.CountingTask(), [0, 1, 2])
    plan = [support.proposal(lane, horizon=4) for lane in (0, 1, 2)] * 3
    for victim in (None, 0, 1, 0):
        if victim is not None:
            os.kill(processes._workers[victim]._process.pid, signal.SIGKILL)
        expected = serial.rollout(plan)
        for one, two in zip(processes.rollout(plan), expected, strict=True):
            assert support.same_segment(one, two)


def test_work_that_kills_every_worker_ends_with_a_message(processes):
    processes.start(support.SuicidalTask(), 2, seed=0)
    with pytest.raises(WorkerError, match="died 3 times on the same work .*signal 9"):
        processes.rollout([support.proposal(0)])


def test_an_error_in_a_worker_arrives_with_its_place(processes):
    processes.start(support.RaisingTask(), 2, seed=0)
    with pytest.raises(ControllerError, match="ZeroDivisionError: in the controller"):
        processes.rollout([support.proposal(0)])


def test_workers_end_when_the_executor_is_closed(processes):
    processes.start(support.CountingTask(), 2, seed=0)
    handles = list(processes._workers)
    processes.close()
    assert all(h._process.poll() is not None for h in handles)


@pytest.mark.parametrize("method", ["rollout", "evaluate"])
def test_this_process_has_time_while_workers_run(processes, method):
    processes.start(support.SlowTask(max_episode_steps=100), 2, seed=0)
    begun = time.monotonic()
    moments = []
    getattr(processes, method)(
        [support.proposal(0, seed=1, horizon=10)], lambda: moments.append(time.monotonic() - begun)
    )
    assert len(moments) == 1
    assert moments[0] < 10 * support.SlowTask.seconds <= time.monotonic() - begun
