import itertools
import time

import pytest

from zoac.runs.log import RunLog
from zoac.runs.loggers.base import numbers

RUN = {"task": "t", "tuner": "x", "seed": 0, "variant": None, "config": {"a": {"b": 1}}}
ROW = {"kind": "eval", "env_steps": 10, "cost_mean": 2.0, "final": False, "x": [1.0],
       "parameters": {"k": 3.0}}  # fmt: skip


def test_numbers_are_flat_and_nothing_else():
    assert numbers(ROW) == {"env_steps": 10, "cost_mean": 2.0, "parameters/k": 3.0}


def test_wandb_offline_needs_no_network_or_account(tmp_path, monkeypatch):
    import wandb

    from zoac.runs.loggers.wandb import Wandb

    monkeypatch.delenv("WANDB_MODE", raising=False)
    # Not needed here, and most of the time: a list of the packages, and inputs of a launched run.
    monkeypatch.setenv("WANDB_X_SAVE_REQUIREMENTS", "false")
    monkeypatch.setattr(wandb.Run, "_detect_and_apply_job_inputs", lambda run: None, raising=False)
    logger = Wandb(folder=str(tmp_path))
    logger.start(RUN)
    logger.row(ROW)
    logger.finish({"cost_mean": 2.0})
    assert list(tmp_path.glob("wandb/offline-run-*/*.wandb"))


@pytest.fixture
def a_second_passes(monkeypatch):
    """Between any two looks at the clock: event files are told apart by the second."""
    monkeypatch.setattr(time, "time", itertools.count(1e9).__next__)


def shown(folder, *processes):
    """Return (step, value) of the costs that TensorBoard shows, each process having its rows."""
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from zoac.runs.loggers.tensorboard import TensorBoard

    for rows in processes:
        logger = TensorBoard(folder=str(folder))
        logger.start(RUN)
        for steps, cost in rows:
            logger.row({**ROW, "env_steps": steps, "cost_mean": cost})
        logger.finish({})
    events = EventAccumulator(str(folder / "t" / "x" / "0"))
    events.Reload()
    return [(point.step, point.value) for point in events.Scalars("eval/cost_mean")]


def test_tensorboard_shows_rows_that_come_again_once(tmp_path, a_second_passes):
    stopped, resumed = [(0, 4.0), (10, 3.0), (20, 2.0)], [(10, 3.0), (20, 2.0), (30, 1.0)]
    assert shown(tmp_path, stopped, resumed) == [(0, 4.0), (10, 3.0), (20, 2.0), (30, 1.0)]
    assert shown(tmp_path, [(0, 5.0)]) == [(0, 5.0)]  # resume=overwrite


class Plain:
    """A logger with the three methods that every logger has."""

    def __init__(self):
        self.rows, self.kept = 0, []

    def start(self, run):
        pass

    def row(self, row):
        self.rows += 1

    def finish(self, result):
        pass


class Remembering(Plain):
    def resume(self, rows):
        self.kept = [row["env_steps"] for row in rows]


def test_a_logger_that_wants_them_gets_the_rows_that_a_resumed_run_keeps(tmp_path):
    log = RunLog(tmp_path, {"format": 1})
    log.row("eval", {"env_steps": 0}, {"cost_mean": 1.0})
    size = log.size()
    log.row("eval", {"env_steps": 100}, {"cost_mean": 2.0})
    log.close()
    again = RunLog(tmp_path, {"format": 1}, [kept := Remembering(), plain := Plain()])
    again.rewind(size)
    again.row("eval", {"env_steps": 100}, {"cost_mean": 2.0})
    again.close()
    assert kept.kept == [0]
    assert plain.rows == 1


def test_a_logger_without_rows_is_switched_off_in_words(tmp_path, capsys):
    class Mistyped:
        def start(self, run):
            pass

    log = RunLog(tmp_path, {"format": 1}, [Mistyped()])
    log.row("eval", {"env_steps": 0}, {"cost_mean": 1.0})
    log.close()
    assert "Mistyped failed and is switched off: " in capsys.readouterr().err
