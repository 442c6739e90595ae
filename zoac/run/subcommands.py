"""The command `zoac`: one word for each command line of the project.

zoac run task=pid_acc tuner=zoac seed=0      as python -m zoac.run ...
zoac report runs                             as python -m zoac.analysis.report ...
"""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import zoac
from zoac.core.errors import suggest
from zoac.run.pipes import reader_may_leave

COMMANDS = {
    "run": ("zoac.run.command", "tune, one run or a sweep"),
    "check": (
        "zoac.check.__main__",
        "try a task before tuning: how long episodes are, what can fail",
    ),
    "search": ("zoac.search.__main__", "search a tuner's own options"),
    "pid": ("zoac.pid.__main__", "tune a PID for the plant of a file"),
    "study": ("zoac.study.__main__", "experiments that a script, a rig or a person runs"),
    "report": ("zoac.analysis.report", "one HTML page about a run or a sweep"),
    "table2": ("zoac.analysis.table2", "a table of methods, Table II of the paper"),
    "curves": ("zoac.analysis.curves", "learning curves"),
    "landscape": ("zoac.analysis.landscape", "parameters and the cost along each"),
    "trajectories": ("zoac.analysis.trajectories", "closed loops, drawn or filmed"),
    "robustness": ("zoac.analysis.robustness", "the tuned controller on other plants"),
    "suite": ("zoac.analysis.suite", "which tuner, over many problems"),
    "beyond": ("zoac.analysis.beyond", "tuners at several budgets"),
    "compact": ("zoac.analysis.compact", "many run folders in three small files"),
}
"""Command -> module with `main`, and what it does."""

OF_RUNS = ("run", "check", "search")
"""Commands that take overrides of the configuration."""

COMPLETION = """\
# In ~/.bashrc:  eval "$(zoac --completion)"     In ~/.zshrc: the same, after
# autoload -U +X bashcompinit && bashcompinit
complete -o default -o nospace -C 'zoac --complete' zoac
"""


@reader_may_leave()
def main() -> None:
    """Run a command; exits with 1 and one message if there is no such command."""
    given = sys.argv[1:]
    if not given or given[0] in ("--help", "-h", "help"):
        print(usage())
    elif given[0] in ("--version", "-V"):
        print(f"zoac {zoac.__version__}")
    elif given[0] == "--completion":
        print(COMPLETION, end="")
    elif given[0] == "--complete":
        print("\n".join(completions(os.environ.get("COMP_LINE", ""))))
    elif given[0] in COMMANDS:
        sys.argv = [f"{sys.argv[0]} {given[0]}", *given[1:]]
        sys.path.insert(0, os.getcwd())  # as `python -m` does: a user's own modules
        command: Any = import_module(COMMANDS[given[0]][0])
        sys.exit(command.main())
    elif "=" in given[0] or given[0] == "-m":
        sys.exit(f"error: expected a command first: zoac run {' '.join(given)}")
    else:
        sys.exit(f"error: unknown command {given[0]!r}; {suggest(given[0], COMMANDS)}")


def usage() -> str:
    """Return the list of commands."""
    commands = "\n".join(f"  {name:13} {what}" for name, (_, what) in COMMANDS.items())
    return (
        f"zoac: tune controllers from their closed-loop performance\n\n{commands}\n\n"
        "zoac <command> --help says more; zoac --version; zoac --completion for bash and zsh."
    )


def completions(line: str) -> Sequence[str]:
    """Return how the last word of a command line may go on.

    The shell splits words at "=", so that what comes after one is completed alone.
    """
    *before, begun = line.split(" ")
    if len(before) <= 1:
        return [f"{name} " for name in COMMANDS if name.startswith(begun)]
    if before[1] not in OF_RUNS:
        return []
    from zoac.config.files import choices

    group, equals, value = begun.partition("=")
    if equals:
        return [f"{name} " for name in choices(group) if name.startswith(value)]
    known = ("task=", "tuner=", "seed=", "budget=", "executor=", "mpc_solver=", "experiment=")
    return [key for key in known if key.startswith(begun)]
