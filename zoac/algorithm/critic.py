"""The critic V_w(s): a tanh network fitted to value targets (eq. 8).

Its minibatch steps are most of the time of a tuning run. Autograd would take half as long again,
so the gradient is written out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch.optim.adam import adam

from zoac.algorithm.options import CriticOptions

_FLOAT: dict[str, Any] = {"dtype": torch.float32, "device": "cpu"}


@contextmanager
def _own_settings() -> Iterator[None]:
    """Compute on one thread, in full precision, without autograd; the caller's own settings stay.

    The number of threads changes the order of sums and so the bits. Without oneDNN, products of
    float32 stay float32 whatever `torch.set_float32_matmul_precision` was told.
    """
    onednn: Any = torch.backends.mkldnn
    threads, enabled = torch.get_num_threads(), onednn.enabled
    torch.set_num_threads(1)
    onednn.enabled = False
    try:
        with torch.inference_mode(), torch.autocast("cpu", enabled=False):
            yield
    finally:
        torch.set_num_threads(threads)
        onednn.enabled = enabled


class Critic:
    """V_w(s): observation -> tanh layers -> one number, in float32."""

    @_own_settings()
    def __init__(
        self, observation_size: int, options: CriticOptions, rng: np.random.Generator
    ) -> None:
        """
        Args:
            observation_size: Length o of an observation.
            options: Network and fit.
            rng: Stream for initial weights and minibatches.
        """
        self._rng, self._options = rng, options
        self._statistics = RunningStatistics(observation_size)
        sizes = [observation_size, *options.hidden, 1]
        # One vector of all weights: Adam moves it in one call.
        count = sum((below + 1) * width for below, width in pairwise(sizes))
        self._weights, self._gradient = (torch.zeros(count, **_FLOAT) for _ in range(2))
        self._layers = _layers(self._weights, sizes)
        self._gradients = _layers(self._gradient, sizes)
        generator = torch.Generator("cpu").manual_seed(int(rng.integers(2**63)))
        for matrix, bias in self._layers:
            gain = 1.0 if bias is self._layers[-1][1] else 5 / 3
            torch.nn.init.orthogonal_(matrix.t(), gain=gain, generator=generator)
        self._adam = {
            "step": torch.zeros((), **_FLOAT),
            "exp_avg": torch.zeros(count, **_FLOAT),
            "exp_avg_sq": torch.zeros(count, **_FLOAT),
        }
        self._one = torch.ones((), **_FLOAT)

    @_own_settings()
    def values(self, observations: np.ndarray) -> np.ndarray:
        """Return V_w of observations (B, o), shape (B,), float64."""
        parts = self._inputs(observations).split(self._options.minibatch)
        values = [self._forward(part)[-1].flatten().double() for part in parts]
        return torch.cat(values).numpy() / self._options.target_scale

    @_own_settings()
    def fit(
        self, observations: np.ndarray, targets: np.ndarray, epochs: int | None = None
    ) -> float:
        """Minimise eq. (8) by epochs of minibatch steps; return the mean loss of the last.

        Args:
            observations: States (B, o).
            targets: Value targets (B,).
            epochs: Passes over all states; default: M.
        """
        if self._options.normalise_observations:
            self._statistics.update(observations)
        inputs = self._inputs(observations)
        wanted = torch.from_numpy(
            (targets * self._options.target_scale).astype(np.float32)
        ).unsqueeze(1)
        parts = minibatches(len(inputs), self._options)
        squares = 0.0
        for _ in range(self._options.epochs if epochs is None else epochs):
            order = torch.from_numpy(self._rng.permutation(len(inputs)))
            batches = inputs[order].split(parts), wanted[order].split(parts)
            squares = sum(map(self._step, *batches))
        for moment in self._adam.values():
            # Without a gradient it would end as a subnormal number, slower than any other.
            moment[moment.abs() < torch.finfo(moment.dtype).smallest_normal] = 0.0
        return 0.5 * squares / len(inputs) / self._options.target_scale**2

    def _inputs(self, observations: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(self._statistics.normalised(observations).astype(np.float32))

    def _forward(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs and every layer's output, V_w (B, 1) last."""
        outputs = [inputs]
        for matrix, bias in self._layers:
            if len(outputs) > 1:  # NumPy's is ten times as fast as torch's
                np.tanh(outputs[-1].numpy(), out=outputs[-1].numpy())
            outputs.append(torch.addmm(bias, outputs[-1], matrix))
        return outputs

    def _step(self, inputs: torch.Tensor, targets: torch.Tensor) -> float:
        """One Adam step on the mean of 0.5 (V - G)^2; return the sum of (V - G)^2 before it."""
        *outputs, values = self._forward(inputs)
        error = values - targets
        flow = error / len(inputs)  # the gradient behind a layer, from the last to the first
        for layer in range(len(outputs) - 1, -1, -1):
            below, (matrix_gradient, bias_gradient) = outputs[layer], self._gradients[layer]
            torch.mm(below.t(), flow, out=matrix_gradient)
            torch.sum(flow, 0, out=bias_gradient)
            if layer:
                slope = torch.addcmul(self._one, below, below, value=-1, out=below)  # 1 - tanh^2
                flow = torch.mm(flow, self._layers[layer][0].t()).mul_(slope)
        self._descend()
        return float(error.square().sum())

    def _descend(self) -> None:
        """Do one step of Adam, as a function: the class would import PyTorch's compiler first."""
        step, mean, square = self._adam.values()
        adam(
            [self._weights], [self._gradient], [mean], [square], [], [step],
            lr=self._options.step_size, beta1=0.9, beta2=0.999, weight_decay=0.0, eps=1e-8,
            amsgrad=False, maximize=False, fused=True,
        )  # fmt: skip

    @_own_settings()
    def state(self) -> dict[str, Any]:
        """Return a copy: weights, Adam's moments, random stream, statistics."""
        return {
            "weights": self._weights.numpy().copy(),
            "adam": {name: value.numpy().copy() for name, value in self._adam.items()},
            "rng": self._rng.bit_generator.state,
            "statistics": self._statistics.moments,
        }

    @_own_settings()
    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self._weights.copy_(torch.from_numpy(state["weights"]))
        for name, value in state["adam"].items():
            self._adam[name].copy_(torch.from_numpy(value))
        self._rng.bit_generator.state = state["rng"]
        self._statistics.moments = state["statistics"]


class RunningStatistics:
    """Mean and variance of all observations so far (Chan et al.'s parallel update)."""

    def __init__(self, size: int) -> None:
        self.moments = 0, np.zeros(size), np.zeros(size)  # number, mean, squared deviations' sum

    def update(self, observations: np.ndarray) -> None:
        """Take in observations (B, o)."""
        before, mean, squares = self.moments
        count, own_mean = len(observations), observations.mean(axis=0)
        total, shift = before + count, own_mean - mean
        squares = squares + ((observations - own_mean) ** 2).sum(axis=0)
        squares = squares + shift**2 * before * count / total
        self.moments = total, mean + shift * count / total, squares

    def normalised(self, observations: np.ndarray) -> np.ndarray:
        """Return observations (B, o) at mean 0 and standard deviation 1, clipped at 10.

        Before the first update they are returned as they are.
        """
        count, mean, squares = self.moments
        if count == 0:
            return observations
        return np.clip((observations - mean) / (np.sqrt(squares / count) + 1e-8), -10.0, 10.0)


def minibatches(states: int, options: CriticOptions) -> list[int]:
    """Return the sizes of the minibatches of so many states."""
    whole, rest = divmod(states, options.minibatch)
    sizes = [options.minibatch] * whole
    if rest and whole and options.minibatch_remainder == "joined":
        sizes[-1] += rest
    elif rest:
        sizes.append(rest)
    return sizes


def _layers(flat: torch.Tensor, sizes: Sequence[int]) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Return each layer's matrix (below, width) and bias (width,), as views into one vector."""
    parts = flat.split([(below + 1) * width for below, width in pairwise(sizes)])
    layers = [part.view(-1, width) for part, width in zip(parts, sizes[1:], strict=True)]
    return [(layer[:-1], layer[-1]) for layer in layers]
