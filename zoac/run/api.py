"""For people who write Python, not YAML."""

import inspect
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from zoac.config import factory
from zoac.config.auto_tuner import budget_of, tuner_for
from zoac.config.files import AUTO, configuration
from zoac.config.settings import Evaluation, RunSettings, Settings, converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, Interrupted, suggest
from zoac.core.measures import Constraint, Metric
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number
from zoac.envs.plant_numbers import Bounds
from zoac.envs.single_env import EnvSource
from zoac.rollout.task import Task
from zoac.runs.loggers.callback import Callback, Callbacks
from zoac.runs.loggers.console import Console
from zoac.runs.result import Result, keep_task, result_of
from zoac.runs.schema import TASK
from zoac.runs.training.identity import settings_of_task
from zoac.runs.training.lifecycle import Run, execute
from zoac.specs.spec import Spec
from zoac.study.carry_out import from_tune
from zoac.tasks.given_task import given_task, is_by_name, name_of, set_options
from zoac.tasks.given_task import make_task as make_task
from zoac.tasks.user_task import UserTask

OF_USER = ("env", "controller", "space")
OF_TASK = (
    "baseline", "metrics", "constraints", "max_episode_steps", "plant", "vary", "objective",
    "signals", "sample_time", "specs",
)  # fmt: skip
"""Arguments of `tune` that say what is tuned."""

OTHER_SETTINGS = tuple(
    f.name
    for f in fields(Settings)
    if f.name not in ("seed", "budget", "experiments", "eval_every", "evaluation")
)
"""What `tune` takes as `**settings`."""


def tune(
    *,
    task: Task | str | None = None,
    env: EnvSource | None = None,
    controller: Any = None,
    space: ParameterSpace | Mapping[str, Any] | None = None,
    tuner: str = AUTO,
    budget: int | None = None,
    experiments: int | None = None,
    seed: int = 0,
    baseline: Mapping[str, Any] | None = None,
    metrics: Sequence[Metric] | Mapping[str, Any] = (),
    constraints: Sequence[Constraint] | Mapping[str, Any] = (),
    max_episode_steps: int | None = None,
    plant: Mapping[str, float] | None = None,
    vary: Mapping[str, Bounds] | None = None,
    objective: str | Spec | Sequence[Spec] = "auto",
    signals: Mapping[str, Any] | None = None,
    sample_time: float | None = None,
    specs: Sequence[Spec] = (),
    tuner_options: Mapping[str, Any] | None = None,
    executor: str = "auto",
    eval_every: int | None = None,
    episodes: int = 10,
    final_episodes: int = 20,
    folder: str | Path | None = None,
    resume: str = "auto",
    quiet: bool = False,
    callbacks: Sequence[Callback] = (),
    cost: Callable[[dict[str, Any]], Any] | None = None,
    workers: int | None = None,
    **settings: Any,
) -> Result:
    """Tune a controller in a simulator; return the best parameters found.

        result = zoac.tune(env="Pendulum-v1", controller=act, space={"kp": (0, 20), "kd": (0, 5)})

    Args:
        task: A `Task`, or the name of a built-in one. Without it, give `env`, `controller` and
            `space`. `signals`, `specs` and an `objective` of specs work with any task.
        env: A Gymnasium id, a function that makes an environment, or an environment.
        controller: `act(params, obs)`, with params {name: number} and obs an array. Or an object
            with this method and `reset()`, which begins an episode; it may have a memory.
        space: Bounds by name: `(low, high)`, `(low, high, "log")`, a dict with `low`, `high`,
            `scale`, `unit`, `baseline`; `(low, high, "integer")`; a dict with `choices`; or one
            number, which is fixed.
        tuner: Name of a tuner's config: "zoac", "bo", ...; "auto": see `zoac.config.auto_tuner`.
        budget: Environment steps for tuning; 50,000 by default.
        experiments: Instead of a budget: episodes of full length; or calls of `cost`, 60 by
            default.
        seed: Seed of all random numbers.
        baseline: Values in use today, with which the result is compared. A tuner may begin there.
        metrics: Numbers to report beside the cost: `Metric`s, or functions of a segment by name.
        constraints: Limits that must hold at every step: `Constraint`s, or functions of a segment
            by name; see `zoac.rollout.constraints`.
        max_episode_steps: Cut episodes here; needed if the environment does not end by itself.
        plant: Numbers of the environment to set, by attribute: `{"m": 1.2}`.
        vary: Ranges from which every episode, of tuning and evaluation, draws such numbers:
            `{"m": (0.8, 1.2)}`.
        objective: What is minimised. "reward": the negative reward; "cost": `info["cost"]`;
            "info:<key>": another number of info; "auto": the negative reward, refused if
            `info["cost"]` differs from it. Or a spec without a limit, such as
            `zoac.specs.itae("y", "r")`, or several, whose weighted sum is minimised.
        signals: Names of the numbers of an episode, for specs and figures:
            `{"y": zoac.observation(0), "r": 1.0, "u": zoac.action(0)}`, or functions of a segment.
        sample_time: Seconds of a step; None: the environment's attribute `sample_time` or `dt`, or
            what its metadata say.
        specs: Requirements on whole episodes, such as `zoac.specs.overshoot("y", "r", max=0.05)`.
            Parameters that keep them rank before all that do not; held-out episodes choose the
            answer, see `zoac.algorithm.strategies.held_specs`.
        tuner_options: By name, such as {"exploration": {"sigma": 0.05}}.
        executor: "auto" (worker processes where steps are slow enough to pay), "serial" or
            "process".
        eval_every: Steps between evaluations; None: a tenth of the budget.
        episodes: Evaluation episodes during tuning.
        final_episodes: Evaluation episodes of the final figure.
        folder: Run folder; None: a new temporary one.
        resume: What happens to a run in that folder. "auto": it continues, or is returned if it is
            finished; refused if settings or code differ. "never": refused. "overwrite": deleted.
        quiet: Print nothing.
        callbacks: Objects that follow the run and may stop it; see `zoac.Callback`.
        cost: Instead of an environment: a function of {name: value} that makes an experiment and
            returns its cost, or a dict of `cost`, `metrics` and `constraints`; or `zoac.program`.
            The run is then a `zoac.Study`, whose options apply; `constraints` are limits by name,
            and the tuner "auto" is chosen as `zoac.Study` does.
        workers: Number of calls of `cost` at a time, in threads; 1 by default.
        settings: `num_envs`, `initial_sigma`, `acceptance_test`, `select`, `initial_samples`,
            `common_random_numbers`, `failure_penalty`, `step_timeout`, ...: any other of
            `zoac.config.settings.Settings`, which says what each does.

    Raises:
        Interrupted: If Ctrl-C or a SIGTERM stopped the run, which ends after its iteration with a
            checkpoint. The error's `result` is the recommendation so far; its message says how
            the run goes on.
        ConfigError: If something given cannot be used.
        CallbackError: If a callback raises.
        ControllerError: If the controller raises or returns what is not a finite action, and
            there is no `failure_penalty`.
        EnvironmentFailure: If the environment raises or returns what is not finite, likewise.
        NothingWorksError: If every episode fails, or each of the first ten calls of `cost`.
        RunFolderError: If `folder` holds another run.
    """
    arguments = locals()
    named = ("tuner", "tuner_options", "executor", "folder")
    check_arguments(tune, {name: arguments[name] for name in named}, "")
    for name, value in {**arguments, **settings}.items():
        if isinstance(value, np.ndarray):
            raise ConfigError(
                f"{name}: expected no array, got one of shape {value.shape}; {name}.tolist() makes "
                "a list or a number of it"
            )
    if cost is not None:
        return from_tune(arguments, inspect.signature(tune).parameters)
    if workers is not None:
        raise ConfigError("workers belong to cost=..., a function to minimise")
    if None not in (budget, experiments):
        raise ConfigError("give either budget or experiments, not both")
    check_arguments(RunSettings, {"resume": resume}, "")
    followers = Callbacks(callbacks)
    of_user, of_task = ({name: arguments[name] for name in names} for names in (OF_USER, OF_TASK))
    the_task = given_task(task, of_user, of_task)
    budget = budget_of(experiments, 50_000 if budget is None else budget, the_task)
    chosen = tuner_for(the_task) if tuner == AUTO else None
    if chosen is not None:
        tuner, settings = chosen.tuner, {**chosen.settings, **settings}
    config = configuration(
        task=task if isinstance(task, str) else None,
        tuner=tuner,
        executor=executor,
        preset=f"{the_task.preset}/{tuner}",
    )
    options = dict(tuner_options or {})
    strategies = options.pop("strategies", None)  # no option of any one tuner
    set_options(config["tuner"], options, f"tuner {tuner!r}")
    if strategies is not None:
        config["tuner"]["strategies"] = strategies
    told = baseline is not None or (
        isinstance(the_task, UserTask) and the_task.baseline is not None
    )
    if told and "start" in config["tuner"] and "start" not in options:
        config["tuner"]["start"] = "baseline"
    for name in settings:
        if name not in OTHER_SETTINGS:
            known = [*list(inspect.signature(tune).parameters)[:-1], *OTHER_SETTINGS]
            raise ConfigError(f"zoac.tune has no option {name!r}; {suggest(name, known)}")
    if eval_every is None and is_number(budget):
        eval_every = int(max(1, budget // 10))
    given = {
        "seed": seed, "budget": budget, "experiments": experiments, "eval_every": eval_every,
        **settings,
    }  # fmt: skip
    config |= converted(Settings, given)
    config["evaluation"] |= converted(
        Evaluation, {"episodes": episodes, "final_episodes": final_episodes}
    )
    config["resume"] = resume
    by_name = is_by_name(task, of_task)
    if not by_name:
        config["task"] = settings_of_task(the_task, of_task, config.get("task", {}))
    factory.with_failures(the_task, config)
    where = Path(folder or tempfile.mkdtemp(prefix="zoac-")).expanduser()
    run = Run(
        config,
        the_task,
        identity={"task": name_of(task, env), "tuner": tuner, "seed": config["seed"]},
        chosen=chosen,
        command=sys.argv,
        loggers=[] if quiet else [Console(config["budget"], where)],
        quiet=quiet,
        callbacks=followers,
    )
    again = "the same call" if folder else f"the same call with folder={str(where)!r}"
    try:
        result = execute(run, where, again)
    except Interrupted as stopped:
        stopped.result = result_of(stopped.record, the_task.fixed, where, the_task)
        raise
    if not by_name and not (where / TASK).exists():
        keep_task(the_task, where)
    return result_of(result, the_task.fixed, where, the_task)
