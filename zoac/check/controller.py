"""Checks of a controller: what its actions depend on."""

from copy import deepcopy

import numpy as np

from zoac.check.samples import DRAWS, STEPS, Found, draws, segments
from zoac.controllers.stateful_controller import stateful_in
from zoac.core.controller import Memory, Parameters
from zoac.core.segments import Segment
from zoac.rollout.task import Task


def hidden_state(task: Task) -> Found:
    """The controller is a function of parameters, observation and memory alone."""
    episodes = segments(task)
    controller = task.make_controller()
    parameters = _parameters(task, episodes[0])
    memory = controller.init(1)
    stateful = stateful_in(memory)
    for segment in episodes[:2] if stateful else ():
        if not np.array_equal(_replayed(task, segment, memory=memory), segment.commands):
            return False, "an earlier episode shows in its actions; begin anew in reset"
        for one in stateful:
            one.begin()
    # Otherwise the state of a stateful controller cannot be restored between two calls.
    twice = not stateful or task.restore_fault is None
    for observation in episodes[0].observations[:-1]:
        given = observation[None].copy()
        states = [one.state() for one in stateful if twice]
        first, following, _ = controller.act(
            parameters, given, memory if stateful else deepcopy(dict(memory))
        )
        first = np.array(first)  # the next call may change it
        if not np.array_equal(given[0], observation):
            return False, "it changes the observation that it is given; copy it first"
        if twice:
            for one, state in zip(stateful, states, strict=True):
                one.restore(state)
            second, _, _ = controller.act(
                parameters, observation[None].copy(), memory if stateful else deepcopy(dict(memory))
            )
        if twice and not np.array_equal(first, second):
            return False, (
                "the same input gave two different actions: it has hidden state. Make it an "
                "object with act and reset that keeps state in its attributes"
            )
        memory = following
    for segment in episodes[:2]:
        if not np.array_equal(_replayed(task, segment), segment.commands):
            return False, "a new controller acts otherwise on the same observations"
    return True, "nothing lasts but its memory"


def dead_parameters(task: Task) -> Found:
    """Every parameter changes the action somewhere."""
    episodes = segments(task)
    alive = dict.fromkeys(task.space.names, False)
    others = _alternatives(task)
    for segment in episodes:
        base = _replayed(task, segment)
        for name, values in others.items():
            for other in values:
                if not alive[name]:
                    changed = _replayed(task, segment, {name: np.array([other])})
                    alive[name] = not np.array_equal(base, changed)
    dead = [name for name, lives in alive.items() if not lives]
    if dead:
        looked = f"in {DRAWS} episodes of {STEPS} steps"
        return False, f"no effect on any action {looked}: {', '.join(dead)}"
    return True, f"all {len(alive)} change the action"


def _alternatives(task: Task) -> dict[str, list[float]]:
    """Return values to try for each parameter: both ends, and some between; of choices, all."""
    d = task.space.dimension
    x = np.concatenate([draws(task, 2), [np.full(d, -1.0), np.full(d, 1.0)], np.eye(d)])
    columns = task.space.values(x).T.tolist()
    return {n: sorted(set(column)) for n, column in zip(task.space.names, columns, strict=True)}


def _parameters(task: Task, segment: Segment) -> Parameters:
    values = task.space.values(segment.proposal.x)
    return {name: value[None] for name, value in zip(task.space.names, values, strict=True)}


def _replayed(
    task: Task,
    segment: Segment,
    changed: Parameters | None = None,
    memory: Memory | None = None,
) -> np.ndarray:
    """Return the actions (T, m) of a controller on the observations of a segment.

    Some parameters may have other values; without a memory, a fresh one begins.
    """
    parameters = {**_parameters(task, segment), **(changed or {})}
    controller = task.make_controller()
    memory, actions = controller.init(1) if memory is None else memory, []
    for observation in segment.observations[:-1]:
        action, memory, _ = controller.act(parameters, observation[None].copy(), memory)
        actions.append(np.array(action, dtype=np.float64)[0])
    return np.stack(actions)
