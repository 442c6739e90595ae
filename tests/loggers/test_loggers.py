import time

import pytest

from zoac.loggers.flatten import numbers

RUN = {"task": "t", "tuner": "x", "seed": 0, "variant": None, "config": {"a": {"b": 1}}}
ROW = {"kind": "eval", "env_steps": 10, "cost_mean": 2.0, "final": False, "x": [1.0],
       "parameters": {"k": 3.0}}  # fmt: skip


def test_numbers_are_flat_and_nothing_else():
    assert numbers(ROW) == {"env_steps": 10, "cost_mean": 2.0, "parameters/k": 3.0}


def test_wandb_offline_needs_no_network_or_account(tmp_path, monkeypatch):
    from zoac.loggers.wandb import Wandb

    monkeypatch.delenv("WANDB_MODE", raising=False)
    logger = Wandb(folder=str(tmp_path))
    logger.start(RUN)
    logger.row(ROW)
    logger.finish({"cost_mean": 2.0})
    assert list(tmp_path.glob("wandb/offline-run-*/*.wandb"))


def shown(folder, *processes):
    """Return (step, value) of the costs that TensorBoard shows, each process having its rows."""
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from zoac.loggers.tensorboard import TensorBoard

    for rows in processes:
        logger = TensorBoard(folder=str(folder))
        logger.start(RUN)
        for steps, cost in rows:
            logger.row({**ROW, "env_steps": steps, "cost_mean": cost})
        logger.finish({})
        time.sleep(1.1)  # event files are told apart by the second
    events = EventAccumulator(str(folder / "t" / "x" / "0"))
    events.Reload()
    return [(point.step, point.value) for point in events.Scalars("eval/cost_mean")]


def test_tensorboard_holds_the_rows(tmp_path):
    assert shown(tmp_path, [(10, 2.0)]) == [(10, 2.0)]


def test_tensorboard_shows_rows_that_come_again_once(tmp_path):
    stopped, resumed = [(0, 4.0), (10, 3.0), (20, 2.0)], [(10, 3.0), (20, 2.0), (30, 1.0)]
    assert shown(tmp_path, stopped, resumed) == [(0, 4.0), (10, 3.0), (20, 2.0), (30, 1.0)]
    assert shown(tmp_path, [(0, 5.0)]) == [(0, 5.0)]  # resume=overwrite
