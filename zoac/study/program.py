"""An external program as a cost: parameters in, one JSON object back."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from zoac.config.settings import converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, ZoacError
from zoac.core.types import Count, Natural
from zoac.rollout.executors import guard

FILE = "{file}"
"""Stands for the path of a file with the parameters, in the program's arguments."""

MAX_TIMEOUT = 2_000_000
"""Seconds, 23 days: the operating system waits for no more than 2^31 ms."""

Timeout = Annotated[float, Field(gt=0, le=MAX_TIMEOUT)]

LAST_LINES = 5
"""Lines of a failed program's output that the message shows."""


@dataclass(frozen=True)
class ProgramTask:
    """Experiments of an external program, as `python -m zoac.run task=program` makes them.

    Args:
        command: The program and its arguments; see `zoac.program`.
        space: What is tuned, as `zoac.tune` takes it.
        baseline: Values in use today, by name; they are the first experiment.
        constraints: Limits by name.
        experiments: How often the program is run.
        timeout: Seconds after which a run is killed and has failed; None: never.
        retries: How often a run that crashed, hung or gave no answer is repeated.
        cwd: The folder it runs in; None: the current one.
    """

    command: list[str] | str | None = None
    space: dict[str, Any] | None = None
    baseline: dict[str, Any] | None = None
    constraints: dict[str, float] | None = None
    experiments: Count = 60
    timeout: Timeout | None = None
    retries: Natural = 0
    cwd: str | None = None

    def cost(self) -> Program:
        """Return the program; a `ConfigError` if it is not named, or cannot be run."""
        if self.command is None:
            raise ConfigError(
                "task.command: a value is needed, the program and its arguments, such as "
                "task.command=[./simulate,--quick]"
            )
        return program(self.command, timeout=self.timeout, retries=self.retries, cwd=self.cwd)


class ProgramError(ZoacError):
    """An external program crashed, did not end in time or did not answer with a JSON object."""


class Program:
    """A program that is given parameters and answers with a cost; see `program`."""

    def __init__(
        self, command: list[str], timeout: float | None, retries: int, folder: Path
    ) -> None:
        self.command, self.timeout, self.retries, self._cwd = command, timeout, retries, folder
        self._running: set[subprocess.Popen[bytes]] = set()
        self._mutex = threading.Lock()
        self._stopped = False

    def __call__(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Run the program; return its answer. A `ProgramError` if the last attempt failed too."""
        text = json.dumps(dict(parameters))
        for _ in range(self.retries):
            with suppress(ProgramError):
                return self._once(text)
        return self._once(text)

    def stop(self) -> None:
        """Kill what runs, and run nothing more."""
        with self._mutex:
            self._stopped = True
            for process in self._running:
                guard.kill(process)

    def _once(self, text: str) -> dict[str, Any]:
        with self._words(text) as (words, given), self._started(words) as process:
            try:
                output, errors = process.communicate(given, self.timeout)
            except subprocess.TimeoutExpired:
                guard.kill(process)
                late = f"did not end within {self.timeout:g} s"
                raise self._failed(late, *process.communicate()) from None
        if process.returncode:
            raise self._failed(_exit(process.returncode), output, errors)
        if (answer := _object(output)) is None:
            raise self._failed("did not answer with a JSON object", output, errors)
        return answer

    @contextmanager
    def _words(self, text: str) -> Iterator[tuple[list[str], bytes]]:
        """Yield the words of the command, and what is written to its standard input."""
        if not any(FILE in word for word in self.command):
            yield self.command, text.encode()
            return
        with tempfile.TemporaryDirectory(prefix="zoac-") as folder:
            path = Path(folder, "parameters.json")
            path.write_text(text, encoding="utf-8")
            yield [word.replace(FILE, str(path)) for word in self.command], b""

    @contextmanager
    def _started(self, words: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
        """Yield the running program; when this is left, neither it nor a child of it runs."""
        pipe = subprocess.PIPE
        with self._mutex:
            if self._stopped:
                raise ProgramError("stopped")
            try:
                process = guard.started(words, stdin=pipe, stdout=pipe, stderr=pipe, cwd=self._cwd)
            except OSError as error:
                raise ProgramError(f"cannot start {words[0]!r}: {error.strerror}") from None
            self._running.add(process)
        with process:  # which closes its pipes and waits
            try:
                yield process
            finally:
                guard.kill(process)
                with self._mutex:
                    self._running.discard(process)

    def _failed(self, what: str, output: bytes, errors: bytes) -> ProgramError:
        said = (errors.strip() or output.strip()).decode(errors="replace").splitlines()
        tail = "".join(f"\n  {_printable(line)}" for line in said[-LAST_LINES:])
        name = Path(self.command[0]).name
        return ProgramError(f"{name} {what}{': its last lines' if tail else ''}{tail}")


def program(
    command: Sequence[str] | str,
    *,
    timeout: Timeout | None = None,
    retries: Natural = 0,
    cwd: str | Path | None = None,
) -> Program:
    """Return an external program as a cost for `zoac.tune(cost=...)`.

        cost = zoac.program(["./simulate", "--quick"], timeout=30, retries=1)

    The parameters are one JSON object on standard input; where an argument holds `{file}`, they
    are a file whose path replaces it. The program answers with a JSON object on the last line of
    standard output: `cost`, and if wanted `metrics` and `constraints`, numbers by name.

    Args:
        command: The program and its arguments; no shell reads them.
        timeout: Seconds after which the program and all of its children are killed; None: never.
        retries: How often a run that crashed, hung or answered no JSON object is repeated.
        cwd: The folder it runs in; None: the current one.

    Raises:
        ConfigError: If there is no such program, or an argument cannot be used.
    """
    try:
        words = shlex.split(command) if isinstance(command, str) else [str(w) for w in command]
    except (TypeError, ValueError):  # it is no list, or has a quote that is not closed
        words = []
    if not words:
        raise ConfigError(
            f"program: {command!r} is no command; expected one such as ['./simulate', '--quick']"
        )
    given = {"command": words, "timeout": timeout, "retries": retries, "cwd": cwd}
    options = converted(program, given)
    check_arguments(program, options, "program")
    folder = Path(cwd or ".").expanduser()
    if not folder.is_dir():
        raise ConfigError(f"program: there is no folder {str(folder)!r}")
    local = folder / words[0]
    if os.sep in words[0] and local.is_file():
        words[0] = str(local.absolute())
    if shutil.which(words[0]) is None:
        raise ConfigError(
            f"program: {words[0]!r} is not found or may not be executed; expected a program "
            "on the path, or its path, such as './simulate'"
        )
    return Program(words, options["timeout"], options["retries"], folder)


def _object(output: bytes) -> dict[str, Any] | None:
    """Return the JSON object that the output is, or that its last line is; None without one."""
    text = output.decode(errors="replace").strip()
    for candidate in (text, text.rpartition("\n")[2]):
        with suppress(ValueError):
            if isinstance(answer := json.loads(candidate), dict):
                return answer
    return None


def _printable(line: str) -> str:
    """Return the beginning of a line, without what would steer a terminal."""
    return "".join(c if c.isprintable() or c == "\t" else "?" for c in line[:200])


def _exit(code: int) -> str:
    if code >= 0:
        return f"ended with exit status {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
