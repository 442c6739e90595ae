"""Is a task fit to be tuned? `python -m zoac.check task=my_task [task.option=value ...]`

One verdict a line; exit code 1 if any is bad. It works on a user's task from their own folder.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from zoac.cli.pipes import reader_may_leave
from zoac.controllers.live_controller import live_in
from zoac.core.controller import Memory
from zoac.core.errors import ZoacError
from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.probe import first_difference, played
from zoac.rollout.spec_check import baseline_specs
from zoac.rollout.task import Task

STEPS = 120
"""Steps of an episode that are looked at."""

DRAWS = 16
"""Parameter sets that are tried."""

SLOW = 0.1
"""A step that takes longer [s] is too slow: 50,000 of them would take more than an hour."""


class Verdict(NamedTuple):
    """What one check found."""

    name: str
    good: bool
    text: str

    def __str__(self) -> str:
        return f"{'ok  ' if self.good else 'FAIL'} {self.name}: {self.text}"


def check(task: Task) -> Iterator[Verdict]:
    """Yield one verdict for each check of `task`."""
    checks = {**CHECKS, "specs": baseline_specs} if task.specs else CHECKS
    for name, body in checks.items():
        try:
            yield Verdict(name, *body(task))
        except ZoacError as error:
            yield Verdict(name, False, str(error))
        except Exception as error:  # whatever a user's environment raises
            yield Verdict(name, False, f"raised {type(error).__name__}: {error}")


Found = tuple[bool, str]


def round_trip(task: Task) -> Found:
    """Parameters mapped to the box and back are the same."""
    space = task.space
    x = _draws(task, 200)
    values = space.values(x)
    scale = np.abs(values).max(axis=0) + 1e-300
    back = space.values(np.stack([space.normalise(space.named(row)) for row in x]))
    error = np.abs(back - values) / scale
    worst = int(error.max(axis=0).argmax())
    if error.max() > 1e-9:
        return False, f"{space.names[worst]!r} comes back {error.max():.1e} away"
    text = f"{len(space.names)} parameters, {space.dimension} coordinates"
    if task.baseline is None:
        return True, text
    space.normalise(task.baseline)  # says which lies outside
    return True, f"{text}, baseline values inside"


def shapes(task: Task) -> Found:
    """Observations, actions and costs have the promised shapes and are finite."""
    env = task.make_env(1)
    observations, _ = env.reset(seed=[0])
    expected = (1, *(env.single_observation_space.shape or ()))
    actions = env.single_action_space.shape
    env.close()
    if observations.shape != expected:
        return False, f"observations are {observations.shape}, the space says {expected}"
    for segment in _segments(task):  # the engine refuses actions that cannot be used
        for what, array in (("observation", segment.observations), ("cost", segment.costs)):
            bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
            if bad.size:
                at = _told(task.space.named(segment.proposal.x))
                return False, f"the {what} of step {bad[0]} is not finite, parameters: {at}"
    return True, f"observations {expected[1:]}, actions {actions}, all finite"


def episodes_end(task: Task) -> Found:
    """There is a time limit."""
    steps, source = task.horizon
    if source == "termination":
        return False, (
            f"{steps} steps in the longest of a few, but nothing ends an episode for certain; give "
            "max_episode_steps"
        )
    return True, f"after {steps} steps at the latest"


def determinism(task: Task) -> Found:
    """The same seed and actions give the same episode."""
    actions = _segments(task)[0].commands
    env, twin = task.make_env(1), task.make_env(1)
    try:
        one, other = played(env, actions, 11), played(twin, actions, 11)
        if (step := first_difference(one, other)) is not None:
            return False, (
                f"two environments with the same seed differ at step {step}; draw random numbers "
                "from self.np_random after super().reset(seed=seed), nowhere else"
            )
        played(env, actions, 12)
        if (step := first_difference(one, played(env, actions, 11))) is not None:
            return False, f"an earlier episode shows at step {step} of the next; reset all in reset"
    finally:
        env.close()
        twin.close()
    return True, "the same seed gives the same episode, also after another one"


def env_state(task: Task) -> Found:
    """A restored environment goes on as it would have."""
    fault = task.save_fault
    return fault is None, fault or "goes on to the same bits"


def hidden_state(task: Task) -> Found:
    """The controller is a function of parameters, observation and memory alone."""
    segments = _segments(task)
    controller = task.make_controller()
    parameters = {name: v[None] for name, v in zip(*_named(task, segments[0]), strict=True)}
    memory = controller.init(1)
    live = live_in(memory)
    for segment in segments[:2] if live else ():
        if not np.array_equal(_replayed(task, segment, None, memory), segment.commands):
            return False, "an earlier episode shows in its actions; begin anew in reset"
        for one in live:
            one.begin()
    twice = (
        not live or task.restore_fault is None
    )  # else its state cannot be restored between two calls
    for observation in segments[0].observations[:-1]:
        given = observation[None].copy()
        states = [one.state() for one in live if twice]
        first, following, _ = controller.act(parameters, given, memory if live else _deep(memory))
        if not np.array_equal(given[0], observation):
            return False, "it changes the observation that it is given; copy it first"
        if twice:
            for one, state in zip(live, states, strict=True):
                one.restore(state)
            second, _, _ = controller.act(
                parameters, observation[None].copy(), memory if live else _deep(memory)
            )
        if twice and not np.array_equal(first, second):
            return False, (
                "the same input gave two different actions: it has hidden state. Make it an "
                "object with act and reset that keeps state in its attributes"
            )
        memory = following
    for segment in segments[:2]:
        if not np.array_equal(_replayed(task, segment), segment.commands):
            return False, "a new controller acts otherwise on the same observations"
    return True, "nothing lasts but its memory"


def dead_parameters(task: Task) -> Found:
    """Every parameter changes the action somewhere."""
    segments = _segments(task)
    alive = dict.fromkeys(task.space.names, False)
    others = _alternatives(task)
    for segment in segments:
        base = _replayed(task, segment)
        for i, name in enumerate(task.space.names):
            for other in others[i]:
                if not alive[name]:
                    changed = _replayed(task, segment, (i, other))
                    alive[name] = not np.array_equal(base, changed)
    dead = [name for name, lives in alive.items() if not lives]
    if dead:
        looked = f"in {DRAWS} episodes of {STEPS} steps"
        return False, f"no effect on any action {looked}: {', '.join(dead)}"
    return True, f"all {len(alive)} change the action"


def time_per_step(task: Task) -> Found:
    """A step is not too slow to tune on."""
    group = RolloutEngine(task, [0], [3])
    steps, x = 0, _draws(task, 1)[0]
    try:
        group.rollout([Proposal(x, 0, horizon=1)])  # what is compiled or loaded at first
        begun = time.perf_counter()
        while time.perf_counter() - begun < 0.3:
            (segment,) = group.rollout([Proposal(x, 0, horizon=5)])
            steps += segment.length
        seconds = (time.perf_counter() - begun) / steps
    finally:
        group.close()
    whole = _for_people(50_000 * seconds)
    text = f"{seconds * 1e3:.3g} ms; 50,000 steps in one environment take {whole}"
    if seconds > SLOW:
        return False, f"{text}; more than {SLOW * 1e3:g} ms a step is too slow to tune on"
    return True, text


CHECKS: dict[str, Callable[[Task], Found]] = {
    "transform round trip": round_trip,
    "shapes and bounds": shapes,
    "episodes end": episodes_end,
    "seeded determinism": determinism,
    "saved and restored": env_state,
    "hidden state in the controller": hidden_state,
    "dead parameters": dead_parameters,
    "time per step": time_per_step,
}


def _draws(task: Task, n: int, first: int = 0) -> np.ndarray:
    """Return n mapped parameter sets (n, d), always the same ones."""
    return np.random.default_rng(first).uniform(-0.9, 0.9, (n, task.space.dimension))


def _alternatives(task: Task) -> list[list[float]]:
    """Return values to try for each parameter: both ends, and some between; of choices, all."""
    d = task.space.dimension
    x = np.concatenate([_draws(task, 2), [np.full(d, -1.0), np.full(d, 1.0)], np.eye(d)])
    return [sorted(set(column)) for column in task.space.values(x).T.tolist()]


def _segments(task: Task) -> list[Segment]:
    """Return the beginnings of episodes under different parameters, the baseline values first."""
    x = _draws(task, DRAWS)
    if task.baseline is not None:
        x[0] = task.space.normalise(task.baseline)
    group = RolloutEngine(task, range(DRAWS), list(range(100, 100 + DRAWS)))
    try:
        return group.rollout([Proposal(x[k], k, horizon=STEPS) for k in range(DRAWS)])
    finally:
        group.close()


def _named(task: Task, segment: Segment) -> tuple[tuple[str, ...], np.ndarray]:
    return task.space.names, task.space.values(segment.proposal.x)


def _replayed(
    task: Task,
    segment: Segment,
    change: tuple[int, float] | None = None,
    memory: Memory | None = None,
) -> np.ndarray:
    """Return the actions (T, m) of a controller on the observations of a segment.

    Args:
        task: Gives the controller.
        segment: Whose observations and parameters.
        change: The index of a parameter and another value for it.
        memory: The controller's at the start of the episode; None: a fresh one.
    """
    names, values = _named(task, segment)
    if change is not None:
        values = values.copy()
        values[change[0]] = change[1]
    parameters = {name: value[None] for name, value in zip(names, values, strict=True)}
    controller = task.make_controller()
    memory, actions = controller.init(1) if memory is None else memory, []
    for observation in segment.observations[:-1]:
        action, memory, _ = controller.act(parameters, observation[None].copy(), memory)
        actions.append(np.asarray(action, dtype=np.float64)[0])
    return np.stack(actions)


def _deep(memory: Memory) -> Memory:
    return {name: deepcopy(rows) for name, rows in memory.items()}


def _told(parameters: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name}={value:.4g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in parameters.items()
    )


def _for_people(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


@reader_may_leave()
def main(arguments: Sequence[str] | None = None) -> int:
    """Check the task that the overrides name; return the exit code."""
    from zoac.config.compose import compose_config, resolved
    from zoac.config.factory import build_task

    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__.strip())
        return 0 if arguments else 1
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        task = build_task(resolved(compose_config(arguments)))
    except ZoacError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    good = True
    for verdict in check(task):
        print(verdict, flush=True)
        good &= verdict.good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
