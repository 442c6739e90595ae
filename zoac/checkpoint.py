"""Checkpoints: written atomically, the previous one kept, damage noticed.

A checkpoint file is one line of JSON (format version, SHA-256 of the rest) and a pickle. Pickles
run code when read: only resume runs from folders you trust.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from pathlib import Path
from typing import Any

import cloudpickle

from zoac.errors import RunFolderError
from zoac.records import sync_folder, write_atomically

FORMAT = 1
CURRENT, PREVIOUS = "current.ckpt", "previous.ckpt"


def save(folder: Path, state: Any) -> None:
    """Write `state` as the current checkpoint; what was current becomes the previous one.

    Raises:
        OSError: If it cannot be written; the earlier checkpoints are then untouched.
    """
    folder.mkdir(parents=True, exist_ok=True)
    body = cloudpickle.dumps(state)  # takes what pickle does not: classes made in a function
    header = json.dumps({"format": FORMAT, "sha256": hashlib.sha256(body).hexdigest()})
    fresh = folder / "fresh.ckpt"
    write_atomically(fresh, header.encode() + b"\n" + body)
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


def unfit(what: str, error: Exception) -> RunFolderError:
    """Return the refusal of a whole checkpoint that the installed packages cannot take up."""
    return RunFolderError(
        f"{what}: it is whole, but not of these versions of zoac and its packages "
        f"({type(error).__name__}: {error}). Finish the run with those that began it, or start "
        "anew with resume=overwrite"
    )


class _DamagedError(Exception):
    pass


def _read(path: Path) -> Any:
    try:
        line, _, body = path.read_bytes().partition(b"\n")
    except OSError as error:
        raise _DamagedError(f"cannot be read ({error.strerror})") from None
    try:
        header = json.loads(line)
        version, checksum = header["format"], header["sha256"]
    except (ValueError, KeyError, TypeError):
        raise _DamagedError("the header is damaged") from None
    if version != FORMAT:
        raise RunFolderError(
            f"{path}: checkpoint format {version!r}; this version of zoac reads format {FORMAT}. "
            "Finish the run with the version that began it, or start anew with resume=overwrite"
        )
    if hashlib.sha256(body).hexdigest() != checksum:
        raise _DamagedError("the content does not match its checksum")
    try:
        return pickle.loads(body)
    except Exception as error:
        raise unfit(str(path), error) from error
