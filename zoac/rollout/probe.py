"""What a run finds out about environment and controller, by trying, before it relies on it."""

from collections.abc import Callable
from contextlib import closing
from itertools import zip_longest
from typing import Any

import numpy as np

from zoac.controllers.stateful_controller import stateful_in
from zoac.core.controller import Controller, Memory
from zoac.core.errors import as_text
from zoac.core.parameters import ParameterSpace
from zoac.core.state import decode, encode
from zoac.envs.base import VecEnv

STEPS = 20
"""Steps of the trial from a saved state, and again after the next reset."""

SEEDS = (1, 2)
"""Of the episode that is saved and of the one after it."""


def restore_fault(make_env: Callable[[int], VecEnv], pickled: bool = False) -> str | None:
    """Save an environment in mid-episode, restore it, and compare how it goes on.

    The environment runs on for `STEPS` steps and into another episode. Restored, it must show the
    same bits again.

    Args:
        make_env: Makes a vectorised environment with `num_envs=n`, which is closed again.
        pickled: The state goes through a pickle into another environment, as a checkpoint does.

    Returns:
        What went wrong, for people to read; None: nothing.
    """
    env = make_env(1)
    other = make_env(1) if pickled else env
    shape = env.single_action_space.shape or ()
    actions = np.random.default_rng(0).standard_normal((STEPS, *shape))
    with closing(env), closing(other):
        _stand_in_mid_episode(env, actions)
        try:
            state = env.state([0])
            if pickled:
                state = decode(encode(state))
            expected = _onwards(env, actions)
            other.restore([0], state)
        except Exception as error:  # whatever a user's environment raises when it is copied
            return f"copying it raised {as_text(error)}"
        found = _onwards(other, actions)
    if (step := first_difference(expected, found)) is None:
        return None
    shown = found[min(step, len(found) - 1)]
    if isinstance(shown, str):
        return f"restored to an earlier state, it fails: {shown}"
    return (
        f"restored to an earlier state, it goes on otherwise at step {step + 1}: "
        f"{env.saved_by or ('pickle' if pickled else 'deepcopy')} misses a part, shares it or "
        "builds it anew"
    )


def controller_fault(
    controller: Controller,
    space: ParameterSpace,
    make_env: Callable[[int], VecEnv],
    pickled: bool = False,
) -> str | None:
    """Save a controller object in mid-episode, restore it, and compare how it goes on.

    Args:
        controller: One whose memory is arrays needs no trial.
        space: Its parameters, of which those in the middle are taken.
        make_env: As for `restore_fault`; tells the shape of an observation.
        pickled: The state goes through a pickle into another object, as a checkpoint does.

    Returns:
        What went wrong, for people to read; None: nothing.
    """
    memory = controller.init(1)
    if not stateful_in(memory):
        return None
    env = make_env(1)
    shape = env.single_observation_space.shape or ()
    env.close()
    observations = np.random.default_rng(0).standard_normal((STEPS, 1, *shape))
    values = space.values(np.zeros(space.dimension))
    parameters = {name: v[None] for name, v in zip(space.names, values, strict=True)}

    def shown(memory: Memory, first: int, end: int) -> list[bytes | str]:
        try:
            return [
                np.asarray(controller.act(parameters, o.copy(), memory)[0]).tobytes()
                for o in observations[first:end]
            ]
        except Exception as error:  # whatever a user's controller raises
            return [as_text(error)]

    remedy = "get_state() and set_state(state) tell what of it lasts"
    shown(memory, 0, STEPS // 2)
    try:
        states = [one.state() for one in stateful_in(memory)]
        if pickled:
            states = decode(encode(states))
        expected = shown(memory, STEPS // 2, STEPS)
        other = controller.init(1) if pickled else memory
        for one, state in zip(stateful_in(other), states, strict=True):
            one.restore(state)
    except Exception as error:  # whatever a user's controller raises when it is copied
        return f"saving the controller raised {as_text(error)}; {remedy}"
    if shown(other, STEPS // 2, STEPS) == expected:
        return None
    return f"the controller, restored to an earlier state, goes on otherwise; {remedy}"


def _stand_in_mid_episode(env: VecEnv, actions: np.ndarray) -> None:
    """Step up to `STEPS` / 2 steps into an episode, fewer if it ends before."""
    for steps in (STEPS // 2, 3, 1, 0):
        rows = played(env, actions[:steps], SEEDS[0])
        if len(rows) == steps + 1 and not _ended(rows):
            return


def _onwards(env: VecEnv, actions: np.ndarray) -> list[bytes | str]:
    return played(env, actions) + played(env, actions, SEEDS[1])


def _ended(rows: list[bytes | str]) -> bool:
    return isinstance(rows[-1], str) or rows[-1].endswith(b"\x01")


def played(env: VecEnv, actions: np.ndarray, seed: int | None = None) -> list[bytes | str]:
    """Return what each step of one environment shows, up to the end of its episode.

    Args:
        env: A vectorised environment with `num_envs=1`.
        actions: (T, m).
        seed: Of a new episode; None: go on.

    Returns:
        Observation, cost and end as bytes, or what was raised; with `seed` the reset's first.
    """
    rows: list[bytes | str] = []
    try:
        if seed is not None:
            observations, infos = env.reset(seed=[seed])
            rows.append(_row(infos, observations[0], np.zeros(1, bool)))
        for action in actions:
            if rows and _ended(rows):
                break
            observations, _, terminated, truncated, infos = env.step(action[None])
            rows.append(_row(infos, observations[0], infos["cost"], terminated | truncated))
    except Exception as error:  # whatever a user's environment raises
        rows.append(as_text(error))
    return rows


def _row(infos: dict[str, Any], *shown: np.ndarray) -> bytes | str:
    if (failure := infos.get("failures", {}).get(0)) is not None:
        return str(failure)
    return b"".join(np.ascontiguousarray(array).tobytes() for array in shown)


def first_difference(one: list[bytes | str], other: list[bytes | str]) -> int | None:
    """Return the first step at which what `played` returned differs; None: nowhere."""
    rows = enumerate(zip_longest(one, other))
    return next((step for step, (a, b) in rows if a != b), None)
