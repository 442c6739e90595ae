"""Bad inputs and the message each one gets: `python -m stress.bad_inputs > docs/errors.md`.

`tests/run/test_bad_inputs.py` tests the same table, and that the page is up to date.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import json
import os
import re
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from zoac.run import command

# What does begin to run must soon be over.
SHORT = [
    "budget=40", "eval_every=40", "evaluation.episodes=1", "evaluation.final_episodes=1",
    "num_envs=1",
    "task.max_episode_steps=20",
]  # fmt: skip
FOLDER = Path("runs/pid_acc/zoac/seed=0/variant=mine")


@dataclass(frozen=True)
class Case:
    """One bad input.

    Args:
        typed: Arguments of `python -m zoac.run`.
        says: What its message must contain: the value, and the nearest valid choice if any.
        after: What has happened before, in words.
        prepare: Does that, in the current folder.
        varies: The rest of its message depends on Python, or on what is installed.
    """

    typed: str
    says: tuple[str, ...]
    after: str = ""
    prepare: Callable[[], None] = lambda: None
    varies: bool = False


def message(case: Case) -> tuple[int, str]:
    """Return exit code and message of one case, run in a fresh folder; a traceback is code 99."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        sys.path.insert(0, folder)  # as `python -m` does
        try:
            case.prepare()
            code, _, errors = answer(*case.typed.split())
        finally:
            os.chdir(here)
            sys.path.remove(folder)
    return code, errors.strip().replace(str(Path(folder).resolve()), "<here>")


def answer(*arguments: str) -> tuple[int, str, str]:
    """Return exit code, output and errors of `python -m zoac.run`, called in this process."""
    output, errors, code = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.dict(os.environ), mock.patch.object(sys, "argv", ["zoac.run", *arguments]),
        contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors),
    ):  # fmt: skip
        try:
            command.main()
        except SystemExit as stop:
            code = 1 if isinstance(stop.code, str) else int(stop.code or 0)
            if isinstance(stop.code, str):
                print(stop.code, file=sys.stderr)
        except BaseException:
            traceback.print_exc()
            code = 99
    return code, output.getvalue(), errors.getvalue()


@functools.cache
def _a_run() -> Path:
    """Return a folder with a finished run in FOLDER."""
    kept = tempfile.TemporaryDirectory()
    _kept.append(kept)
    here = Path.cwd()
    os.chdir(kept.name)
    code, *_ = answer(*SHORT, "variant=mine", "checkpoint_seconds=0")
    os.chdir(here)
    assert code == 0
    return Path(kept.name)


def _finished() -> None:
    """A finished run in FOLDER."""
    shutil.copytree(_a_run(), ".", dirs_exist_ok=True)


def _begun(damage: Callable[[Path], Any]) -> Callable[[], None]:
    """A run in FOLDER whose result is not there yet, and some damage to it."""

    def prepare() -> None:
        _finished()
        (FOLDER / "result.json").unlink()
        damage(FOLDER)

    return prepare


def _both_checkpoints(content: bytes) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        for path in (folder / "checkpoint").iterdir():
            path.write_bytes(content)

    return damage


def _held() -> None:
    import fcntl

    FOLDER.mkdir(parents=True)
    _kept.append(open(FOLDER / ".lock", "a+"))  # noqa: SIM115 (held until the process ends)
    fcntl.flock(_kept[-1], fcntl.LOCK_EX)


_kept: list[Any] = []


def _own_module(text: str) -> Callable[[], None]:
    return lambda: Path("mine.py").write_text(text) and None


AGAIN = " ".join([*SHORT, "variant=mine"])

CASES = [
    # Names.
    Case("sede=1", ("'sede'", "did you mean 'seed'")),
    Case("tuner.sgima=1", ("'tuner.sgima'", "did you mean 'tuner.exploration.sigma'")),
    Case("evaluation.episode=3", ("did you mean 'evaluation.episodes'",)),
    Case("task.jrek=rate", ("did you mean 'task.jerk'",)),
    Case("+foo=1", ("'foo'", "known: acceptance_test")),
    Case("+evaluation.foo=1", ("evaluation: unknown key 'foo'", "known: episodes")),
    Case("+tuner.foo=1", ("tuner: unknown key 'foo'", "known:")),
    Case("~seed", ("seed", "a value is needed")),
    Case("~tuner", ("a value is needed, tuner=<value>",)),
    Case("~evaluation.seed", ("evaluation.seed=<value>",)),
    Case("task=pidacc", ("'pidacc'", "did you mean 'pid_acc'")),
    Case("tuner=zoca", ("'zoca'", "did you mean 'zoac'")),
    Case("executor=proces", ("'proces'", "did you mean 'process'")),
    Case("method=zoc", ("'zoc'", "did you mean 'zoac'")),
    Case("experiment=tabel2", ("'tabel2'", "did you mean 'table2'")),
    Case("tuner.exploration={foo:3}", ("'tuner.exploration.foo'", "exploration.sigma")),
    Case("tuner=nevergrad tuner.name=PSOO", ("'PSOO'", "did you mean 'PSO'")),
    # How it is written.
    Case("seed", ("'seed'", "expected key=value")),
    Case("--seed 3", ("--seed", "did you mean seed=3?")),
    Case("--seed=3", ("--seed=3", "did you mean seed=3?")),
    Case("variant=größe", ("'variant=größe'", "\"key='value'\"")),
    Case("größe=3", ("'größe=3'", "expected key=value")),
    Case("=3", ("'=3'", "expected key=value")),
    Case("a=b=c", ("'a=b=c'", "expected key=value")),
    Case("seed='", ("seed='", "expected key=value")),
    Case("seed=1,2", ("seed=1,2", "--multirun")),
    Case("--sede=1", ("--sede=1",), varies=True),
    Case("tuner=null", ("unknown tuner 'None'", "zoac")),
    Case("tuner=3", ("unknown tuner '3'", "zoac")),
    Case("task={a:1}", ("{'a': 1}", "pid_acc")),
    Case("task=", ("task ''", "pid_acc")),
    Case("tuner=[zoac,bo]", ("['zoac', 'bo']", "zoac_plus")),
    Case("evaluation=3", ("evaluation=3", "evaluation.episodes")),
    Case("seed=${nope}", ("seed", "'nope'")),
    Case("seed=${oc.env:NOPE}", ("seed", "'NOPE'")),
    # Keys of the run.
    Case("seed=x", ("seed='x'", "integer")),
    Case("seed=", ("seed=''", "integer")),
    Case("seed=[1]", ("seed=[1]", "integer")),
    Case("seed=-1", ("seed=-1", "greater than or equal to 0")),
    Case("budget=1.5", ("budget=1.5", "integer")),
    Case("budget=1e99", ("budget=1e+99", "integer")),
    Case("budget=-1", ("budget=-1", "greater than or equal to 0")),
    Case("num_envs=0", ("num_envs=0", "greater than or equal to 1")),
    Case("num_envs=1000000000000", ("num_envs=1000000000000", "less than or equal to 100000")),
    Case("eval_every=0", ("eval_every=0", "greater than or equal to 1")),
    Case("evaluation.episodes=0", ("evaluation.episodes=0", "greater than or equal to 1")),
    Case("evaluation.final_episodes=many", ("evaluation.final_episodes='many'", "integer")),
    Case("evaluation.seed=-1", ("evaluation.seed=-1", "greater than or equal to 0")),
    Case("checkpoint_seconds=nan", ("checkpoint_seconds=nan", "finite")),
    Case("checkpoint_seconds=inf", ("checkpoint_seconds", "inf", "finite")),
    Case("checkpoint_seconds=-1", ("checkpoint_seconds=-1", "greater than or equal to 0")),
    Case("checkpoint_seconds=x", ("checkpoint_seconds='x'", "valid number")),
    Case("initial_samples=0", ("initial_samples=0", "greater than or equal to 1")),
    Case("initial_samples=two", ("initial_samples='two'", "integer")),
    Case("tuner=random initial_samples=4", ("initial_samples=4", "this tuner takes none")),
    Case("common_random_numbers=maybe", ("common_random_numbers='maybe'", "boolean")),
    Case("failure_penalty=nan", ("failure_penalty=nan", "finite")),
    Case("failure_penalty=high", ("failure_penalty='high'", "valid number")),
    Case("resume=maybe", ("resume='maybe'", "'auto', 'never' or 'overwrite'")),
    Case("variant=../x", ("'../x'", "'x'")),
    Case("runs_dir=", ("runs_dir=''", "such as runs")),
    Case("runs_dir=null", ("runs_dir",)),
    Case(f"variant={'long' * 80}", ("File name too long", "variant=<name>")),
    # Options of the choices; all faults of one choice are told at once.
    Case("tuner.exploration.sigma=abc tuner.exploration.segments=0 tuner.gamma=1.2 "
         "tuner.critic.hidden=[3,x] tuner.critic.step_size=nan tuner.recommend=lats "
         "tuner.step_size.anneal=3",
         ("tuner.exploration.sigma='abc'", "number", "segments=0", "greater than or equal to 1",
          "tuner.gamma=1.2", "less than", "tuner.critic.hidden[1]='x'", "integer",
          "tuner.critic.step_size=nan: input should be a finite number",
          "tuner.recommend='lats'", "did you mean 'last'", "tuner.step_size.anneal=3", "boolean")),
    Case("tuner.exploration.sigma=inf tuner.critic.step_size=null tuner.critic.hidden=256",
         ("tuner.exploration.sigma", "inf", "finite", "step_size=None", "hidden=256", "list")),
    Case("tuner=cmaes tuner.covariance=ful tuner.population=0",
         ("'ful'", "did you mean 'full'", "tuner.population=0", "greater than")),
    Case("tuner=bo tuner.start=midle", ("'midle'", "did you mean 'middle'")),
    Case("initial_sigma=0", ("initial_sigma=0", "greater than 0")),
    Case("tuner=random initial_sigma=0.1", ("initial_sigma=0.1", "no start and no sigma")),
    Case("acceptance_test=2", ("acceptance_test=2", "less than")),
    Case("select=best", ("select", "best_evaluated")),
    Case("task.jerk=rat task.preceding_std=-1 task.max_episode_steps=0",
         ("task.jerk='rat'", "did you mean 'rate'", "task.preceding_std=-1",
          "task.max_episode_steps=0", "greater than or equal to 1")),
    Case("task=mpc_tracking task.mpc.horizon=0 task.mpc.linearisations=often",
         ("task.mpc.horizon=0", "greater than", "task.mpc.linearisations='often'", "'converged'")),
    Case("task=mpc_tracking mpc_solver.max_iterations=many",
         ("max_iterations='many'", "integer")),
    Case("executor=process executor.workers=0", ("executor.workers=0", "than or equal to 1")),
    Case("logger=wandb logger.wandb.mode=onlin", ("'onlin'", "did you mean 'online'")),
    Case("logger=[none,wandbb]", ("'wandbb'", "did you mean 'wandb'")),
    Case("task._target_=zoac.nothing.Here", ("'zoac.nothing.Here'", "no module 'zoac.nothing'")),
    Case("task._target_=zoac.tasks.pid_acc.PidAc", ("'PidAc'", "did you mean 'PidAcc'")),
    Case("task._target_=os.system", ("'os.system'", "not called", "-> Task")),
    Case("tuner._target_=subprocess.run", ("'subprocess.run'", "not called", "-> Tuner")),
    Case("task._target_=3", ("task._target_", "dotted path", "3")),
    Case("task._target_=mine.Task", ("importing mine raised ZeroDivisionError", "mine.py, line 1"),
         "mine.py: `1/0`", _own_module("1/0")),
    # Folders.
    Case("runs_dir=file", ("file/pid_acc", "Not a directory", "another runs_dir"),
         "a file of that name", lambda: Path("file").touch()),
    Case("runs_dir=/proc/nowhere", ("/proc/nowhere", "another runs_dir")),
    Case(f"{AGAIN} tuner.exploration.sigma=0.3", ("sigma: 0.08 there, 0.3 now", "variant=<name>"),
         "a run without it", _finished),
    Case(f"{AGAIN} resume=never", ("holds a run already", "resume=auto"), "the same", _finished),
    Case(AGAIN, ("another process is running this run",), "it is running", _held),
    Case(AGAIN, ("run.json", "cannot be read as JSON"), "run.json cut in half",
         _begun(lambda f: (f / "run.json").write_text("{"))),
    Case(AGAIN, ("run.json", "format 99, expected 1"), "run.json of another version",
         _begun(lambda f: (f / "run.json").write_text(json.dumps({"format": 99})))),
    Case(AGAIN, ("no checkpoint can be read", "resume=overwrite"), "both checkpoints damaged",
         _begun(_both_checkpoints(b"rubbish"))),
    Case(AGAIN, ("checkpoint format 99", "reads format", "resume=overwrite"),
         "a checkpoint of another version",
         _begun(_both_checkpoints(b'{"format": 99, "sha256": ""}\n'))),
    Case(AGAIN, ("metrics.jsonl holds 0 bytes", "resume=overwrite"), "metrics.jsonl deleted",
         _begun(lambda f: (f / "metrics.jsonl").unlink()), varies=True),
    # Sweeps.
    Case("hydra/launcher=xyz", ("'hydra/launcher/xyz'", "basic"), varies=True),
    Case("-m seed=glob(*)", ("seed=glob(*)", "no jobs")),
    Case("-m tuner=zoac,random tuner.gamma=0.1", ("'tuner.gamma'", "tuner.recommendation")),
    Case("-m seed=0,x", ("seed='x'", "integer")),
    Case("-m tuner.gamma=-1,-2", ("2 job(s) of the sweep", "tuner.gamma=-1", "tuner.gamma=-2")),
]  # fmt: skip


def without_lists(text: str) -> str:
    """Return a message without its list of choices: a new task or key is to change no page."""
    return re.sub("known: .*", "known: ...", text)


def page() -> str:
    """Return docs/errors.md."""
    lines = [
        "# Messages",
        "",
        "The messages of `python -m zoac.run` for bad input. Each is one message without a",
        "traceback, and the exit code is not 0. `python -m stress.bad_inputs` writes this page.",
    ]
    for case in CASES:
        if case.varies:
            continue
        typed = case.typed if len(case.typed) < 200 else f"{case.typed[:60]}..."
        for part in SHORT if case.after else []:
            typed = typed.replace(part, "").strip()
        after = f", after: {case.after}" if case.after else ""
        lines += ["", f"`{' '.join(typed.split())}`{after}", "```text"]
        lines += [without_lists(message(case)[1]), "```"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(page(), end="")
