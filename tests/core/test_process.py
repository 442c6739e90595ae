import os
import signal
import time

import pytest

from tests.support import (
    CountingTask,
    EchoController,
    RaisingTask,
    lane_group,
    proposal,
    same_segment,
)
from zoac.errors import ControllerError
from zoac.process import Process, WorkerError


@pytest.fixture
def processes():
    executor = Process(workers=2)
    yield executor
    executor.close()


def test_a_killed_worker_is_replaced_and_its_work_redone(processes):
    processes.start(CountingTask(), 3, seed=0)
    serial = lane_group(CountingTask(), [0, 1, 2])
    plan = [proposal(lane, horizon=4) for lane in (0, 1, 2)] * 3
    for victim in (None, 0, 1, 0):
        if victim is not None:
            os.kill(processes._workers[victim]._process.pid, signal.SIGKILL)
        expected = serial.rollout(plan)
        for one, two in zip(processes.rollout(plan), expected, strict=True):
            assert same_segment(one, two)


class _Suicidal(EchoController):
    def act(self, params, obs, memory):
        os.kill(os.getpid(), signal.SIGKILL)


class SuicidalTask(CountingTask):
    def make_controller(self):
        return _Suicidal()


class _Waiting(EchoController):
    def act(self, params, obs, memory):
        time.sleep(WaitingTask.seconds)
        return super().act(params, obs, memory)


class WaitingTask(CountingTask):
    seconds = 0.5

    def make_controller(self):
        return _Waiting()


def test_work_that_kills_every_worker_ends_with_a_message(processes):
    processes.start(SuicidalTask(), 2, seed=0)
    with pytest.raises(WorkerError, match="died 3 times on the same work .*signal 9"):
        processes.rollout([proposal(0)])


def test_an_error_in_a_worker_arrives_with_its_place(processes):
    processes.start(RaisingTask(), 2, seed=0)
    with pytest.raises(ControllerError, match="ZeroDivisionError: in the controller"):
        processes.rollout([proposal(0)])


def test_workers_end_when_the_executor_is_closed(processes):
    processes.start(CountingTask(), 2, seed=0)
    handles = list(processes._workers)
    processes.close()
    assert all(h._process.poll() is not None for h in handles)


@pytest.mark.parametrize("method", ["rollout", "evaluate"])
def test_this_process_has_time_while_workers_run(processes, method):
    processes.start(WaitingTask(), 2, seed=0)
    begun = time.monotonic()
    moments = []
    getattr(processes, method)(
        [proposal(0, seed=1, horizon=1)], lambda: moments.append(time.monotonic() - begun)
    )
    assert len(moments) == 1
    assert moments[0] < WaitingTask.seconds <= time.monotonic() - begun
