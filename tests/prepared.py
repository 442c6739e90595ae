"""A Python process that has imported the libraries and forks a process for each command.

It reads an order from each line of its standard input: what follows `python` on the command line,
the folder, the environment, a folder for the output, and whether to lead a session. It answers with
the new process's number; the files `stdout`, `stderr` and, at the end, `code` appear in the folder
for the output. None of zoac is imported here. A command ends as Python ends, by the end of this
module, but for the last step: nothing is taken apart.
"""

import atexit
import gc
import importlib
import json
import os
import random
import runpy
import select
import sys
import tempfile
import types
from contextlib import suppress
from pathlib import Path

LIBRARIES = (
    "clarabel", "cma", "cvxpy", "gymnasium", "hydra", "matplotlib.pyplot", "nevergrad", "numba",
    "numpy", "pandas", "pydantic", "scipy.stats", "torch",
)  # fmt: skip


def forked() -> dict:
    """Fork for each order; return the order in each process that is to carry it out."""
    running: dict[int, str] = {}
    while True:
        ready, *_ = select.select([sys.stdin], [], [], 0.01 if running else None)
        while running and (ended := os.waitpid(-1, os.WNOHANG))[0]:
            told = Path(running.pop(ended[0]), "code")
            told.with_suffix(".part").write_text(str(os.waitstatus_to_exitcode(ended[1])))
            told.with_suffix(".part").rename(told)
        if not ready:
            continue
        order = json.loads(sys.stdin.readline() or "null")
        if order is None:
            os._exit(0)
        if not (command := os.fork()):
            return order
        running[command] = order["output"]
        os.write(1, b"%d\n" % command)


def become(order: dict) -> list[str]:
    """Make this process the one ordered; return what follows `python` on its command line."""
    write = os.O_CREAT | os.O_WRONLY | os.O_APPEND
    for number, path in enumerate((os.devnull, *(f"{order['output']}/{n}" for n in OUTPUTS))):
        file = os.open(path, write if number else os.O_RDONLY)
        os.dup2(file, number)
        os.close(file)
    if order["session"]:
        os.setsid()
    gc.enable()
    os.environ.clear()
    os.environ.update(order["environment"])
    os.chdir(order["cwd"])
    tempfile.tempdir = None
    random.seed()
    sys.modules["numpy"].random.seed()
    sys.orig_argv = [sys.executable, *order["arguments"]]
    more = order["environment"].get("PYTHONPATH", "").split(os.pathsep)
    sys.path[:0] = [order["cwd"], *filter(None, more)]
    return order["arguments"]


def carry_out(kind: str, named: str) -> None:
    """Run what `python -m` or `python -c` would run."""
    if kind == "-m":
        runpy.run_module(named, run_name="__main__", alter_sys=True)
    else:
        sys.argv[0] = "-c"
        main = sys.modules["__main__"] = types.ModuleType("__main__")
        exec(compile(named, "<string>", "exec"), vars(main))


def end(status: list[int]) -> None:
    """End this process if its exit status is known; Python needs a third of a second for that."""
    if status:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status[0])


OUTPUTS = ("stdout", "stderr")
if __name__ == "__main__":
    del sys.path[0]  # this folder, which has a `packaging` too
    status: list[int] = []
    atexit.register(end, status)  # the first one registered is the last one called
    for library in LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(library)
    gc.disable()
    gc.collect()
    gc.freeze()  # otherwise each process copies all of it only to end
    kind, named, *sys.argv[1:] = become(forked())
    try:
        carry_out(kind, named)
        status.append(0)
    except SystemExit as error:
        status.append(error.code if isinstance(error.code, int) else int(error.code is not None))
        raise
    except Exception:
        status.append(1)
        raise
