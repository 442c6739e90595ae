"""The part of a report that says how to make the run again, and on what it was made."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from omegaconf import OmegaConf

from zoac.analysis.data.runs import Run
from zoac.analysis.pages import html
from zoac.config.files import choice, choices, configuration
from zoac.config.settings import Settings
from zoac.core.errors import ConfigError
from zoac.runs import schema

AGAIN = "again"
"""Folder into which the run is made again: one in its old place is done already."""

TARGET = "_target_"


def reproduce(run: Run) -> str:
    """Return a command or a program that makes the run again, versions and configuration."""
    identity = run.identity
    facts = {
        key: identity[key]
        for key in ("started", "commit", "machine", "versions", "config_hash", "tuner_choices")
        if key in identity
    }
    return (
        _way(run)
        + html.folded("Versions and machine", html.code(OmegaConf.to_yaml(facts)))
        + html.folded("Configuration", html.code(OmegaConf.to_yaml(dict(run.config))))
    )


def _way(run: Run) -> str:
    """Return how to make the run again, with a sentence."""
    told = "The same versions on the same processor model give the same numbers."
    if "study" in run.identity:
        text = _command(run) or _script(run)
        told = "Its experiments were made outside zoac; costs told alike give the same proposals."
    elif text := _command(run):
        pass
    elif text := _program(run):
        told = f"In Python, where this report was made. {told}"
    else:
        text = _script(run)
        told = f"The script that made the run, where it was called. {told}"
    return html.code(text) + html.paragraph(told, "muted") if text else ""


def _script(run: Run) -> str:
    """Return the command of a run that a script made; nothing if that is not known."""
    words = run.identity.get("command") or [""]
    if words[0].endswith(".py"):
        return f"python {shlex.join(words)}"
    return "" if words[0] in ("", "-c") else shlex.join(words)


def _command(run: Run) -> str:
    """Return the command of a run of the command line; nothing for another, or if unknown."""
    words = run.identity.get("command")
    by_name = TARGET in run.config["task"] or "study" in run.identity
    programs = ("zoac/run/__main__.py", "zoac run", "zoac.run")
    if not by_name or (words and not words[0].endswith(programs)):
        return ""
    arguments = words[1:] if words else ["-m"]
    if {"-m", "--multirun"} & set(arguments):  # of all runs of a sweep, not of this one
        try:
            arguments = _overrides(run)
        except ConfigError:  # a task or a tuner of the user's, whose files are elsewhere
            return ""
    kept = [word for word in arguments if not word.startswith("runs_dir=")]
    return f"python -m zoac.run {shlex.join([*kept, f'runs_dir={AGAIN}'])}"


def _overrides(run: Run) -> list[str]:
    """Return the overrides of `zoac.run` that give a run's configuration.

    Raises:
        ConfigError: If its task, its tuner or its solver has no file here.
    """
    config = run.config
    names = reversed(choices("mpc_solver"))
    solvers = {choice("mpc_solver", name).get(TARGET): name for name in names}
    chosen = {
        "task": run.method.task,
        "tuner": run.method.tuner,
        "fidelity": config.get("fidelity", {}).get("source", "paper"),
        "mpc_solver": solvers.get(config.get("mpc_solver", {}).get(TARGET), ""),
    }
    defaults = configuration()
    plain = configuration(**chosen)
    words = [
        f"{group}={name}"
        for group, name in chosen.items()
        if group in ("task", "tuner") or defaults[group] != plain[group]
    ]
    words.append(f"seed={run.seed}")
    differing = schema.differing_keys({**plain, "seed": run.seed}, config)
    for key, (here, there) in differing.items():
        if key.split(".")[0] != "code":
            mark = "+" if here == "(absent)" else ""
            words.append(f"~{key}" if there == "(absent)" else f"{mark}{key}={_override(there)}")
    return words


def _override(value: Any) -> str:
    """Return a value as Hydra reads it."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{','.join(map(_override, value))}]"
    return value if isinstance(value, str) else json.dumps(value)


def _program(run: Run) -> str:
    """Return Python code that makes a run of `zoac.tune` again; nothing if its task is unknown."""
    config = run.config
    task, imports = repr(run.method.task), ""
    if TARGET not in config["task"]:
        if not (run.folder / schema.TASK).is_file():
            return ""
        task = "task_of_run(folder, trust_code=True)"
        imports = "from zoac.runs.result import task_of_run\n"
    elif run.method.task not in choices("task"):
        return ""
    given = {"tuner": run.method.tuner, "seed": run.seed}
    given |= {key: config[key] for key in ("budget", "eval_every")}
    given |= {key: config["evaluation"][key] for key in ("episodes", "final_episodes")}
    for setting in fields(Settings):
        value = config.get(setting.name, setting.default)
        if setting.name not in ("evaluation", "checkpoint_seconds") and value != setting.default:
            given.setdefault(setting.name, value)
    lines = "".join(f"    {name}={value!r},\n" for name, value in given.items())
    return (
        f"import json\nfrom pathlib import Path\n\nimport zoac\n{imports}\n"
        f"folder = Path({run.folder.as_posix()!r})\n"
        f'config = json.loads((folder / "{schema.RUN}").read_text())["config"]\n'
        "result = zoac.tune(\n"
        f"    task={task},\n{lines}"
        f'    tuner_options={{k: v for k, v in config["tuner"].items() if k != "{TARGET}"}},\n'
        f'    folder="{AGAIN}",\n)\n'
    )
