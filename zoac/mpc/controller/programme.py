"""Weights and bounds of an MPC, as the objective of a model with outputs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.mpc.controller.numbers import Numbers, by_name
from zoac.mpc.controller.outputs import ModelWithOutputs
from zoac.mpc.controller.weights import Matrix, Values, cost_to_go, factors
from zoac.mpc.problem import PENALTY, StateBounds
from zoac.mpc.sqp import Objective

LEAST_WEIGHT = 1e-8
"""An input weighs at least this part of its weight and its rate's together, since solvers need a
positive number where only rates or a full matrix weigh."""


@dataclass(frozen=True, eq=False, slots=True)
class Weighed:
    """What of the objective of n environments depends on the numbers alone."""

    outputs: ModelWithOutputs
    values: Values  # every number, (n,)
    theta: np.ndarray  # (n, np), parameters of the model proper
    gamma: np.ndarray  # (n, N + 1), discounts
    weight: np.ndarray  # (n, nx + nu, nx + nu), of a stage
    stage: np.ndarray  # likewise, its eigenvectors as rows; of size 0 if it is diagonal
    end: np.ndarray  # (n, nx, nx), those of the terminal weight
    states: np.ndarray  # (n, N, nz), weights of the states of `outputs`, discounts included
    inputs: np.ndarray  # (n, N, nu), likewise
    bounds: StateBounds | None
    rest: np.ndarray  # (n, nu), references of inputs, 0 where there are none
    inside: np.ndarray  # likewise, in the inputs' bounds: what is applied and linearised about


class Programme:
    """What an MPC minimises and keeps to, whatever the reference."""

    def __init__(
        self,
        model: Any,
        numbers: Numbers,
        *,
        weights: Mapping[Any, float],
        terminal: Mapping[Any, float] | str | None,
        rate_weights: Mapping[str, float] | None,
        bounds: Mapping[str, Any] | None,
        rate_bounds: Mapping[str, float] | None,
        hard: Sequence[str],
        penalty: float | Mapping[str, float] | None,
        discount: float,
    ) -> None:
        """
        Add all numbers to `numbers`; see `zoac.mpc.Mpc`.

        Raises:
            ConfigError: If something cannot be used.
        """
        self._model = model
        self._states, self._inputs = states, inputs = tuple(model.states), tuple(model.inputs)
        every = (*states, *inputs)
        self._weight = Matrix("weight", by_name("weights", weights, every), every, numbers)
        self.of_regulator = isinstance(terminal, str) and terminal == "riccati"
        """Whether the terminal weights are those of the linear-quadratic regulator."""
        if isinstance(terminal, str) and not self.of_regulator:
            raise ConfigError(f"terminal={terminal!r}: {suggest(terminal, ['riccati'])}")
        given = {} if self.of_regulator else by_name("terminal", terminal, states)
        self._terminal = Matrix("terminal", given, states, numbers) if given else None
        self._rate_weights, self._max_rates = (
            {name: numbers.add(group, f"{group}_{name}", value, 0.0)
             for name, value in by_name(option, of_rates, inputs).items()}
            for group, option, of_rates in (
                ("rate_weight", "rate_weights", rate_weights),
                ("max_rate", "rate_bounds", rate_bounds),
            )
        )  # fmt: skip
        self.rates = [j for j, name in enumerate(inputs)
                      if name in self._rate_weights or name in self._max_rates]  # fmt: skip
        """Positions of the inputs whose rates are weighed or bounded."""
        self._numbers = numbers
        self._discount = numbers.add("discount", "discount", discount)
        self.check({"discount": discount})
        for name in inputs:
            own = (numbers.values.get(f"{kind}_{name}", 0.0) for kind in ("weight", "rate_weight"))
            if not sum(own) > 0.0:
                raise ConfigError(
                    f"the input {name!r} has no weight; give weights={{{name!r}: ...}}, or "
                    "rate_weights, above 0"
                )
        self._add_bounds(by_name("bounds", bounds, every), numbers)
        self._add_penalties(hard, penalty, numbers)

    def _add_bounds(self, bounds: Mapping[str, Any], numbers: Numbers) -> None:
        self._bounds: dict[str, tuple[str | None, str | None]] = {}
        for name, pair in bounds.items():
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise ConfigError(f"bounds[{name!r}]={pair!r}: expected (low, high)")
            low, high = (None if v in (None, -math.inf, math.inf) else v for v in pair)
            if low is not None and high is not None and not low <= high:
                raise ConfigError(f"bounds[{name!r}]={pair!r}: low must not be above high")
            self._bounds[name] = (
                None if low is None else numbers.add("low", f"low_{name}", low),
                None if high is None else numbers.add("high", f"high_{name}", high),
            )
        self._box = self.box(numbers.values)

    def box(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds of the inputs, (nu,) each, at given numbers."""
        box = np.full((2, len(self._inputs)), np.inf) * [[-1.0], [1.0]]
        for j, name in enumerate(self._inputs):
            for side, number in enumerate(self._bounds.get(name, ())):
                box[side, j] = box[side, j] if number is None else values[number]
        return box[0], box[1]

    def _add_penalties(
        self, hard: Sequence[str], penalty: float | Mapping[str, float] | None, numbers: Numbers
    ) -> None:
        bounded = [name for name in self._states if name in self._bounds]
        hard = [hard] if isinstance(hard, str) else list(hard)
        for name in hard:
            if name not in bounded:
                raise ConfigError(f"hard: no bounds on a state {name!r}; {suggest(name, bounded)}")
        self._hard = frozenset(hard)
        soft = [name for name in bounded if name not in hard]
        one = penalty is not None and not isinstance(penalty, Mapping)
        given = dict.fromkeys(soft, penalty) if one else by_name("penalty", penalty, soft)
        for name, value in given.items():
            numbers.add("penalty", f"penalty_{name}", value, 0.0)

    def clip(self, inputs: np.ndarray) -> np.ndarray:
        """Return inputs (..., nu) inside their bounds."""
        return inputs.clip(*self._box)

    def check(self, parameters: Mapping[str, Any]) -> None:
        """See that parameters are numbers of this MPC, in the range of each.

        Raises:
            ConfigError: If one is not.
        """
        self._numbers.check(parameters)
        discount = parameters.get("discount", 1.0)
        if not 0.0 < discount <= 1.0:
            raise ConfigError(f"discount={discount}: expected a number above 0, at most 1")

    def check_space(self, space: Mapping[str, Mapping[str, Any]]) -> None:
        """See that numbers stay in their ranges wherever they are tuned.

        Raises:
            ConfigError: If one may leave it.
        """
        for j, name in enumerate(self._inputs):
            for number in self._bounds.get(name, ()):
                fields, low, high = space.get(number or ""), self._box[0][j], self._box[1][j]
                if fields and not low <= fields["low"] <= fields["high"] <= high:
                    raise ConfigError(
                        f"space: {number} must stay inside the bounds that the MPC was built with, "
                        f"[{low:g}, {high:g}]; build it with wider ones"
                    )
        if space.get("discount", {"high": 1.0})["high"] > 1.0:
            raise ConfigError("space: discount must stay at most 1; give discount=(low, 1.0)")

    def tuned_bounds(self, params: Mapping[str, Any]) -> frozenset[str]:
        """Return the inputs of which a bound is among the parameters."""
        bounds = {name: self._bounds.get(name, ()) for name in self._inputs}
        return frozenset(
            k for k, pair in bounds.items() if any(number in params for number in pair)
        )

    def bounded(self, tuned: frozenset[str]) -> str:
        """Say what is bounded beside inputs by constants; empty: nothing."""
        said = {
            "bounds on states": any(name in self._bounds for name in self._states),
            "bounds on rates": bool(self._max_rates),
            "tuned bounds on inputs": bool(tuned),
        }
        return " and ".join(what for what, there in said.items() if there)

    def outputs(self, copies: frozenset[str]) -> ModelWithOutputs:
        """Return the model with the outputs that this needs, and copies of some inputs."""
        # Without a terminal weight of its own the end has that of the states.
        of_states = self._weight.full_within(len(self._states))
        return ModelWithOutputs(
            self._model,
            self._box,
            self.rates,
            [j for j, name in enumerate(self._inputs) if name in copies],
            stage=self._weight.full,
            end=self.of_regulator or (of_states if self._terminal is None else self._terminal.full),
        )

    def weigh(
        self, outputs: ModelWithOutputs, values: Values, rest: np.ndarray, horizon: int,
        tuned: frozenset[str],
    ) -> Weighed:  # fmt: skip
        """Return all of an objective that does not depend on the reference of states.

        `values` has every number, (n,); `outputs` and `tuned` are of the methods `outputs` and
        `tuned_bounds`; `rest` are references of inputs, which may lie outside their bounds.
        """
        n, nx = len(values[self._discount]), len(self._states)
        parameters = [values[name] for name in self._model.parameters]
        theta = np.stack(parameters, axis=1) if parameters else np.empty((n, 0))
        gamma = values[self._discount][:, None] ** np.arange(horizon + 1)
        now = gamma[:, :-1, None]  # of the inputs, and of what is seen one step later
        weight = self._weight.matrices(values, n)
        diagonal = np.einsum("nii->ni", weight)
        rate = np.zeros((n, len(self._inputs)))
        for name, number in self._rate_weights.items():
            rate[:, self._inputs.index(name)] = values[number]
        states = np.zeros((n, horizon, outputs.size))
        states[:, :, outputs.rate] = now * rate[:, None, self.rates]
        states[:, :, outputs.copy] = now * diagonal[:, None, nx:][:, :, outputs.copies]
        least = LEAST_WEIGHT * (diagonal[:, nx:] + rate)
        direct = np.maximum(diagonal[:, nx:], least)
        direct[:, outputs.copies] = least[:, outputs.copies]
        stage = end = np.empty((n, 0, 0))
        if self._weight.full:
            direct = least
            sizes, stage = factors(weight)
            states[:, :, outputs.stage] = now * sizes[:, None]
            states[:, :, outputs.copy] = 0.0
        else:
            states[:, :-1, outputs.states] = gamma[:, 1:-1, None] * diagonal[:, None, :nx]
        if not self.of_regulator:
            own = self._terminal
            last = weight[:, :nx, :nx] if own is None else own.matrices(values, n)
            if outputs.end.stop > outputs.end.start:
                sizes, end = factors(last)
                states[:, -1, outputs.end] = gamma[:, -1:] * sizes
            else:
                states[:, -1, outputs.states] = gamma[:, -1:] * np.einsum("nii->ni", last)
        inputs = now * direct[:, None]
        bounds = self._state_bounds(outputs, values, diagonal[:, :nx], tuned)
        return Weighed(outputs, values, theta, gamma, weight, stage, end, states, inputs, bounds,
                       rest, self.clip(rest))  # fmt: skip

    def objective(self, weighed: Weighed, reference: np.ndarray) -> tuple[Objective, np.ndarray]:
        """Return what n environments minimise, and the parameters theta of the model with outputs.

        Args:
            weighed: From `weigh`.
            reference: Of states (n, N, nx).
        """
        outputs, states, stage, end = weighed.outputs, weighed.states, weighed.stage, weighed.end
        rest, inside = weighed.rest, weighed.inside
        n, horizon, nx = reference.shape
        if outputs.size == nx:  # nothing but the model's states
            target = reference
            return Objective(target, states, weighed.inputs, inside, weighed.bounds), weighed.theta
        if self.of_regulator:
            at = weighed.theta, reference[:, -1].copy(), inside[:, None]
            _, a, b = self._model.linearise(*at)
            discount = weighed.values[self._discount]
            sizes, end = factors(cost_to_go(a[:, 0], b[:, 0], weighed.weight, discount))
            states = states.copy()
            states[:, -1, outputs.end] = weighed.gamma[:, -1:] * sizes
        target = np.zeros_like(states)
        target[:, :, outputs.states] = reference
        target[:, :, outputs.copy] = rest[:, None, outputs.copies]
        if stage.size:
            point = np.concatenate([reference[:, :1], reference[:, :-1]], axis=1)
            point = np.concatenate([point, np.repeat(rest[:, None], horizon, axis=1)], axis=2)
            target[:, :, outputs.stage] = np.matmul(stage[:, None], point[..., None])[..., 0]
        if end.size:
            target[:, :, outputs.end] = np.matmul(end, reference[:, -1, :, None])[:, None, :, 0]
        theta = weighed.theta
        if stage.size or end.size:
            theta = np.concatenate([theta, stage.reshape(n, -1), end.reshape(n, -1)], axis=1)
        return Objective(target, states, weighed.inputs, inside, weighed.bounds), theta

    def _state_bounds(
        self, outputs: ModelWithOutputs, values: Values, weights: np.ndarray, tuned: frozenset[str]
    ) -> StateBounds | None:
        if not self.bounded(tuned):
            return None
        none = np.full((len(weights), outputs.size), np.inf)
        low, high, penalty = -none, none, none.copy()
        for name, number in self._max_rates.items():
            place = outputs.rate.start + self.rates.index(self._inputs.index(name))
            low[:, place], high[:, place] = -values[number], values[number]
        for name, pair in self._bounds.items():
            if name in self._states:
                place = self._states.index(name)
                if name not in self._hard:
                    default = PENALTY * weights.max(axis=1)
                    penalty[:, place] = values.get(f"penalty_{name}", default)
            elif name in tuned:
                place = outputs.copy.start + outputs.copies.index(self._inputs.index(name))
            else:
                continue
            for side, of_side in zip((low, high), pair, strict=True):
                if of_side is not None:
                    side[:, place] = values[of_side]
        return StateBounds(low, high, penalty)
