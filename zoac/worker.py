"""A worker process of `executor=process`: `python -m zoac.worker`, spoken to through pipes.

Requests and replies are cloudpickles, each behind its length. The worker ends when its standard
input does, so it never outlives the process that started it.
"""

from __future__ import annotations

import os
import struct
import sys
import time
from collections.abc import Callable
from typing import IO, Any

import cloudpickle

from zoac.errors import ZoacError
from zoac.executor import LaneHost

_LENGTH = struct.Struct("<Q")


def send(stream: IO[bytes], message: Any) -> None:
    """Write one message.

    Raises:
        OSError: If nobody listens any more.
    """
    body = cloudpickle.dumps(message)
    stream.write(_LENGTH.pack(len(body)))
    stream.write(body)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read one message.

    Raises:
        EOFError: If the other side has gone.
    """
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    return cloudpickle.loads(_exactly(stream, length))


def _exactly(stream: IO[bytes], length: int) -> bytes:
    body = stream.read(length)
    if len(body) < length:
        raise EOFError
    return body


class Worker:
    """Answers requests with one host's lanes."""

    def __init__(self) -> None:
        self._host: LaneHost | None = None

    def start(self, *arguments: Any) -> None:
        """Make the lanes: arguments of `LaneHost`."""
        self._host = LaneHost(*arguments)

    def rollout(self, proposals: Any) -> Any:
        """Return the segments, and the lanes' state in case this process dies later."""
        assert self._host is not None
        return self._host.lanes.rollout(proposals), self._host.lanes.state()

    def evaluate(self, proposals: Any) -> Any:
        """Return the segments of evaluation episodes."""
        assert self._host is not None
        return self._host.evaluate(proposals)

    def state(self) -> Any:
        """Return the lanes' state."""
        assert self._host is not None
        return self._host.lanes.state()

    def restore(self, state: Any) -> None:
        """Put the lanes back."""
        assert self._host is not None
        self._host.lanes.restore(state)


def answered(method: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return (result, None), or (None, error) if the method raised."""
    try:
        return method(*arguments), None
    except ZoacError as error:
        return None, error
    except Exception as error:
        import traceback

        error.add_note("in a worker process:\n" + traceback.format_exc())
        return None, error


def main() -> None:
    """Serve requests until standard input ends."""
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What a user's environment prints must not get between the replies.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    requests = sys.stdin.buffer
    worker = Worker()
    while True:
        try:
            method, arguments = receive(requests)
        except EOFError:
            return
        result, error = answered(getattr(worker, method), arguments)
        send(replies, (result, error, time.process_time()))


if __name__ == "__main__":
    main()
