"""Which of an environment's signals is minimised: the negative reward, or a number of its info."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, EnvironmentContractError, EnvironmentFailure, suggest

KNOWN = ("auto", "reward", "cost", "info:<key>")


class Objective:
    """The cost of a step: "reward", "cost" or "info:<key>", as a user writes it.

    "auto" is the negative reward, and refuses an environment whose `info["cost"]` is another number
    than that: which of the two is meant cannot be guessed.
    """

    def __init__(self, name: str = "auto") -> None:
        """
        Raises:
            ConfigError: If the name is none of these.
        """
        text = name if isinstance(name, str) else ""
        kind, _, key = text.partition(":")
        if not (text in KNOWN[:3] or (kind == "info" and key)):
            more = "; or a spec, such as zoac.specs.itae('y', 'r')"
            raise ConfigError(f"objective={name!r}: {suggest(str(name), KNOWN)}{more}")
        self._auto = name == "auto"
        self._key = None if name in ("auto", "reward") else key or "cost"

    def __str__(self) -> str:
        return "-reward" if self._key is None else f'info["{self._key}"]'

    def cost(self, reward: Any, info: Mapping[str, Any], step: int) -> float:
        """Return the cost of a step.

        Args:
            reward: As the environment returned it.
            info: Likewise.
            step: Which step of its episode, from 1, for messages.

        Raises:
            ConfigError: If the signal is not there, or "auto" finds two that differ.
            EnvironmentContractError: If it is not one number.
            EnvironmentFailure: If it is not finite.
        """
        if self._key is None:
            cost = -float(reward) if isinstance(reward, float) else -_number(reward, "reward", step)
            if self._auto and info.get("cost") is not None:
                _refuse_conflict(cost, info["cost"], step)
        elif info.get(self._key) is None:
            raise ConfigError(
                f"the objective is {self}, which is needed at every step; at step {step} of an "
                f"episode info has: {', '.join(map(str, info)) or '(nothing)'}. To minimise the "
                'negative reward give objective="reward"'
            )
        else:
            cost = _number(info[self._key], str(self), step)
        if not math.isfinite(cost):
            raise EnvironmentFailure(
                f"the environment's step gave the cost {cost} (reward {reward!r}), expected a "
                "finite number"
            )
        return cost


def _number(value: Any, what: str, step: int) -> float:
    """Return one number, which may come as an array of one."""
    if isinstance(value, float):
        return float(value)
    try:
        array = np.asarray([] if value is None else value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.size != 1:
        raise EnvironmentContractError(
            f"the environment's {what} is {value!r} at step {step} of an episode, expected one "
            "number; write a wrapper that makes one of it, or choose another objective: "
            f"{', '.join(KNOWN)}"
        )
    return float(array.reshape(()))


def _refuse_conflict(cost: float, other: Any, step: int) -> None:
    try:
        number = _number(other, "info", step)
        same = bool(np.isclose(number, cost, rtol=1e-6, atol=1e-9, equal_nan=True))
    except EnvironmentContractError:  # a dict of costs, say
        same = False
    if not same:
        raise ConfigError(
            f'info["cost"] is {other!r} at step {step} of an episode, where the negative reward is '
            f'{cost!r}: give objective="reward" to minimise the negative reward, or '
            'objective="cost" to minimise info["cost"], which must then be given at every step'
        )
