"""The command `zoac`."""

import os
import subprocess
import sys
from importlib import import_module

import pytest

import zoac
from zoac.run.subcommands import COMMANDS, completions

CODE = "import sys; from zoac.run.subcommands import main; main()"


def command(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", CODE, *arguments], capture_output=True, text=True, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip


def test_every_command_is_a_module_with_a_main():
    assert all(callable(import_module(module).main) for module, _ in COMMANDS.values())


def test_the_version_is_zoacs():
    assert command("--version").stdout == f"zoac {zoac.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "unknown command 'rnu'; did you mean 'run'?"),
        (["task=pid_acc", "seed=0"], "expected a command first: zoac run task=pid_acc seed=0"),
        (["run", "task=pidacc"], "did you mean 'pid_acc'"),
        (["table2", "nowhere"], "nowhere"),
    ],
)
def test_what_is_no_command_gets_one_message(arguments, message):
    done = command(*arguments)
    assert (done.returncode, done.stdout) == (1, "")
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_run_by_the_command_is_a_run(tmp_path):
    options = ["task=lqr", "tuner=random", "budget=200", f"runs_dir={tmp_path}", "seed=0,1", "-m"]
    done = command("run", *options)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("lqr/random/seed=*/*/result.json"))) == 2


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


def test_the_shell_asks_for_completions():
    assert command("--complete", COMP_LINE="zoac run ta").stdout == "task=\n"
