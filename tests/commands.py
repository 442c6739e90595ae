"""Commands in processes of their own, forked from one that has imported the libraries.

A command that learns with PyTorch imports for three seconds and works for less than one; without
PyTorch the imports are still half of it. Here it imports zoac alone; all else is as in a process
that a shell has started.
"""

import atexit
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests import prepared


class Started:
    """A process like `subprocess.Popen`'s whose output goes to files.

    `session`: whether it leads a session of its own, as what a terminal starts.
    """

    def __init__(self, *arguments, cwd, env=None, session=False):
        server, folder = _server()
        self.args, self.returncode = [sys.executable, *map(str, arguments)], None
        self._output = Path(tempfile.mkdtemp(dir=folder))
        for name in prepared.OUTPUTS:
            (self._output / name).touch()
        order = {"arguments": self.args[1:], "cwd": str(cwd), "output": str(self._output),
                 "environment": dict(os.environ if env is None else env),
                 "session": session}  # fmt: skip
        server.stdin.write(json.dumps(order) + "\n")
        server.stdin.flush()
        self.pid = int(server.stdout.readline())

    def poll(self):
        code = self._output / "code"
        if self.returncode is None and code.exists():
            self.returncode = int(code.read_text())
        return self.returncode

    def communicate(self, timeout=300.0):
        """Wait for its end; return what it wrote to standard output and to standard error."""
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                self.send_signal(signal.SIGKILL)
                raise subprocess.TimeoutExpired(self.args, timeout, *self.written())
            time.sleep(0.01)
        return self.written()

    def send_signal(self, number):
        os.kill(self.pid, number)

    def written(self):
        """Return what it wrote so far to standard output and to standard error."""
        return tuple((self._output / name).read_text() for name in prepared.OUTPUTS)


def run(*arguments, cwd, env=None, check=False):
    """Run `python` with arguments that begin with -m or -c, as `subprocess.run` would."""
    started = Started(*arguments, cwd=cwd, env=env)
    out, err = started.communicate()
    done = subprocess.CompletedProcess(started.args, started.returncode, out, err)
    if check:
        done.check_returncode()
    return done


@functools.cache
def _server():
    """Start the process to fork from; return it with the folder in which commands write."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    server = subprocess.Popen([sys.executable, prepared.__file__], text=True, env=environment,
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # fmt: skip
    folder = tempfile.mkdtemp(dir=os.environ.get("TMPDIR", "/tmp"))

    def end():
        server.communicate()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(end)
    return server, folder
