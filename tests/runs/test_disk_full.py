from pathlib import Path

import pytest

from stress.disk_full import small_disk, stopped_by_a_full_disk
from tests.algorithm.support import grouped
from tests.algorithm.test_zoac import OPTIONS
from tests.support import CountingTask
from zoac.algorithm.zoac import Zoac
from zoac.config.settings import Evaluation, Settings
from zoac.core.tuner import Problem
from zoac.rollout.executors.base import Serial
from zoac.runs.log import RunLog
from zoac.runs.schema import read_metrics
from zoac.runs.training.trainer import Trainer

RUN = {"format": 1, "task": "t", "tuner": "x", "seed": 0, "variant": None, "config_hash": "0"}


def train_in(folder, make_log):
    """Train in a folder, with a checkpoint after every iteration; return the folder."""
    settings = Settings(budget=200, num_envs=3, eval_every=50,
                        evaluation=Evaluation(2, 3), checkpoint_seconds=0.0)  # fmt: skip
    task = CountingTask(max_episode_steps=7)
    executor = Serial()
    executor.start(task, settings.num_envs, settings.seed)
    folder.mkdir(exist_ok=True)
    log = make_log(folder, RUN)
    tuner = Zoac(
        Problem(task.space, 3, settings.num_envs, settings.budget, 7, 0), **grouped(**OPTIONS)
    )
    try:
        Trainer(task, tuner, executor, settings, log).run()
    finally:
        executor.close()
        log.close()
    return folder


def numbers(folder: Path):
    """Every row without what depends on the clock."""
    return [{k: v for k, v in row.items() if not k.endswith("_seconds")}
            for row in read_metrics(folder)]  # fmt: skip


@pytest.fixture
def disk():
    try:
        with small_disk() as folder:
            yield folder
    except OSError as error:
        pytest.skip(f"no small file system can be mounted here: {error}")


@pytest.mark.parametrize("moment", ["row", "checkpoint", "result"])
def test_a_full_disk_stops_with_a_message_and_the_run_continues_bit_for_bit(disk, tmp_path, moment):
    message = stopped_by_a_full_disk(disk, moment, lambda make: train_in(disk / "run", make))
    assert "cannot write" in message
    assert "No space left on device" in message
    resumed = numbers(train_in(disk / "run", RunLog))
    assert resumed == numbers(train_in(tmp_path / "whole", RunLog))
