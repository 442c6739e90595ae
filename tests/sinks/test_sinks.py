import pytest

from zoac.sinks.numbers import numbers

RUN = {"task": "t", "tuner": "z", "seed": 0, "variant": None, "config": {"a": {"b": 1}}}
ROW = {"kind": "eval", "env_steps": 10, "cost_mean": 2.0, "final": False, "z": [1.0],
       "parameters": {"k": 3.0}}  # fmt: skip


def test_numbers_are_flat_and_nothing_else():
    assert numbers(ROW) == {"env_steps": 10, "cost_mean": 2.0, "parameters/k": 3.0}


def test_wandb_offline_needs_no_network_or_account(tmp_path, monkeypatch):
    from zoac.sinks.wandb import Wandb

    monkeypatch.delenv("WANDB_MODE", raising=False)
    sink = Wandb(folder=str(tmp_path))
    sink.start(RUN)
    sink.row(ROW)
    sink.finish({"cost_mean": 2.0})
    assert list(tmp_path.glob("wandb/offline-run-*/*.wandb"))


def test_tensorboard_holds_the_rows(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from zoac.sinks.tensorboard import TensorBoard

    sink = TensorBoard(folder=str(tmp_path))
    sink.start(RUN)
    sink.row(ROW)
    sink.finish({})
    events = EventAccumulator(str(tmp_path / "t" / "z" / "0"))
    events.Reload()
    (point,) = events.Scalars("eval/cost_mean")
    assert (point.step, point.value) == (10, 2.0)
