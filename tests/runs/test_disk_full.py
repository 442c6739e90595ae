import pytest

from stress.disk_full import small_disk, stopped_by_a_full_disk
from tests.runs.training import test_trainer
from zoac.runs.log import RunLog

whole = test_trainer.whole


def train_in(folder, make_log):
    """Train in a folder, with a checkpoint after every iteration; return the folder."""
    test_trainer.train(folder, make_log=make_log, checkpoint_seconds=0.0)
    return folder


@pytest.fixture
def disk():
    try:
        with small_disk() as folder:
            yield folder
    except OSError as error:
        pytest.skip(f"no small file system can be mounted here: {error}")


@pytest.mark.parametrize("moment", ["row", "checkpoint", "result"])
def test_a_full_disk_stops_with_a_message_and_the_run_continues_bit_for_bit(disk, whole, moment):
    message = stopped_by_a_full_disk(disk, moment, lambda make: train_in(disk / "run", make))
    assert "cannot write" in message
    assert "No space left on device" in message
    assert test_trainer.same_rows(train_in(disk / "run", RunLog), whole.folder)
