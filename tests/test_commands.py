"""A command in a forked process is as one that a shell has started."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import commands

ROOT = Path(__file__).parents[1]
SELF = """
import atexit, json, os, signal, sys
print(__name__, sys.argv, sys.orig_argv, sys.path, os.getcwd(), sys.stdin.read())
print(sorted(os.environ.items()), signal.getsignal(signal.SIGINT), file=sys.stderr)
print([name for name in sys.modules if name.startswith("zoac")])
atexit.register(print, "the end")
"""


@pytest.mark.parametrize(
    "end",
    ["", "sys.exit(3)", "sys.exit('a message')", "os.kill(os.getpid(), 9)"],
)
@pytest.mark.parametrize("how", ["-c", "-m"])
def test_it_sees_and_leaves_what_any_process_does(how, end, tmp_path):
    env = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), "LC_CTYPE": "C.UTF-8"}
    (tmp_path / "module.py").write_text(SELF + end)
    words = [how, SELF + end if how == "-c" else "module", "one", "-two"]
    plain = subprocess.run([sys.executable, *words], cwd=tmp_path, env=env, capture_output=True,
                           text=True, stdin=subprocess.DEVNULL)  # fmt: skip
    found = commands.run(*words, cwd=tmp_path, env=env)
    assert found.returncode == plain.returncode
    own = "" if how == "-m" else f"'{tmp_path}', "  # Python writes an empty word for the folder
    assert found.stdout.replace(f"[{own}", "['', " if own else "[") == plain.stdout
    assert found.stderr == plain.stderr


def test_an_error_and_a_signal_end_it_with_their_codes(tmp_path):
    assert commands.run("-c", "1 / 0", cwd=tmp_path).returncode == 1
    code = "import time; open('ready', 'w'); time.sleep(60)"
    started = commands.Started("-c", code, cwd=tmp_path)
    while not (tmp_path / "ready").exists():
        time.sleep(0.01)
    started.send_signal(signal.SIGINT)
    assert "KeyboardInterrupt" in started.communicate()[1]
    assert started.returncode == -signal.SIGINT


def test_each_begins_with_random_numbers_of_its_own(tmp_path):
    code = "import random, numpy; print(random.random(), numpy.random.random())"
    one, other = (commands.run("-c", code, cwd=tmp_path).stdout.split() for _ in "ab")
    assert one[0] != other[0]
    assert one[1] != other[1]
