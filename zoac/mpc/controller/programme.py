"""Weights and bounds of an MPC, as the objective of a model with outputs."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.mpc.controller.numbers import Numbers, by_name
from zoac.mpc.controller.outputs import ModelWithOutputs
from zoac.mpc.controller.weights import CostToGo, Matrix, Values, factors
from zoac.mpc.problem import PENALTY, StateBounds
from zoac.mpc.sqp import Objective

LEAST_WEIGHT = 1e-8
"""An input weighs at least this part of its weight and its rate's together, since solvers need a
positive number where only rates or a full matrix weigh."""


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
        if isinstance(terminal, str):
            if terminal != "riccati":
                raise ConfigError(f"terminal={terminal!r}: {suggest(terminal, ['riccati'])}")
            self._terminal: Matrix | CostToGo | None = CostToGo()
        else:
            given = by_name("terminal", terminal, states)
            self._terminal = Matrix("terminal", given, states, numbers) if given else None
        self.of_regulator = isinstance(self._terminal, CostToGo)
        """Whether the terminal weights are those of the linear-quadratic regulator."""
        self._rate_weights = {
            name: numbers.add("rate_weight", f"rate_weight_{name}", value, 0.0)
            for name, value in by_name("rate_weights", rate_weights, inputs).items()
        }
        self._max_rates = {
            name: numbers.add("max_rate", f"max_rate_{name}", value, 0.0)
            for name, value in by_name("rate_bounds", rate_bounds, inputs).items()
        }
        of_rates = {*self._rate_weights, *self._max_rates}
        self.rates = [j for j, name in enumerate(inputs) if name in of_rates]
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
            low, high = (None if v is None or v in (-math.inf, math.inf) else v for v in pair)
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
        return np.clip(inputs, *self._box)

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
        return frozenset(
            name
            for name in self._inputs
            if any(number in params for number in self._bounds.get(name, ()))
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
            end=of_states if self._terminal is None else self._terminal.full,
        )

    def objective(
        self,
        outputs: ModelWithOutputs,
        values: Values,
        reference: np.ndarray,
        rest: np.ndarray,
        tuned: frozenset[str],
    ) -> tuple[Objective, np.ndarray]:
        """Return what n environments minimise, and the parameters theta of `outputs`.

        Args:
            outputs: From the method of that name.
            values: Every number, (n,).
            reference: Of states (n, N, nx).
            rest: Of inputs (n, nu), 0 where there is none; it may lie outside their bounds.
            tuned: From `tuned_bounds`.
        """
        n, horizon, nx = reference.shape
        names = list(self._model.parameters)
        theta = [np.stack([values[k] for k in names], axis=1) if names else np.empty((n, 0))]
        gamma = values[self._discount][:, None] ** np.arange(horizon + 1)
        weight = self._weight.matrices(values, n)
        diagonal = np.einsum("nii->ni", weight)
        target = np.zeros((n, horizon, outputs.size))
        state_weights = np.zeros((n, horizon, outputs.size))
        target[:, :, outputs.states] = reference
        target[:, :, outputs.copy] = rest[:, None, outputs.copies]

        rate = np.zeros((n, len(self._inputs)))
        for name, number in self._rate_weights.items():
            rate[:, self._inputs.index(name)] = values[number]
        now = gamma[:, :-1, None]  # of the inputs, and of what is seen one step later
        state_weights[:, :, outputs.rate] = now * rate[:, None, self.rates]
        state_weights[:, :, outputs.copy] = now * diagonal[:, None, nx:][:, :, outputs.copies]
        least = LEAST_WEIGHT * (diagonal[:, nx:] + rate)
        direct = np.maximum(diagonal[:, nx:], least)
        direct[:, outputs.copies] = least[:, outputs.copies]
        if self._weight.full:
            direct = least
            sizes, rows = factors(weight)
            theta.append(rows.reshape(n, -1))
            point = np.concatenate([reference[:, :1], reference[:, :-1]], axis=1)
            point = np.concatenate([point, np.repeat(rest[:, None], horizon, axis=1)], axis=2)
            target[:, :, outputs.stage] = np.matmul(rows[:, None], point[..., None])[..., 0]
            state_weights[:, :, outputs.stage] = now * sizes[:, None]
            state_weights[:, :, outputs.copy] = 0.0
        else:
            stage = gamma[:, 1:-1, None] * diagonal[:, None, :nx]
            state_weights[:, :-1, outputs.states] = stage

        # What is applied and linearised about lies in the bounds, whatever the cost's centre is.
        inside = self.clip(rest)
        last = self._terminal_weight(values, weight, theta[0], reference[:, -1], inside)
        if outputs.end.stop > outputs.end.start:
            sizes, rows = factors(last)
            theta.append(rows.reshape(n, -1))
            end = np.matmul(rows, reference[:, -1, :, None])[..., 0]
            target[:, :, outputs.end] = end[:, None]
            state_weights[:, -1, outputs.end] = gamma[:, -1:] * sizes
        else:
            state_weights[:, -1, outputs.states] = gamma[:, -1:] * np.einsum("nii->ni", last)
        bounds = self._state_bounds(outputs, values, diagonal[:, :nx], tuned)
        objective = Objective(target, state_weights, now * direct[:, None], bounds, inside)
        return objective, np.concatenate(theta, axis=1)

    def _terminal_weight(
        self,
        values: Values,
        weight: np.ndarray,
        theta: np.ndarray,
        reference: np.ndarray,
        rest: np.ndarray,
    ) -> np.ndarray:
        n, nx = reference.shape
        if self._terminal is None:
            return weight[:, :nx, :nx]
        if isinstance(self._terminal, Matrix):
            return self._terminal.matrices(values, n)
        _, a, b = self._model.linearise(theta, reference.copy(), rest[:, None])
        return self._terminal.matrices(a[:, 0], b[:, 0], weight, values[self._discount])

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
