"""Checks of a controller: what its actions depend on."""

import numpy as np

from zoac.check.samples import DRAWS, STEPS, Found, draws, segments
from zoac.controllers.stateful_controller import stateful_in
from zoac.core.controller import Controller, Memory, Parameters
from zoac.core.segments import Segment
from zoac.rollout.task import Task


def hidden_state(task: Task) -> Found:
    """The controller is a function of parameters, observation and memory alone."""
    controller = task.make_controller()
    memory = controller.init(1)
    stateful = stateful_in(memory)
    for segment in segments(task)[:2] * 2:
        seen = segment.observations[:-1].copy()
        actions = _replayed(task, segment, {}, controller, memory if stateful else None, seen)
        if not np.array_equal(seen, segment.observations[:-1]):
            return False, "it changes the observation that it is given; copy it first"
        if stateful and not np.array_equal(actions, segment.commands):
            return False, "an earlier episode shows in its actions; begin anew in reset"
        if not np.array_equal(actions, segment.commands):
            return False, (
                "the same input gave two different actions: it has hidden state. Make it an "
                "object with act and reset that keeps state in its attributes"
            )
        for one in stateful:
            one.begin()
    return True, "nothing lasts but its memory"


def dead_parameters(task: Task) -> Found:
    """Every parameter changes the action somewhere."""
    episodes = segments(task)
    alive = dict.fromkeys(task.space.names, False)
    others = _alternatives(task)
    for segment in episodes:
        base = _replayed(task, segment, {})
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


def _replayed(
    task: Task,
    segment: Segment,
    changed: Parameters,
    controller: Controller | None = None,
    memory: Memory | None = None,
    observations: np.ndarray | None = None,
) -> np.ndarray:
    """Return the actions (T, m) of a controller on the observations of a segment.

    Some parameters may have other values. By default the controller and its memory are new, and it
    is given copies of the observations.
    """
    values = task.space.values(segment.proposal.x)
    parameters = dict(zip(task.space.names, values[:, None], strict=True))
    parameters.update(changed)
    controller = controller or task.make_controller()
    memory, actions = controller.init(1) if memory is None else memory, []
    for observation in segment.observations[:-1].copy() if observations is None else observations:
        action, memory, _ = controller.act(parameters, observation[None], memory)
        actions.append(np.array(action, dtype=np.float64)[0])
    return np.stack(actions)
