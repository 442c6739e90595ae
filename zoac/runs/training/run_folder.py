"""The folder of a run: its name, its lock, and what an earlier run left in it."""

import errno
import re
import shutil
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from zoac.core.errors import ConfigError, RunFolderError
from zoac.runs import schema
from zoac.runs.lock import locked


def of(config: Mapping[str, Any], task: str, tuner: str) -> Path:
    """Return `<runs_dir>/<task>/<tuner>/seed=<s>[/variant=<name>]`.

    Raises:
        ConfigError: If `runs_dir` is empty or `variant` is no name of a folder.
    """
    if not config["runs_dir"].strip():
        raise ConfigError(
            f"runs_dir={config['runs_dir']!r}: expected a folder, such as runs, or . for this one"
        )
    variant = config["variant"] or ""
    if "/" in variant:
        usable = "-".join(re.findall("[^/.]+", variant)) or "mine"
        raise ConfigError(
            f"variant={variant!r}: expected the name of one folder, without /, such as {usable!r}"
        )
    folder = Path(config["runs_dir"]).expanduser() / task / tuner / f"seed={config['seed']}"
    return folder / f"variant={config['variant']}" if config["variant"] else folder


def make(folder: Path) -> None:
    """Make the folder and its lock file.

    Raises:
        RunFolderError: If that is impossible there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".lock").touch()
    except OSError as error:
        too_long = error.errno == errno.ENAMETOOLONG
        remedy = "give it a short name: variant=<name>" if too_long else "choose another runs_dir"
        raise RunFolderError(
            f"cannot make or use the run folder {folder}: {error.strerror}; {remedy}"
        ) from None


def held(folder: Path) -> AbstractContextManager[None]:
    """Return a context that holds the folder's lock; it is a `RunFolderError` if another does."""
    return locked(folder / ".lock", held="another process is running this run")


def prepare(folder: Path, config: Mapping[str, Any]) -> bool:
    """Make the folder ready by `resume` of the config; return whether its run is done already.

    Raises:
        RunFolderError: If it holds another run, or a damaged one.
    """
    resume = config["resume"]
    if resume == "overwrite":
        empty(folder)
        return False
    if not (folder / schema.RUN).exists():
        if (folder / schema.CHECKPOINTS).exists() or schema.is_done(folder):
            raise RunFolderError(
                f"{folder} holds a run without its {schema.RUN}: whose it is cannot be told. "
                "Put the file back, or start anew with resume=overwrite"
            )
        return False
    if resume == "never":
        raise RunFolderError(
            f"{folder} holds a run already and resume=never; use resume=auto to go on with it, "
            "resume=overwrite to start anew, or another variant=<name>"
        )
    earlier = schema.read_run(folder)
    if earlier["config_hash"] != schema.config_hash(config):
        differences = schema.differing_keys(earlier["config"], config)
        told = "\n".join(f"  {key}: {a!r} there, {b!r} now" for key, (a, b) in differences.items())
        coded = any(key.startswith("code.") for key in differences)
        hint = "Behind @ stands a digest of code and values. " if coded else ""
        raise RunFolderError(
            f"{folder} holds a run of another configuration:\n{told}\n"
            f"{hint}Use those values, another variant=<name>, or resume=overwrite"
        )
    return schema.is_done(folder)


def empty(folder: Path) -> None:
    """Delete the run. If interrupted, what remains still identifies this run or is empty.

    Raises:
        RunFolderError: If something cannot be deleted.
    """
    try:
        # run.json goes last, so that leftovers are never attributed to another run.
        if (folder / schema.CHECKPOINTS).exists():
            shutil.rmtree(folder / schema.CHECKPOINTS)
        for name in (
            schema.RESULT, schema.RESPONSES, schema.METRICS, schema.TASK, schema.JOURNAL, schema.RUN
        ):  # fmt: skip
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise RunFolderError(
            f"{folder}: resume=overwrite cannot delete {error.filename}: {error.strerror}"
        ) from None
