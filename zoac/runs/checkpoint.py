"""Checkpoints: written atomically, the previous one kept, damage noticed.

A checkpoint file is one line of JSON (format version, SHA-256 of the rest, length of its first
part) and the two parts of `zoac.core.state.Encoded`: numbers and text, and a pickle of objects,
which tasks of zoac do not need. A pickle runs code when it is opened. This one is opened only if a
run goes on that uses such objects: go on with other people's runs only if you trust them.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zoac.core.errors import RunFolderError, ZoacError, as_text
from zoac.core.state import Encoded, decode, encode
from zoac.runs.schema import sync_folder, write_atomically

FORMAT = 4
CURRENT, PREVIOUS = "current.ckpt", "previous.ckpt"


def save(folder: Path, state: Any) -> None:
    """Write `state` as the current checkpoint; what was current becomes the previous one.

    Raises:
        OSError: If it cannot be written; the earlier checkpoints are then untouched.
        UnsavableError: If the state holds something that is not plain; likewise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    plain, objects = encode(state)
    checksum = hashlib.sha256(plain + objects).hexdigest()
    header = json.dumps({"format": FORMAT, "sha256": checksum, "plain": len(plain)})
    fresh = folder / "fresh.ckpt"
    write_atomically(fresh, header.encode() + b"\n" + plain + objects)
    # A crash between the two renames leaves the previous one and the fresh one, both whole.
    if (folder / CURRENT).exists():
        os.replace(folder / CURRENT, folder / PREVIOUS)
    os.replace(fresh, folder / CURRENT)
    sync_folder(folder)


def load(folder: Path) -> tuple[Any, list[str]] | None:
    """Return the newest whole checkpoint and what was wrong with newer ones; None if none exists.

    Raises:
        RunFolderError: If checkpoints exist but none can be read, or one has another format or
            holds what the installed packages do not know.
    """
    complaints: list[str] = []
    for name in (CURRENT, PREVIOUS):
        path = folder / name
        if not path.exists():
            continue
        try:
            return _read(path), complaints
        except _DamagedError as damage:
            complaints.append(f"{path}: {damage}")
    if complaints:
        raise RunFolderError(
            "no checkpoint can be read: " + "; ".join(complaints) + ". Start anew with "
            "resume=overwrite"
        )
    return None


def unfit(what: str, reason: str) -> RunFolderError:
    """Return the refusal of a whole checkpoint that the installed packages cannot take up."""
    return RunFolderError(
        f"{what}: it is whole, but not of these versions of zoac and its packages ({reason}). "
        "Finish the run with those that began it, or start anew with resume=overwrite"
    )


@contextmanager
def fitting(what: str) -> Iterator[None]:
    """Report whatever is raised while a part of a checkpoint is restored: it does not fit."""
    try:
        yield
    except ZoacError:
        raise
    except Exception as error:
        raise unfit(what, as_text(error)) from error


def check_keys(what: str, found: Any, expected: Any) -> None:
    """Refuse a part of a checkpoint with other keys than this version writes.

    Raises:
        RunFolderError: If it has; a part that is no dict has none.
    """
    names, known = (set(part) if isinstance(part, dict) else set() for part in (found, expected))
    faults = [f"{says} {', '.join(map(repr, sorted(keys, key=str)))}"
              for says, keys in (("unknown:", names - known), ("missing:", known - names))
              if keys]  # fmt: skip
    if faults:
        raise unfit(what, "; ".join(faults))


class _DamagedError(Exception):
    pass


def _read(path: Path) -> Any:
    try:
        line, _, body = path.read_bytes().partition(b"\n")
    except OSError as error:
        raise _DamagedError(f"cannot be read ({error.strerror})") from None
    try:
        header = json.loads(line)
        version = header["format"]
    except (ValueError, KeyError, TypeError):
        raise _DamagedError("the header is damaged") from None
    if version != FORMAT:
        raise RunFolderError(
            f"{path}: checkpoint format {version!r}; this version of zoac reads format {FORMAT}. "
            "Finish the run with the version that began it, or start anew with resume=overwrite"
        )
    if hashlib.sha256(body).hexdigest() != header.get("sha256"):
        raise _DamagedError("the content does not match its checksum")
    with fitting(str(path)):
        length = header["plain"]
        return decode(Encoded(body[:length], body[length:]))
