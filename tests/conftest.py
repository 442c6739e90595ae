"""What all tests share."""

import os
import signal
import tempfile

import pytest
from hypothesis import settings

# A busy machine is no reason to fail, nor is the first call of what is compiled.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
# Where tests run in a shell's background, SIGINT is ignored, and so would be by what they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Tests run side by side.
os.environ.setdefault("ZOAC_CORES", "1")


@pytest.fixture(autouse=True)
def temporary_folders_end_with_the_test(tmp_path, monkeypatch):
    """`zoac.tune` without a folder makes one of its own, which is the user's to keep."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def stopping(monkeypatch):
    """Call to have every run stop after so many iterations; None: no more."""
    from zoac.runs.training.trainer import Trainer

    original = Trainer.__init__

    def after(iterations):
        def init(self, *arguments, **options):
            original(self, *arguments, **options)
            calls = iter(range(10_000))
            self._stop_requested = lambda: next(calls) == iterations

        monkeypatch.setattr(Trainer, "__init__", original if iterations is None else init)

    return after


@pytest.fixture
def forked_workers(monkeypatch):
    """Have `executor=process` fork its workers from this process, which takes no time."""
    from tests.support import ForkedWorker
    from zoac.rollout.executors import guard

    monkeypatch.setattr(guard, "started", ForkedWorker)
