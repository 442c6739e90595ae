"""What all tests share."""

import gc
import os
import signal
import tempfile

import pytest
import yaml
from hypothesis import settings

# A busy machine is no reason to fail, nor is the first call of what is compiled.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
# Where tests run in a shell's background, SIGINT is ignored, and so would be by what they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# The libraries are a million objects, and a thousand small runs would count them again and again.
gc.set_threshold(200_000, 20, 100)
# The same parser in C: configurations are composed thousands of times.
yaml.SafeLoader = yaml.CSafeLoader
# Tests run side by side.
os.environ.setdefault("ZOAC_CORES", "1")


@pytest.fixture(autouse=True, scope="session")
def temporary_folders_end_with_the_tests(tmp_path_factory):
    """`zoac.tune` without a folder makes one of its own, which is the user's to keep."""
    tempfile.tempdir = str(tmp_path_factory.mktemp("tempdir"))


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
