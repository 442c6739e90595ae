"""Checks of an environment, its parameters, its costs and its specs."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from zoac.check.samples import Found, draws, segments
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.evaluation import evaluation_proposals
from zoac.rollout.horizon import horizon_of
from zoac.rollout.probe import first_difference, played
from zoac.rollout.task import Task
from zoac.specs.verdict import over_episodes

SLOW = 0.1
"""A step that takes longer [s] is too slow: 50,000 of them would take more than an hour."""

EPISODES = 5
"""Evaluation episodes for the specs, the first of a run's."""


def round_trip(task: Task) -> Found:
    """Parameters mapped to the box and back are the same."""
    space = task.space
    x = draws(task, 200)
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
    for segment in segments(task):  # the engine refuses actions that cannot be used
        for what, array in (("observation", segment.observations), ("cost", segment.costs)):
            bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
            if bad.size:
                at = _told(task.space.named(segment.proposal.x))
                return False, f"the {what} of step {bad[0]} is not finite, parameters: {at}"
    return True, f"observations {expected[1:]}, actions {actions}, all finite"


def episodes_end(task: Task) -> Found:
    """There is a time limit."""
    steps, source = horizon_of(task)
    if source == "termination":
        return False, (
            f"{steps} steps in the longest of a few, but nothing ends an episode for certain; give "
            "max_episode_steps"
        )
    return True, f"after {steps} steps at the latest"


def determinism(task: Task) -> Found:
    """The same seed and actions give the same episode."""
    actions = segments(task)[0].commands
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
    return fault is None, fault or "continues as if it had not been saved, bit for bit"


def time_per_step(task: Task) -> Found:
    """A step is not too slow to tune on."""
    group = RolloutEngine(task, [0], [3])
    steps, x = 0, draws(task, 1)[0]
    try:
        group.rollout([Proposal(x, 0, horizon=1)])  # what is compiled or loaded at first
        begun = time.perf_counter()
        while time.perf_counter() - begun < 0.3:
            (segment,) = group.rollout([Proposal(x, 0, horizon=5)])
            steps += segment.length
        seconds = (time.perf_counter() - begun) / steps
    finally:
        group.close()
    total = 50_000 * seconds
    whole = f"{total:.0f} s" if total < 120 else f"{total / 60:.0f} min"
    text = f"{seconds * 1e3:.3g} ms; 50,000 steps in one environment take {whole}"
    if seconds > SLOW:
        return False, f"{text}; more than {SLOW * 1e3:g} ms a step is too slow to tune on"
    return True, text


def baseline_specs(task: Task) -> Found:
    """Return whether the specs can be judged, and what they come to with the baseline values.

    Without baseline values the middle of the bounds takes their place.
    """
    x, which = np.zeros(task.space.dimension), "in the middle of the bounds"
    if task.baseline is not None:
        x, which = task.space.normalise(task.baseline), "with the baseline values"
    engine = RolloutEngine(task, range(EPISODES), [0] * EPISODES)
    try:
        segments = engine.rollout(evaluation_proposals(x, EPISODES, seed=0))
        limit = horizon_of(task).steps
    finally:
        engine.close()
    if all(segment.terminated and segment.length < limit for segment in segments):
        return False, (
            f"every episode terminates {which}, the first after {segments[0].length} of {limit} "
            "steps, so no whole response can be judged; give baseline values with which episodes "
            "last, and return truncated, not terminated, where time is over"
        )
    told = [
        f"{label}: {row['value']:.4g}" + {True: ", met", False: ", not met", None: ""}[row["met"]]
        for label, row in over_episodes(segments, task.specs).items()
    ]
    return True, f"{which}, over {EPISODES} episodes: {'; '.join(told)}"


def _told(parameters: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name}={value:.4g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in parameters.items()
    )
