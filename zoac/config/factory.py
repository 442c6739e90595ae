"""From a checked configuration to the objects of a run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

from zoac.algorithm.strategies.acceptance_test import AcceptanceTest
from zoac.algorithm.strategies.around_baseline import around_baseline
from zoac.algorithm.strategies.base import Begin, StartSearch, TunerStrategy
from zoac.algorithm.strategies.final_selection import best_evaluated
from zoac.algorithm.strategies.held_specs import HeldSpecs
from zoac.algorithm.strategies.initial_design import CommonRandomNumbers, InitialDesign
from zoac.config.named_code import kinds_of, locate_maker
from zoac.config.settings import Settings
from zoac.config.validate import TARGET, check_arguments, with_groups
from zoac.core.errors import ConfigError, suggest
from zoac.core.tuner import Problem, Tuner
from zoac.rollout.executors.base import Executor
from zoac.rollout.executors.process import Process
from zoac.rollout.horizon import horizon_of
from zoac.rollout.task import Task
from zoac.runs.loggers.base import Logger
from zoac.specs.judge import EPISODES_ONLY


def build(node: Mapping[str, Any], where: str, kind: type, **provided: Any) -> Any:
    """Check a config node against its `_target_` and call that, inner nodes first.

    Args:
        node: The node, resolved; messages call it `where`.
        kind: What is built: a class or a protocol.
        provided: Arguments of the target that the node does not hold.

    Raises:
        ConfigError: Naming every fault of the node. Nothing is called if there is one.
    """
    return _checked(node, where, (kind,), provided)()


def _checked(
    node: Mapping[str, Any], where: str, kinds: tuple[type, ...], provided: Mapping[str, Any]
) -> Callable[[], Any]:
    """Return the call that a node stands for, after all checks of it and of those inside it."""
    if TARGET not in node:
        raise ConfigError(f"{where}: there is no _target_, the class that this node configures")
    if not isinstance(node[TARGET], str):
        raise ConfigError(f"{where}.{TARGET}: expected a dotted path, got {node[TARGET]!r}")
    target = locate_maker(node[TARGET], kinds, f"{where}.{TARGET}")
    given = {k: v for k, v in node.items() if not k.startswith("_")}
    hints = check_arguments(target, given, where, tuple(provided))
    inner = {}
    for name, value in given.items():
        if isinstance(value, Mapping) and TARGET in value:
            if not (taken := kinds_of(hints.get(name))):
                raise ConfigError(
                    f"{where}.{name}: a node with a _target_, and {node[TARGET]} does not say what "
                    f"it takes; annotate its argument {name!r} with a class"
                )
            inner[name] = _checked(value, f"{where}.{name}", taken, {})

    def call() -> Any:
        made = {name: make() for name, make in inner.items()}
        return target(**with_groups(given, hints) | made, **provided)

    return call


PROGRAM = "zoac.study.program.ProgramTask"
"""The `_target_` of a task without an environment: experiments of an external program."""


def build_task(config: Mapping[str, Any]) -> Task:
    """Return the task of a resolved configuration.

    Raises:
        ConfigError: If it cannot be made, or has no environment.
    """
    if config["task"].get(TARGET) == PROGRAM:
        raise ConfigError(
            "task=program has no environment; experiments of a program are made by "
            "python -m zoac.run and zoac.tune(cost=zoac.program(...)) alone"
        )
    task = build(config["task"], "task", Task)
    return with_failures(task, config)


def with_failures(task: Task, config: Mapping[str, Any]) -> Task:
    """Return the task, told what a failure is and costs where the run's settings say so."""
    for name in ("failure_penalty", "step_timeout"):
        if (value := config.get(name)) is not None:
            setattr(task, name, value)
    return task


def build_settings(config: Mapping[str, Any]) -> Settings:
    """Return the settings of a resolved configuration.

    Raises:
        ConfigError: If one is of the wrong type or out of its bounds.
    """
    given = {f.name: config[f.name] for f in fields(Settings) if f.name in config}
    return Settings(**with_groups(given, check_arguments(Settings, given, "")))


def build_tuner(node: Mapping[str, Any], task: Task, settings: Settings) -> Tuner:
    """Return the tuner of the config node `tuner`, for `task`."""
    env = task.make_env(1)
    shape = env.single_observation_space.shape
    assert shape is not None
    baseline = None if task.baseline is None else task.space.normalise(task.baseline)
    whole = Problem(
        space=task.space,
        observation_size=shape[0],
        num_envs=settings.num_envs,
        budget=settings.budget,
        max_episode_steps=horizon_of(task).steps,
        seed=settings.seed,
        start=baseline,
        supports_snapshots=task.restore_fault is None,
        baseline=baseline,
        shortest_horizon=task.shortest_horizon,
    )
    env.close()
    if task.specs:
        _refuse_parts_of_episodes(node)
    hard = any(spec.hard and not spec.of_loop for spec in task.specs)
    of_task = [HeldSpecs] if hard and not task.strict else []
    return build_tuner_for(node, whole, settings, of_task)


def _refuse_parts_of_episodes(node: Mapping[str, Any]) -> None:
    """Raise if a tuner asks for parts of episodes, over which specs cannot be judged."""
    named = {f"tuner.strategies.{name}": part for name, part in _named_strategies(node).items()}
    for where, part in {"tuner": node, **named}.items():
        kind = _class_of(part, where)
        if not kind.whole_episodes:
            who = f"tuner: {kind.display_name or kind.__name__}" if part is node else where
            raise ConfigError(f"{who} sees parts of episodes, and {EPISODES_ONLY}")


def build_tuner_for(
    node: Mapping[str, Any],
    problem: Problem,
    settings: Settings,
    of_task: Sequence[Callable[..., Tuner]] = (),
) -> Tuner:
    """Return the tuner of a config node, in the strategies that are asked for, for a problem.

    Those that the task asks for, `of_task`, see the points of the search alone, and their answer is
    what an acceptance test tests.

    Raises:
        ConfigError: If a strategy is unknown, or does not go with the tuner or another strategy.
    """
    if settings.initial_sigma is not None:
        node = around_baseline(node, settings.initial_sigma)
    around: list[Callable[..., Tuner]] = []  # from the outside in
    if settings.acceptance_test is not None:
        around.append(partial(AcceptanceTest, fraction=settings.acceptance_test))
    if settings.select == "best_evaluated":
        around.append(partial(best_evaluated, every=settings.eval_every))
    named = _strategies_of(node, settings)
    around += [partial(_build_strategy, name, part) for name, part in named.items()]
    around += of_task
    if settings.common_random_numbers:
        around.append(CommonRandomNumbers)
    if settings.initial_samples is not None:
        around.append(partial(InitialDesign, count=settings.initial_samples))
    node = {key: value for key, value in node.items() if key != "strategies"}
    node = _begun_at_start(node, _start_searches(named, settings), settings)

    def make(problem: Problem) -> Tuner:
        return build(node, "tuner", Tuner, problem=problem)

    for strategy in reversed(around):
        make = partial(strategy, begin=make)
    return make(problem)


STRATEGIES = {
    "successive_halving": "zoac.algorithm.strategies.successive_halving.SuccessiveHalving",
    "final_selection": "zoac.algorithm.strategies.final_selection.FinalSelection",
}
"""Strategies that a tuner's option `strategies` knows by name; others have a setting of the run."""


def _named_strategies(node: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the nodes of `tuner.strategies` by name, the first the outermost."""
    named = node.get("strategies") or {}
    if not isinstance(named, Mapping):
        raise ConfigError(
            f"tuner.strategies={named!r}: expected options by name of a strategy, such as "
            "{final_selection: {candidates: 5}}"
        )
    nodes = {}
    for name, options in named.items():
        if not isinstance(options or {}, Mapping):
            raise ConfigError(
                f"tuner.strategies.{name}={options!r}: expected its options by name, such as "
                f"{{{name}: {{fraction: 0.2}}}}; {{}} for their defaults"
            )
        target = {TARGET: STRATEGIES[name]} if name in STRATEGIES else {}
        nodes[name] = {**target, **(options or {})}
        if TARGET not in nodes[name]:
            raise ConfigError(f"unknown tuner.strategies.{name}; {suggest(name, list(STRATEGIES))}")
    return nodes


def _strategies_of(node: Mapping[str, Any], settings: Settings) -> dict[str, dict[str, Any]]:
    """Return those of a tuner's node that a run has, by name.

    A run that says where to begin needs no successive halving, and one that says how its answer is
    selected no final selection. Otherwise the tuner's own start takes part in the halving.
    """
    named = _named_strategies(node)
    if settings.select == "best_evaluated":
        named.pop("final_selection", None)
    if settings.initial_sigma is not None or settings.initial_samples is not None:
        named.pop("successive_halving", None)
    elif "successive_halving" in named and "start" in node:
        start = "baseline" if node["start"] == "baseline" else "random"
        named["successive_halving"] = {"start": start, **named["successive_halving"]}
    return named


def _build_strategy(name: str, node: Mapping[str, Any], problem: Problem, begin: Begin) -> Tuner:
    where = f"tuner.strategies.{name}"
    return build(node, where, TunerStrategy, problem=problem, begin=begin)


def _start_searches(named: Mapping[str, Mapping[str, Any]], settings: Settings) -> list[str]:
    """Return what looks for a start, as the user wrote it."""
    found = [
        where
        for name, node in named.items()
        if issubclass(_class_of(node, where := f"tuner.strategies.{name}"), StartSearch)
    ]
    if settings.initial_samples is not None:
        found.append(f"initial_samples={settings.initial_samples}")
    return found


def _class_of(node: Mapping[str, Any], where: str) -> type[Tuner]:
    made_by: Any = locate_maker(node[TARGET], (Tuner,), f"{where}.{TARGET}")
    return made_by if isinstance(made_by, type) else Tuner


def _begun_at_start(
    node: dict[str, Any], searches: Sequence[str], settings: Settings
) -> dict[str, Any]:
    """Return a tuner's node that begins where another found a start, if one looks for it."""
    if not searches:
        return node
    if len(searches) > 1:
        raise ConfigError(f"{' and '.join(searches)}: each looks for a start; choose one of them")
    if settings.initial_sigma is not None:
        raise ConfigError(f"{searches[0]}: it looks for a start, and initial_sigma gives one")
    if "start" not in node:
        raise ConfigError(f"{searches[0]}: it looks for a start, and this tuner takes none")
    return {**node, "start": "baseline"}


def baseline_use(node: Mapping[str, Any], task: Task, settings: Settings) -> dict[str, str]:
    """Say what a run does with the baseline values, for its first lines; {} if there are none."""
    if task.baseline is None:
        return {}
    begins = settings.initial_sigma is not None or node.get("start") == "baseline"
    named = _strategies_of(node, settings)
    halved = named.pop("successive_halving", None) or node.get("halving_fraction")
    if not begins or _start_searches(named, settings):
        told = "compared with the answer; the search does not begin there"
        more = " (with tuner.start=baseline it does)" if "start" in node else ""
    else:
        told = "the search begins there"
        halved = halved and settings.initial_sigma is None
        more = ", if they win against random points" if halved else ""
    return {"baseline values": told + more}


def build_executor(config: Mapping[str, Any]) -> Executor:
    """Return the executor of a resolved configuration, not yet started."""
    executor: Executor = build(config["executor"], "executor", Executor)
    if (seconds := config.get("step_timeout")) is not None and not isinstance(executor, Process):
        raise ConfigError(
            f"step_timeout={seconds:g}: executor={type(executor).__name__.lower()} cannot end a "
            "step that does not return; choose executor=process"
        )
    return executor


def build_loggers(config: Mapping[str, Any]) -> list[Logger]:
    """Return the loggers of a resolved configuration."""
    return [build(node, f"logger.{name}", Logger) for name, node in config["logger"].items()]
