"""Readers of the output that leave before its end."""

import io
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def no_reader():
    """A pipe that nobody reads from."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


# Hydra prints for one of them, and may be the one that finds the pipe broken: it goes both ways.
@pytest.mark.parametrize(
    ("command", "buffered"),
    [
        ("zoac.run.command task=pid_acc --cfg job", True),
        ("zoac.run.command task=pid_acc --cfg job", False),
        ("zoac.check.__main__ --help", False),
        ("zoac.search.__main__ --help", True),
        (f"zoac.analysis.beyond {ROOT}/results/careful --out out", False),
    ],
)
def test_a_reader_that_has_had_enough_gets_no_traceback(
    command, buffered, no_reader, monkeypatch, tmp_path
):
    module, *arguments = command.split()
    main = import_module(module).main
    monkeypatch.chdir(tmp_path)
    with os.fdopen(no_reader, "wb", 0 if not buffered else -1) as pipe:
        monkeypatch.setattr(sys, "argv", ["zoac", *arguments])
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(pipe, write_through=not buffered))
        with pytest.raises(SystemExit) as end:
            main()
    assert end.value.code == 1


def test_a_process_ends_so_too(no_reader, tmp_path):
    # With little output the pipe is found broken only when the buffer is written.
    done = subprocess.run(
        [sys.executable, "-m", "zoac.run", "--help"],
        stdout=no_reader, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONUNBUFFERED": ""},
    )  # fmt: skip
    os.close(no_reader)
    assert (done.returncode, done.stderr) == (1, "")
