import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import commands, support
from zoac.core.errors import ControllerError, UnsavableError, WorkerError
from zoac.rollout.executors.base import Serial
from zoac.rollout.executors.process import Process


@pytest.fixture
def processes(forked_workers):
    executor = Process(workers=2)
    yield executor
    executor.close()


def test_a_killed_worker_is_replaced_and_its_work_redone(processes):
    processes.start(support.CountingTask(), 3, seed=0)
    serial = support.engine(support.CountingTask(), [0, 1, 2])
    plan = [support.proposal(env_index, horizon=4) for env_index in (0, 1, 2)] * 3
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


@pytest.mark.parametrize("at_start", [False, True])
def test_a_plant_that_raises_a_system_error_is_no_dead_worker(processes, at_start):
    with pytest.raises(ConnectionError, match="the bench does not answer"):
        processes.start(support.BrokenPlantTask("system", at_start), 2, seed=0)
        processes.rollout([support.proposal(0)])


def test_an_error_that_cannot_be_pickled_arrives_with_its_class_and_line(processes):
    processes.start(support.BrokenPlantTask("two-faced"), 2, seed=0)
    with pytest.raises(RuntimeError, match="TwoFacedError: sparks at the bench") as raised:
        processes.rollout([support.proposal(0)])
    assert "raise self._error" in "".join(raised.value.__notes__)


def test_environments_that_cannot_be_saved_run_in_workers_as_in_this_process(processes):
    processes.start(support.LockedTask(), 2, seed=0)
    serial = support.engine(support.LockedTask(), [0, 1])
    plan = [support.proposal(env_index, horizon=4) for env_index in (0, 1)] * 2
    for one, two in zip(processes.rollout(plan), serial.rollout(plan), strict=True):
        assert support.same_segment(one, two)


def test_asking_for_environments_that_cannot_be_saved_says_so_and_leaves_the_worker(processes):
    processes.start(support.LockedTask(), 2, seed=0)
    before = [w._process.pid for w in processes._workers]
    with pytest.raises(UnsavableError, match="TypeError: cannot pickle"):
        processes.state()
    processes.rollout([support.proposal(0, horizon=4)])
    assert [w._process.pid for w in processes._workers] == before


def test_a_worker_whose_environments_cannot_be_restored_is_not_replaced_in_silence(processes):
    processes.start(support.LockedTask(), 2, seed=0)
    processes.rollout([support.proposal(0, horizon=4)])
    os.kill(processes._workers[0]._process.pid, signal.SIGKILL)
    with pytest.raises(WorkerError, match="cannot be restored.* last checkpoint, with new"):
        processes.rollout([support.proposal(0, horizon=4)])


def test_a_serial_executor_that_did_not_start_can_be_closed():
    executor = Serial()
    with pytest.raises(ConnectionError):
        executor.start(support.BrokenPlantTask("system", at_start=True), 2, seed=0)
    executor.close()


def test_workers_end_when_the_executor_is_closed(processes):
    processes.start(support.CountingTask(), 2, seed=0)
    handles = list(processes._workers)
    processes.close()
    assert all(h._process.poll() is not None for h in handles)


@pytest.mark.parametrize("method", ["rollout", "evaluate"])
def test_this_process_has_time_while_workers_run(processes, method, tmp_path):
    # The workers wait for what is done meanwhile: else this raises.
    processes.start(support.WaitingTask(tmp_path / "sign"), 2, seed=0)
    getattr(processes, method)([support.proposal(0, seed=1)], (tmp_path / "sign").touch)


needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="counts by /proc")


@needs_proc
def test_where_one_worker_cannot_start_none_is_left(tmp_path, monkeypatch):
    monkeypatch.setenv("MARK", str(tmp_path))
    with pytest.raises(ConnectionError, match="second bench"):
        Process(workers=2).start(support.SmallGroupTask(), 3, seed=0)
    assert support.end_within(5.0, str(tmp_path))


PARENT = """
import sys
from pathlib import Path
from tests import support
from zoac.rollout.executors.process import Process

idle, holding = Process(workers=1), Process(workers=1)
idle.start(support.CountingTask(), 1, seed=0)
holding.start(support.StuckTask(Path(sys.argv[1]), holds_interpreter=True), 1, seed=0)
holding.rollout([support.proposal(0)])
"""


@needs_proc
def test_workers_end_with_their_parent_whatever_they_are_at(tmp_path):
    mark = {**os.environ, "MARK": str(tmp_path)}
    root = Path(__file__).parents[3]
    parent = commands.Started("-c", PARENT, tmp_path / "sign", cwd=root, env=mark)
    while not (tmp_path / "sign").exists():
        assert parent.poll() is None
        time.sleep(0.01)
    assert len(support.marked(str(tmp_path))) >= 4  # two workers, each with a watcher
    parent.send_signal(signal.SIGKILL)
    assert support.end_within(3.0, str(tmp_path))


SCRIPT = """
import multiprocessing
import zoac
from tests.envs.test_adapters import Drift

class Own(Drift):
    pass

def act(params, obs):
    return -params["k"] * obs[0]

def tuned(seed):
    result = zoac.tune(env=Own, controller=act, space={"k": (0.0, 1.0)}, tuner="random", budget=10,
                       num_envs=2, episodes=1, final_episodes=1, max_episode_steps=5, quiet=True,
                       executor="process", seed=seed)
    return result.cost_mean
"""

USES = {
    "at the top of the script": "print([tuned(0)])",
    "in processes that are spawned": """
if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(pool.map(tuned, [0]))
""",
}


def test_a_users_script_may_use_workers_anywhere(tmp_path):
    told = {}
    for name, use in USES.items():
        (tmp_path / "script.py").write_text(SCRIPT + use)
        done = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}, timeout=300,
        )  # fmt: skip
        told[name] = done.stdout or done.stderr
    assert len(set(told.values())) == 1, told
    assert told["at the top of the script"].startswith("[")
