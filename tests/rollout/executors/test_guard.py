"""Programs end with the process that started them, and take their children along."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import commands, support
from zoac.rollout.executors import guard

pytestmark = pytest.mark.skipif(not guard.IS_POSSIBLE, reason="needs Linux 5.3")

PROGRAMS = """
import sys, zoac
code = "sleep 600 & touch " + sys.argv[1] + "/sign.$$; sleep 600"
zoac.tune(cost=zoac.program(["sh", "-c", code]), space={"k": (0, 1)}, experiments=2, workers=2,
          tuner="random", quiet=True)
"""
WORKERS = """
import sys
from pathlib import Path
from tests import support
from zoac.rollout.executors import process

process.ATTEMPTS = 1
executor = process.Process(workers=1)
executor.start(support.SimulatorTask(Path(sys.argv[1])), 1, seed=0)
executor.rollout([support.proposal(0)])
"""


def running(code, folder, programs):
    """Return a process that runs the code, once programs below it have said so by a file."""
    mark = {**os.environ, "MARK": str(folder)}
    process = commands.Started("-c", code, folder, cwd=Path(__file__).parents[3], env=mark)
    while len(list(folder.glob("sign.*"))) < programs:
        assert process.poll() is None
        time.sleep(0.01)
    return process


@pytest.mark.parametrize(
    ("code", "programs", "number"),
    [(PROGRAMS, 2, signal.SIGTERM), (PROGRAMS, 2, signal.SIGKILL), (WORKERS, 1, signal.SIGKILL)],
)
def test_programs_and_their_children_end_with_their_parent(code, programs, number, tmp_path):
    parent = running(code, tmp_path, programs)
    # A tree of two and more for each, with a watcher.
    assert len(support.marked(str(tmp_path))) >= 3 * programs
    parent.send_signal(number)
    assert support.end_within(3.0, str(tmp_path))


def test_what_a_worker_started_ends_with_the_worker(tmp_path):
    parent = running(WORKERS, tmp_path, 1)
    for path in tmp_path.glob("sign.*"):
        os.kill(int(path.suffix[1:]), signal.SIGKILL)
    _, errors = parent.communicate()
    assert "died 1 times on the same work (killed by signal 9)" in errors
    assert support.end_within(3.0, str(tmp_path))


def ended(words, **options):
    process = guard.started(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)
    output, errors = process.communicate()
    return process.returncode, output.decode(), errors.decode()


def test_a_program_starts_as_it_would_without(tmp_path):
    assert ended(["sh", "-c", "kill -SEGV $$"])[0] == -signal.SIGSEGV
    assert ended(["sh", "-c", "exit 7"])[0] == 7
    code, _, errors = ended([str(tmp_path)])
    assert code == 1
    assert errors == f"cannot start {str(tmp_path)!r}: Permission denied\n"
    words = ["sh", "-c", "grep SigIgn /proc/self/status; ps -o pid= --ppid $$ | wc -l"]
    plain = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert ended(words)[1] == plain


def test_where_no_process_may_be_watched_the_program_runs_all_the_same():
    code = """
import os
from zoac.rollout.executors import guard
def refuse(process):
    raise PermissionError
os.pidfd_open = refuse
guard.main(os.getppid(), ["echo", "runs"])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "runs\n"


def test_no_watcher_outlives_its_program(tmp_path):
    assert ended(["true"], env={**os.environ, "MARK": str(tmp_path)})[0] == 0
    assert support.end_within(3.0, str(tmp_path))
