"""A worker process of `executor=process`, spoken to through pipes.

Requests and replies are cloudpickles, each behind its length. The worker ends when its standard
input does, unless a step of the user's holds the interpreter; `zoac.rollout.executors.guard`
sees to that.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Collection
from queue import SimpleQueue
from typing import IO, Any

import cloudpickle

from zoac.core.errors import WorkerError, ZoacError, as_text
from zoac.core.state import pickled
from zoac.rollout.executors.host import Method, RolloutHost
from zoac.rollout.executors.step_watch import Call, StepClock
from zoac.rollout.task import Task


def write(stream: IO[bytes], body: bytes) -> None:
    """Write one message, behind its length.

    Raises:
        OSError: If nobody listens any more.
    """
    stream.write(len(body).to_bytes(8, "little"))
    stream.write(body)
    stream.flush()


def read(stream: IO[bytes]) -> bytes:
    """Read one message.

    Raises:
        EOFError: If the other side has gone.
    """
    length = stream.read(8)
    body = stream.read(int.from_bytes(length, "little"))
    if len(length) < 8 or len(body) < int.from_bytes(length, "little"):
        raise EOFError
    return body


CANNOT_BE_SAVED = b""
"""What `saved` returns for environments that no pickle takes."""


def saved(env_states: Callable[[], Any]) -> bytes:
    """Return the environments' states that a call returns as bytes, which only a worker reads."""
    try:
        return pickled(env_states())
    except Exception:  # whatever a user's environment or controller raises when it is copied
        return CANNOT_BE_SAVED


class Worker:
    """Answers requests with one host's environments."""

    _host: RolloutHost
    _clock: StepClock | None = None

    def start(self, task: Task, env_indices: Any, seed: int, watched: str | None = None) -> None:
        """Make the environments; the file `watched` tells of their steps, see `StepClock`."""
        watch = None
        if watched is not None:
            assert task.step_timeout is not None
            self._clock = StepClock(watched, task.step_timeout)
            watch = self._clock.call
        self._host = RolloutHost(task, env_indices, seed, watch)

    def run(self, method: Method, proposals: Any, hung: Collection[Call] = ()) -> Any:
        """Return the segments; of rollouts also the state in case this process dies later.

        The calls of environments that are known to hang fail instead.
        """
        if self._clock is not None:
            self._clock.begin(hung)
        segments = self._host.run(method, proposals)
        return segments, saved(self._host.engine.state) if method == "rollout" else None

    def state(self) -> Any:
        """Return the environments' state."""
        return self._host.engine.state()

    def restore(self, env_states: bytes) -> None:
        """Restore the environments from what `saved` returned.

        Raises:
            WorkerError: If they could not be saved.
        """
        if env_states == CANNOT_BE_SAVED:
            raise WorkerError(
                "a worker died, and its environments cannot be restored, because the "
                "environment or controller cannot be saved. Started again in its folder, the run "
                "goes on from its last checkpoint, with new episodes"
            )
        self._host.engine.restore(cloudpickle.loads(env_states))


def answered(method: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return (result, None), or (None, error) if the method raised."""
    try:
        return method(*arguments), None
    except ZoacError as error:
        return None, error
    except Exception as error:
        import traceback

        error.add_note("in a worker process:\n" + traceback.format_exc())
        return None, _portable(error)


def _portable(error: Exception) -> Exception:
    """Return the error, or one that says the same if it does not survive a pickle."""
    try:
        cloudpickle.loads(pickled(error))
    except Exception:
        said = RuntimeError(as_text(error))
        for note in getattr(error, "__notes__", ()):
            said.add_note(note)
        return said
    return error


def main() -> None:
    """Serve requests until standard input ends."""
    # What a user's environment prints must not get between the replies, nor what it reads be a
    # request.
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    requests = os.fdopen(os.dup(sys.stdin.fileno()), "rb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    os.dup2(os.open(os.devnull, os.O_RDONLY), sys.stdin.fileno())
    bodies: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests, bodies), daemon=True).start()
    worker = Worker()
    while True:
        method, arguments = cloudpickle.loads(bodies.get())
        result, error = answered(getattr(worker, method), arguments)
        seconds = time.process_time()
        try:
            reply = pickled((result, error, seconds))
        except Exception as refusal:  # by something of the user's in the result
            reply = pickled((None, _portable(refusal), seconds))
        write(replies, reply)


def _listen(requests: IO[bytes], bodies: SimpleQueue[bytes]) -> None:
    """Pass requests on; end this process at their end, even if it is stuck in a user's step."""
    try:
        while True:
            bodies.put(read(requests))
    finally:
        os._exit(0)


if __name__ == "__main__":
    main()
