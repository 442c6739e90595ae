"""The command `zoac`."""

import os
import subprocess
import sys
from importlib import import_module
from unittest import mock

import pytest

import zoac
from zoac.run.subcommands import COMMANDS, completions, main

CODE = "import sys; from zoac.run.subcommands import main; main()"


def test_every_command_is_a_module_with_a_main():
    assert all(callable(import_module(module).main) for module, _ in COMMANDS.values())


@pytest.fixture
def called(monkeypatch, capsys):
    """Return a function that calls the command in this process, for what it prints."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["zoac", *arguments])
        code = 0
        try:
            with mock.patch.dict(os.environ):
                main()
        except SystemExit as end:
            code = end.code
        out, err = capsys.readouterr()
        return (1, out, err + code) if isinstance(code, str) else (code, out, err)

    return call


def test_the_version_is_zoacs(called):
    assert called("--version") == (0, f"zoac {zoac.__version__}\n", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "unknown command 'rnu'; did you mean 'run'?"),
        (["task=pid_acc", "seed=0"], "expected a command first: zoac run task=pid_acc seed=0"),
        (["run", "task=pidacc"], "did you mean 'pid_acc'"),
        (["table2", "nowhere"], "nowhere"),
    ],
)
def test_what_is_no_command_gets_one_message(arguments, message, called):
    code, out, err = called(*arguments)
    assert (code, out) == (1, "")
    assert message in err
    assert "Traceback" not in err


def test_a_process_ends_with_the_code_and_the_message():
    done = subprocess.run([sys.executable, "-c", CODE, "rnu"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("error: unknown command")


def test_a_run_by_the_command_is_a_run(called, tmp_path):
    options = [
        "task=lqr", "tuner=random", "budget=20", "evaluation.episodes=1",
        "evaluation.final_episodes=1", f"runs_dir={tmp_path}", "seed=0", "-m",
    ]  # fmt: skip
    assert called("run", *options)[0] in (0, None)
    assert len(list(tmp_path.glob("lqr/random/seed=*/*/result.json"))) == 1


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("zoac r", ["run ", "report ", "robustness "]),
        ("zoac run ta", ["task="]),
        ("zoac run task=lq", ["lqr "]),
        ("zoac report ta", []),
    ],
)
def test_completion(line, expected):
    assert completions(line) == expected


def test_the_shell_asks_for_completions(called, monkeypatch):
    monkeypatch.setenv("COMP_LINE", "zoac run ta")
    assert called("--complete") == (0, "task=\n", "")
