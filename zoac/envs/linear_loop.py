"""Linear plants with dead time and saturation in a loop, vectorised: what `zoac.tune_pid` steps.

The plant x' = A x + B u(t - L), y = C x + D u(t - L) is discretised exactly for an input that is
held over each sample, also where the dead time L is no whole number of samples: with L = (d - 1 +
f) T_s, 0 < f <= 1, the input of d samples ago acts for the first f T_s of a step, the one after it
for the rest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from scipy.linalg import expm

from zoac.core.errors import ConfigError
from zoac.core.types import is_number
from zoac.envs.base import ArrayVecEnv

DIVERGED = 1e3
"""An episode ends where |y| exceeds this many reference steps."""
TERMINATION_COST = 1e4


@dataclass(frozen=True, eq=False)
class SampledPlant:
    """A plant as it is seen at the samples.

    Args:
        a: (p, p), of the state.
        b_early: (p,), of the input `delay` samples ago.
        b_late: (p,), of the input one sample later; of this step's where `delay` is 0.
        c: (p,), of the output.
        d: Direct feedthrough of the input that acts at the sample.
        delay: Samples d.
        sample_time: T_s [s].
    """

    a: np.ndarray
    b_early: np.ndarray
    b_late: np.ndarray
    c: np.ndarray
    d: float
    delay: int
    sample_time: float

    def response(self, z: np.ndarray) -> np.ndarray:
        """Return the transfer function at `z` (K,), complex."""
        inverse = np.linalg.inv(z[:, None, None] * np.eye(len(self.c)) - self.a)
        early, late = (inverse @ b @ self.c for b in (self.b_early, self.b_late))
        newest = float(max(self.delay - 1, 0))
        return late * z**-newest + (early + self.d) * z ** -float(self.delay)

    def state_space(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A (q, q), B (q,) and C (q,) with the past inputs, oldest first, as last states."""
        order, delay = len(self.c), self.delay
        a = np.zeros((order + delay, order + delay))
        a[:order, :order] = self.a
        c = np.zeros(order + delay)
        c[:order], b = self.c, np.zeros(order + delay)
        if delay:
            a[:order, order], c[order], b[-1] = self.b_early, self.d, 1.0
            a[order:-1, order + 1 :] = np.eye(delay - 1)
        if delay > 1:
            a[:order, order + 1] = self.b_late
        else:
            b[:order] = self.b_late
        return a, b, c


def sampled(system: Any, sample_time: float, dead_time: float = 0.0) -> SampledPlant:
    """Return a python-control system as seen at the samples.

    Args:
        system: Continuous, with one input and one output.
        sample_time: T_s [s].
        dead_time: L [s].

    Raises:
        ConfigError: If it is discrete or not proper, has several inputs or outputs or a number that
            is not finite, or hands its input on to its output at once: such a loop has no order of
            computation.
    """
    import control

    if not isinstance(system, control.lti.LTI):
        raise ConfigError(f"plant={system!r}: expected a system of python-control")
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ConfigError(
            f"plant: {system.ninputs} inputs and {system.noutputs} outputs; expected one of each, "
            "such as plant[0, 0] of python-control"
        )
    if system.isdtime(strict=True):
        raise ConfigError(
            f"plant: sampled every {system.dt:g} s; expected a continuous system, which is sampled "
            "here together with its dead time"
        )
    refuse_not_finite(system)
    if len(system.zeros()) > len(system.poles()):
        raise ConfigError(
            "plant: more zeros than poles, which nothing can be; add the lag of the sensor"
        )
    if not (is_number(dead_time) and math.isfinite(dead_time) and dead_time >= 0):
        raise ConfigError(f"dead_time={dead_time!r}: expected seconds, 0 or more")
    space = control.ss(system)
    order = space.nstates
    delay = math.ceil(dead_time / sample_time - 1e-9)
    through = float(space.D[0, 0])
    if through and not delay:
        raise ConfigError("the plant's output follows its input at once; give it a dead time")
    early = dead_time - (delay - 1) * sample_time if delay else 0.0
    augmented = np.zeros((order + 1, order + 1))
    augmented[:order, :order], augmented[:order, order:] = space.A, space.B

    def held(seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the transition over `seconds` and what a unit input adds."""
        whole = expm(augmented * seconds)
        return whole[:order, :order], whole[:order, order]

    a, _ = held(sample_time)
    # The early input acts first; its effect then passes through the rest of the step.
    rest, late = held(sample_time - early)
    _, first = held(early)
    return SampledPlant(a, rest @ first, late, space.C[0], through, delay, sample_time)


def refuse_not_finite(system: Any) -> None:
    """Refuse a system of python-control that is no model, or whose numbers are not all finite.

    Raises:
        ConfigError: If `system` is one.
    """
    import control

    if isinstance(system, control.TransferFunction):
        numbers = {"num": system.num[0][0], "den": system.den[0][0]}
    elif isinstance(system, control.StateSpace):
        numbers = {"A": system.A, "B": system.B, "C": system.C, "D": system.D}
    else:
        kind = type(system).__name__
        raise ConfigError(f"plant: a {kind}; expected a transfer function or a state-space model")
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            given = np.asarray(values).tolist()
            raise ConfigError(f"plant: {name}={given}: expected finite numbers")


class LoopVecEnv(ArrayVecEnv):
    """n environments of m loops each: the same controller on several plants, or on one that meets
    several draws of the noise.

    Observation (3 m): m measured outputs, m references, m outputs without noise. Action (m): the
    inputs. An episode is a step of the reference from 0, and at `load_at` a step of a load, which
    is added to the input behind the actuator's limits. The cost of a step is T_s |r - y|, of the
    worst plant and the mean over its draws of the noise: its sum is the integral of the absolute
    error. An episode ends early where any output diverges.
    """

    def __init__(
        self,
        plants: Sequence[SampledPlant],
        num_envs: int,
        *,
        max_episode_steps: int,
        load_at: int,
        reference: float = 1.0,
        loads: Sequence[float] = (0.0,),
        input_limits: tuple[float, float] = (-math.inf, math.inf),
        noises: Sequence[float] = (0.0,),
    ) -> None:
        """
        Args:
            plants: From `sampled`, P of them, all of one sample time.
            num_envs: n.
            max_episode_steps: Length of an episode.
            load_at: Step at which the load begins.
            reference: Height of the reference's step.
            loads: Heights of the load's step, one per plant, or one for all.
            input_limits: Bounds of the input at the actuator.
            noises: Standard deviations of the measurement, of each of the R draws of the noise
                that a plant meets at once; m = P R loops, plant after plant.
        """
        draws = len(noises)
        loops = len(plants) * draws
        unbounded = np.full(3 * loops, np.inf)
        super().__init__(
            num_envs,
            Box(-unbounded, unbounded, dtype=np.float64),
            Box(*input_limits, (loops,), dtype=np.float64),
            max_episode_steps,
        )
        self._sample_time, self._reference = plants[0].sample_time, reference
        self._noises = np.tile(np.asarray(noises, dtype=np.float64), len(plants))
        self._loads = np.repeat(np.broadcast_to(loads, len(plants)), draws)
        self._load_at, self._shape = load_at, (num_envs, len(plants), draws)
        order = max(len(p.c) for p in plants)
        longest = max(p.delay for p in plants)

        def stacked(arrays: list[np.ndarray]) -> np.ndarray:
            """Return arrays, filled up with zeros to the largest order, a row per loop."""
            full = np.zeros((len(arrays), *(order for _ in range(arrays[0].ndim))))
            for row, array in zip(full, arrays, strict=True):
                row[tuple(slice(size) for size in array.shape)] = array
            return np.repeat(full, draws, axis=0)

        self._a = stacked([p.a for p in plants])
        self._b_early = stacked([p.b_early for p in plants])
        self._b_late = stacked([p.b_late for p in plants])
        self._c = stacked([p.c for p in plants])
        self._d = np.repeat([p.d for p in plants], draws)
        delays = np.repeat([p.delay for p in plants], draws)
        self._early, self._late = longest - delays, longest - np.maximum(delays - 1, 0)
        self._loops = np.arange(loops)
        self._x = np.zeros((num_envs, loops, order))
        self._inputs = np.zeros((num_envs, loops, longest + 1))  # the newest is the last
        self._w = np.zeros((num_envs, max_episode_steps + 1, loops))
        self._y = np.zeros((num_envs, loops))
        self.arrays = {"x": self._x, "inputs": self._inputs, "w": self._w, "y": self._y}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        for array in self.arrays.values():
            array[env_index] = 0.0
        if self._noises.any() and not demonstration:
            self._w[env_index] = self._noises * rng.standard_normal(self._w.shape[1:])

    def _output(self) -> np.ndarray:
        # Summed one by one: the bits of a matrix product depend on the other environments.
        y = self._d * self._inputs[:, self._loops, self._late]
        for i in range(self._c.shape[1]):
            y = y + self._c[:, i] * self._x[:, :, i]
        return y

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        load = np.where((self._steps >= self._load_at)[:, None], self._loads, 0.0)
        self._inputs[:, :, :-1] = self._inputs[:, :, 1:].copy()
        self._inputs[:, :, -1] = np.clip(actions, *self._bounds) + load
        early = self._inputs[:, self._loops, self._early]
        late = self._inputs[:, self._loops, self._late]
        x = self._b_early * early[:, :, None] + self._b_late * late[:, :, None]
        for j in range(self._x.shape[2]):
            x += self._a[:, :, j] * self._x[:, :, j, None]
        self._x[...] = x
        y = self._y[...] = self._output()
        worst = np.abs(y).max(axis=1)
        diverged = ~(worst <= DIVERGED * max(1.0, abs(self._reference)))
        error = np.abs(self._reference - y)
        error[diverged] = 0.0
        means = error.reshape(self._shape).mean(axis=2).max(axis=1)
        return self._sample_time * means + np.where(diverged, TERMINATION_COST, 0.0), diverged

    def _observe(self) -> np.ndarray:
        steps = np.minimum(self._steps, self.max_episode_steps)
        measured = self._y + self._w[np.arange(self.num_envs), steps]
        reference = np.full_like(self._y, self._reference)
        return np.concatenate([measured, reference, self._y], axis=1)
