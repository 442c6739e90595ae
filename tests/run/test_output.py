"""Readers of the output that leave before its end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

COMMANDS = {
    "help": ["zoac.run", "--help"],
    "config": ["zoac.run", "task=pid_acc", "--cfg", "job"],
    "check": ["zoac.check", "--help"],
    "search": ["zoac.search", "--help"],
    "analysis": ["zoac.analysis.beyond", "results/careful"],
}


# Hydra prints for one of them, and may be the one that finds the pipe broken: it goes both ways.
@pytest.mark.parametrize(
    ("command", "buffered"),
    [("help", True), ("config", True), ("config", False), ("check", False), ("search", True),
     ("analysis", False)],
)  # fmt: skip
def test_a_reader_that_has_had_enough_gets_no_traceback(command, buffered, tmp_path):
    # With little output the pipe is found broken only when the buffer is written.
    arguments = COMMANDS[command]
    if command == "analysis":
        arguments = [arguments[0], str(ROOT / arguments[1]), "--out", str(tmp_path)]
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        stdout=writing, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONUNBUFFERED": "" if buffered else "1"},
    )  # fmt: skip
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")
