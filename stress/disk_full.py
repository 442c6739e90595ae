"""Runs on a disk that fills up: `python -m stress.disk_full` (root on Linux: it mounts a tmpfs).

The disk is filled while rows are logged, while checkpoints are written, and before the result is.
The run must stop with a message and leave a readable folder. Once there is room again it must end
with the same bits as an undisturbed run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zoac.core.errors import RunFolderError
from zoac.runs import checkpoint, schema
from zoac.runs.log import RunLog

SIZE = 4 * 2**20


@contextmanager
def small_disk() -> Iterator[Path]:
    """Yield an empty file system of SIZE bytes.

    Raises:
        OSError: If it cannot be mounted.
    """
    with tempfile.TemporaryDirectory() as folder:
        try:
            subprocess.run(
                ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", folder],
                check=True, capture_output=True, text=True,
            )  # fmt: skip
        except subprocess.CalledProcessError as error:
            raise OSError(error.stderr.strip()) from None
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def fill(disk: Path, leave: int) -> Path:
    """Fill a disk but for `leave` bytes; return the file that does, whose removal frees it."""
    ballast = disk / "ballast"
    with open(ballast, "wb", buffering=0) as file:
        try:
            while file.write(b"x" * 4096):
                pass
        except OSError:
            pass
        file.truncate(file.tell() - leave)
    return ballast


class FillingLog(RunLog):
    """A run log whose disk is full from a chosen moment on.

    Args:
        moment: "row", "checkpoint" or "result".
        after: How many of these go well.
    """

    def __init__(self, folder: Path, run: Any, disk: Path, moment: str, after: int) -> None:
        super().__init__(folder, run)
        self._disk, self._moment, self._left = disk, moment, after

    def _arrive(self, moment: str, leave: int) -> None:
        if moment == self._moment:
            self._left -= 1
            if self._left == -1:
                fill(self._disk, leave)

    def row(self, *arguments: Any) -> dict[str, Any]:
        """See `RunLog.row`; there is room for no more than the rest of a page."""
        self._arrive("row", 0)
        return super().row(*arguments)

    def save_checkpoint(self, state: Any) -> None:
        """See `RunLog.save_checkpoint`; there is room for a part of it."""
        self._arrive("checkpoint", 4096)
        super().save_checkpoint(state)

    def finish(self, numbers: Any) -> dict[str, Any]:
        """See `RunLog.finish`."""
        self._arrive("result", 0)
        return super().finish(numbers)


def stopped_by_a_full_disk(disk: Path, moment: str, train: Any) -> str:
    """Run until the disk is full, see that the folder can be read, free it; return what it says.

    Args:
        disk: From `small_disk`.
        moment: See `FillingLog`.
        train: Called with a maker of logs, (folder, run) -> RunLog.
    """
    folder = disk / "run"
    try:
        train(lambda f, run: FillingLog(f, run, disk, moment, 0 if moment == "result" else 3))
    except RunFolderError as error:
        message = str(error)
    else:
        raise AssertionError(f"a disk that is full at a {moment} stopped nothing")
    json.loads((folder / schema.RUN).read_text())
    schema.read_metrics(folder)
    checkpoint.load(folder / "checkpoint")
    (disk / "ballast").unlink()
    return message


def main() -> None:
    """Fill the disk at every moment."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    from tests.runs.test_disk_full import numbers, train_in

    with tempfile.TemporaryDirectory() as whole:
        expected = numbers(train_in(Path(whole), RunLog))
    for moment in ("row", "checkpoint", "result"):
        with small_disk() as disk:
            said = stopped_by_a_full_disk(disk, moment, lambda make: train_in(disk / "run", make))
            if numbers(train_in(disk / "run", RunLog)) != expected:
                sys.exit(f"full at a {moment}: other bits")
        print(f"full at a {moment}: same bits after\n  {said}")


if __name__ == "__main__":
    main()
