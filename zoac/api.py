"""For people who write Python, not YAML."""

from __future__ import annotations

import inspect
import json
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from zoac.config import factory, fingerprint
from zoac.config.compose import GROUPS, compose_config, resolved
from zoac.core.errors import ConfigError, Interrupted, suggest
from zoac.core.measures import Constraint, Metric
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number
from zoac.envs.gymnasium_adapter import Bounds
from zoac.loggers.console import Console
from zoac.rollout.task import Task
from zoac.runs import schema
from zoac.runs.result import Result, keep_task, result_of
from zoac.runs.schema import TASK
from zoac.tasks.user_task import EnvSource, UserTask, user_task
from zoac.training.lifecycle import Run, execute, with_code


def make_task(name: str, **overrides: Any) -> Task:
    """Return a task by its config name.

    Args:
        name: As on the command line: "pid_acc", "mpc_tracking", ...
        overrides: Config groups by name (`mpc_solver="riccati"`, `fidelity="authors_code"`), or
            options of the task (`max_episode_steps=200`).

    Raises:
        ConfigError: If the task, a group's choice or an option is unknown, or a value is unusable.
    """
    groups = [f"{key}={value}" for key, value in overrides.items() if key in GROUPS]
    config = compose_config([f"task={name}", *groups])
    options = {key: value for key, value in overrides.items() if key not in GROUPS}
    _set(config, "task", options, f"task {name!r}", GROUPS)
    plain = resolved(config)
    task = factory.build_task(plain)
    task.tuned_for = plain["task"].get("tuned_for", {})
    return task


def tune(
    *,
    task: Task | str | None = None,
    env: EnvSource | None = None,
    controller: Any = None,
    space: ParameterSpace | Mapping[str, Any] | None = None,
    tuner: str = "zoac",
    budget: int = 50_000,
    seed: int = 0,
    num_envs: int = 10,
    baseline: Mapping[str, Any] | None = None,
    metrics: Sequence[Metric] | Mapping[str, Any] = (),
    constraints: Sequence[Constraint] | Mapping[str, Any] = (),
    max_episode_steps: int | None = None,
    plant: Mapping[str, float] | None = None,
    vary: Mapping[str, Bounds] | None = None,
    objective: str = "auto",
    initial_sigma: float | None = None,
    acceptance_test: float | None = None,
    select: str | None = None,
    initial_samples: int | None = None,
    common_random_numbers: bool = False,
    failure_penalty: float | None = None,
    tuner_options: Mapping[str, Any] | None = None,
    executor: str = "auto",
    eval_every: int | None = None,
    episodes: int = 10,
    final_episodes: int = 20,
    folder: str | Path | None = None,
    resume: str = "auto",
    quiet: bool = False,
    **unknown: Any,
) -> Result:
    """Tune a controller in a simulator; return the best parameters found.

        result = zoac.tune(env="Pendulum-v1", controller=act, space={"kp": (0, 20), "kd": (0, 5)})

    Args:
        task: A `Task`, or the name of a built-in one; else give `env`, `controller` and `space`.
        env: A Gymnasium id, a function that makes an environment, or an environment.
        controller: `act(params, obs)`, or an object with such a method that may remember things
            and begins an episode in `reset()`; params is {name: number}, obs an array.
        space: Bounds by name: `(low, high)`, `(low, high, "log")`, a dict with `low`, `high`,
            `scale`, `unit`, `baseline`; `(low, high, "integer")`; a dict with `choices`; or one
            number, which is fixed.
        tuner: Name of a tuner's config: "zoac", "cmaes", "bo", "random", ...
        budget: Environment steps for tuning.
        seed: Of everything.
        num_envs: Environments side by side.
        baseline: Values in use today. The tuner begins there if it takes a start; their cost is
            reported beside the result.
        metrics: Reported beside the cost: `Metric`s, or functions of a segment by name.
        constraints: What must hold at every step, likewise; see `zoac.rollout.constraints`.
        max_episode_steps: Cut episodes here; needed if the environment does not end by itself.
        plant: Numbers of the environment to set, by attribute: `{"m": 1.2}`.
        vary: Ranges from which every episode, of tuning and evaluation, draws such numbers:
            `{"m": (0.8, 1.2)}`.
        objective: What is minimised: "reward", its negative; "cost", `info["cost"]`; "info:<key>",
            another number of info; "auto", the negative reward unless `info["cost"]` differs from
            it, which is refused.
        initial_sigma: Standard deviation of the search around the baseline in the mapped box
            [-1, 1]^d, such as 0.1; the search then begins at the baseline.
        acceptance_test: Fraction of the budget, such as 0.2, for held-out episodes on which the
            answer must beat the baseline; otherwise the baseline is the answer.
            `result.record["acceptance_test"]` has the verdict.
        select: "best_evaluated": the answer is the best of the recommendations that were evaluated
            and the baseline values, on held-out episodes that a fifth of the budget pays for; None:
            what the tuner recommends at the end.
        initial_samples: Evaluate so many random points for one episode each, and start from the
            best.
        common_random_numbers: Whole episodes that the tuner asks for together begin alike.
        failure_penalty: Cost of a step that fails, which ends its episode: controller or
            environment raises, or returns what is not finite; None: that ends the run with a
            message. `result.record` counts `failures` and keeps the `first_failure`.
        tuner_options: By name, such as {"sigma": 0.05}.
        executor: "auto" (worker processes where steps are slow enough to pay), "serial" or
            "process".
        eval_every: Steps between evaluations; None: a tenth of the budget.
        episodes: Evaluation episodes during tuning.
        final_episodes: Evaluation episodes of the final figure.
        folder: Run folder; None: a new temporary one.
        resume: What becomes of a run in that folder: "auto" (it goes on if its settings, and the
            code and values of environment and controller, are these, and is returned if it is
            done), "never", "overwrite".
        quiet: Print nothing.
        unknown: Any other option is refused, with the nearest name.

    Raises:
        Interrupted: If Ctrl-C or a SIGTERM stopped the run, which ends after its iteration with a
            checkpoint. The error's `result` is the recommendation so far; its message says how
            the run goes on.
        ConfigError: If something given cannot be used.
        ControllerError: If the controller raises or returns what is not a finite action, and
            there is no `failure_penalty`.
        EnvironmentFailure: If the environment raises or returns what is not finite, likewise.
        NothingWorksError: If every episode fails.
        RunFolderError: If `folder` holds another run.
    """
    for name in unknown:
        known = [n for n in inspect.signature(tune).parameters if n != "unknown"]
        raise ConfigError(f"zoac.tune has no option {name!r}; {suggest(name, known)}")
    options_of_task = {
        "baseline": baseline,
        "metrics": metrics,
        "constraints": constraints,
        "max_episode_steps": max_episode_steps,
        "plant": plant,
        "vary": vary,
        "objective": objective,
    }
    the_task = _task(task, env, controller, space, options_of_task)
    built_in = [f"task={task}"] if isinstance(task, str) else []
    chosen = [f"tuner={tuner}", f"executor={executor}", f"resume={resume}", *built_in]
    config = compose_config(chosen)
    if not built_in:
        OmegaConf.set_struct(config, False)
        config.task["tuned_for"] = dict(the_task.tuned_for)  # not the default task's
    options = dict(tuner_options or {})
    if isinstance(task, Task):
        the_task = copy(task)  # the caller's stays as it is
    if baseline is not None and task is not None:
        the_task.baseline = dict(baseline)
    told = baseline is not None or (
        isinstance(the_task, UserTask) and the_task.baseline is not None
    )
    if told and "start" in config.tuner:
        options.setdefault("start", "baseline")
    _set(config, "tuner", options, f"tuner {tuner!r}")
    config.seed, config.num_envs = _whole("seed", seed), _whole("num_envs", num_envs)
    config.budget = _whole("budget", budget)
    for name, value in (
        ("initial_sigma", initial_sigma),
        ("acceptance_test", acceptance_test),
        ("failure_penalty", failure_penalty),
    ):
        config[name] = _number(name, value)
    config.select = select
    config.initial_samples = (
        None if initial_samples is None else _whole("initial_samples", initial_samples)
    )
    config.common_random_numbers = common_random_numbers or None
    if failure_penalty is not None:
        the_task.failure_penalty = failure_penalty
    every = max(1, config.budget // 10) if eval_every is None else eval_every
    config.eval_every = _whole("eval_every", every)
    config.evaluation.episodes = _whole("episodes", episodes)
    config.evaluation.final_episodes = _whole("final_episodes", final_episodes)
    plain = resolved(config)
    if not isinstance(task, str):
        plain["task"] = _identity(the_task, options_of_task)
    settings = factory.build_settings(plain)
    identified, doubts = with_code(plain, the_task)
    run = Run(
        identity={"task": _name(task, env), "tuner": tuner, "seed": config.seed},
        config=identified,
        doubts=doubts,
        command=sys.argv,
        task=the_task,
        tuner=factory.build_tuner(plain["tuner"], the_task, settings),
        executor=factory.build_executor(plain),
        settings=settings,
        loggers=[] if quiet else [Console(config.budget)],
        quiet=quiet,
    )
    where = Path(folder or tempfile.mkdtemp(prefix="zoac-")).expanduser()
    again = "the same call" if folder else f"the same call with folder={str(where)!r}"
    try:
        result = execute(run, where, again)
    except Interrupted as stopped:
        stopped.result = result_of(stopped.record, the_task.fixed, where, the_task)
        raise
    if not isinstance(task, str) and not (where / TASK).exists():
        keep_task(the_task, where)
    return result_of(result, the_task.fixed, where, the_task)


def _task(
    task: Task | str | None,
    env: EnvSource | None,
    controller: Any,
    space: ParameterSpace | Mapping[str, Any] | None,
    options: Mapping[str, Any],
) -> Task:
    """Return the task to tune."""
    if task is not None:
        given = {"env": env, "controller": controller, "space": space}
        given |= {name: value or None for name, value in options.items() if name != "baseline"}
        given["objective"] = None if options["objective"] == "auto" else options["objective"]
        doubled = [name for name, value in given.items() if value is not None]
        if doubled:
            raise ConfigError(f"give either task or env, controller and space; not {doubled} too")
        return make_task(task) if isinstance(task, str) else task
    if env is None or controller is None or space is None:
        raise ConfigError("tune needs a task, or all of env, controller and space")
    return user_task(env=env, controller=controller, space=space, **options)


def _identity(task: Task, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that tell a task without a YAML file from others, as plain data."""
    told = {
        "space": [str(p) for p in task.space.parameters],
        "fixed": dict(task.fixed),
        "baseline": dict(task.baseline or {}),
        "max_episode_steps": options["max_episode_steps"],
        "plant": dict(options["plant"] or {}),
        "vary": dict(options["vary"] or {}),
        "objective": options["objective"],
    }
    plain: dict[str, Any] = json.loads(schema.json_line(told))
    return {key: value for key, value in plain.items() if value or key == "fixed"}


def _name(task: Task | str | None, env: EnvSource | None) -> str:
    """Return what a task is called in tables: its own name, its class's or its environment's."""
    if task is not None:
        return task if isinstance(task, str) else type(task).__name__
    last = fingerprint.name(env).rpartition(".")[2]
    return re.sub(r"[^\w.-]+", "-", last).strip("-")


def _number(name: str, value: Any) -> float | None:
    if value is not None and not is_number(value):
        raise ConfigError(f"{name}={value!r}: expected a number or None")
    return None if value is None else float(value)


def _whole(name: str, value: Any) -> int:
    """Return a whole number, which may be written 1e4."""
    if not is_number(value) or value % 1 != 0:
        raise ConfigError(f"{name}={value!r}: expected a whole number")
    return int(value)


def _set(
    config: DictConfig,
    where: str,
    options: Mapping[str, Any],
    what: str,
    more: Sequence[str] = (),
) -> None:
    """Set options inside a config node; an unknown one gets the nearest."""
    OmegaConf.set_struct(config, False)
    node = config[where]
    for key, value in options.items():
        if key not in node:
            known = [*(str(k) for k in node if not str(k).startswith("_")), *more]
            raise ConfigError(f"{what} has no option {key!r}; {suggest(key, known)}")
        OmegaConf.update(config, f"{where}.{key}", value)
