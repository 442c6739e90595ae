"""The critic V_w(s): a tanh network fitted to value targets (eq. 8).

Tens of thousands of minibatch steps on a small network are most of the time of a tuning run, so
the gradient is written out for this one architecture instead of traced by autograd, all weights
live in one flat tensor that Adam updates in a single call, what is no matrix product is fused, and
what saturation makes zero is not computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit

from zoac.algorithm.adam import Adam
from zoac.algorithm.saturation import Unsaturated

_CHUNK = 4096

# The number of threads changes the order of sums and so the bits; one is also the fastest for
# matrices this small when several runs share the machine.
torch.set_num_threads(1)


class Critic:
    """V_w(s): observation -> tanh layers -> one number, in float32.

    Initialised orthogonally: gain 5/3 in the hidden layers, 1 in the last, biases 0.
    """

    def __init__(
        self,
        observation_size: int,
        hidden: Sequence[int],
        learning_rate: float,
        epochs: int,
        minibatch: int,
        rng: np.random.Generator,
        normalise_observations: bool = False,
        target_scale: float = 1.0,
    ) -> None:
        """
        Args:
            observation_size: Length o of an observation.
            hidden: Widths of the hidden layers.
            learning_rate: Adam's step size.
            epochs: M, passes over an iteration's states.
            minibatch: L, states per gradient step.
            rng: Stream for initial weights and minibatches.
            normalise_observations: Shift and scale observations by running statistics.
            target_scale: Factor on the targets inside the network, for costs far from 1.
        """
        self._rng = rng
        self._epochs = epochs
        self._minibatch = minibatch
        self._target_scale = target_scale
        self._statistics = RunningStatistics(observation_size) if normalise_observations else None
        sizes = [observation_size, *hidden, 1]
        shapes = [s for i, o in pairwise(sizes) for s in ((o, i), (o,))]
        count = sum(math.prod(shape) for shape in shapes)
        self._weights = torch.zeros(count)
        self._gradient = torch.zeros(count)
        views = _views(self._weights, shapes)
        self._matrices, self._biases = views[::2], views[1::2]
        views = _views(self._gradient, shapes)
        self._matrix_gradients, self._bias_gradients = views[::2], views[1::2]
        generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
        for matrix in self._matrices:
            gain = 1.0 if matrix is self._matrices[-1] else 5 / 3
            torch.nn.init.orthogonal_(matrix, gain=gain, generator=generator)
        # Kept: memory of this size would go back to the system and come again at every step, and
        # a view takes as long as a small product.
        self._transposed = [matrix.t() for matrix in self._matrices[:-1]]
        self._row, self._row_gradient = self._matrices[-1][0], self._matrix_gradients[-1][0]
        self._matrix_arrays = [matrix.numpy() for matrix in self._matrices]
        self._matrix_gradient_arrays = [matrix.numpy() for matrix in self._matrix_gradients]
        # The last hidden layer's flow comes from a product with one row and is never worth it.
        self._unsaturated = [Unsaturated(minibatch, width) for width in hidden[:-1]]
        self._work = _Work.of(
            self._layers(minibatch),
            self._layers(minibatch),
            torch.empty(minibatch),
            torch.empty(minibatch),
        )
        self._arrays = self._weights.numpy(), self._gradient.numpy()
        self._output = self._biases[-1].numpy(), self._row.numpy()
        self._learning_rate = learning_rate
        self._adam = Adam(self._weights.numpy())

    @torch.no_grad()
    def values(self, observations: np.ndarray) -> np.ndarray:
        """Return V_w of observations (B, o), shape (B,), float64."""
        parts = []
        # Slices of bounded size: fast in cache, and bits that do not depend on B's neighbours.
        for part in self._inputs(observations).split(_CHUNK):
            hidden = self._layers(len(part))
            self._activate(part, hidden)
            parts.append(torch.mv(hidden[-1], self._row).add_(self._biases[-1]))
        return torch.cat(parts).double().numpy() / self._target_scale

    @torch.no_grad()
    def fit(self, observations: np.ndarray, targets: np.ndarray) -> float:
        """Minimise eq. (8) by M epochs of minibatch steps; return the mean loss of the last.

        Args:
            observations: States (B, o).
            targets: Value targets (B,).
        """
        inputs = self._inputs(observations)
        scaled = (targets * self._target_scale).astype(np.float32)
        shuffled = torch.empty_like(inputs)
        squares = 0.0
        for epoch in range(self._epochs):
            order = self._rng.permutation(len(inputs))
            torch.index_select(inputs, 0, torch.from_numpy(order), out=shuffled)
            wanted = scaled[order]
            for number, states in enumerate(shuffled.split(self._minibatch)):
                first = number * self._minibatch
                error = self._step(states, wanted[first : first + len(states)])
                if epoch == self._epochs - 1:
                    squares += float(error.dot(error))
        return 0.5 * squares / len(inputs) / self._target_scale**2

    def learn_scale(self, observations: np.ndarray) -> None:
        """Take observations (B, o) into the running statistics, if they are in use."""
        if self._statistics is not None:
            self._statistics.update(observations)

    def _inputs(self, observations: np.ndarray) -> torch.Tensor:
        if self._statistics is not None:
            observations = self._statistics.normalised(observations)
        return torch.from_numpy(observations.astype(np.float32))

    def _layers(self, size: int) -> list[torch.Tensor]:
        return [torch.empty(size, len(matrix)) for matrix in self._matrices[:-1]]

    def _activate(self, inputs: torch.Tensor, hidden: Sequence[torch.Tensor]) -> None:
        """Write the hidden layers' activations to `hidden`, (B, width) each."""
        below = inputs
        for matrix, bias, out in zip(self._transposed, self._biases[:-1], hidden, strict=True):
            below = torch.addmm(bias, below, matrix, out=out).tanh_()

    def _step(self, inputs: torch.Tensor, targets: np.ndarray) -> torch.Tensor:
        """One Adam step on the mean of 0.5 (V - G)^2; return V - G before it, (B,)."""
        work, size = self._work, len(inputs)
        if size < self._minibatch:  # the last of an epoch
            work = work.first(size)
        self._activate(inputs, work.hidden)
        torch.mv(work.hidden[-1], self._row, out=work.values)
        activations, flows = work.activations, work.flow_arrays
        _output_flow(*work.end_arrays, flows[-1], activations[-1], targets, *self._output)
        torch.mv(work.hidden_transposed[-1], work.slope, out=self._row_gradient)
        torch.sum(work.slope, 0, keepdim=True, out=self._bias_gradients[-1])
        few = False  # places at which this layer's flow is not 0
        for layer in range(len(work.hidden) - 1, -1, -1):
            below = inputs if layer == 0 else work.hidden[layer - 1]
            if few:
                self._unsaturated[layer].gradient(
                    flows[layer], below.numpy(), self._matrix_gradient_arrays[layer]
                )
            else:
                torch.mm(work.flows_transposed[layer], below, out=self._matrix_gradients[layer])
            torch.sum(work.flows[layer], 0, out=self._bias_gradients[layer])
            if layer == 0:
                break
            unsaturated, activation = self._unsaturated[layer - 1], activations[layer - 1]
            few = unsaturated.find(activation)
            if few:
                matrix = self._matrix_arrays[layer]
                unsaturated.flow(flows[layer], matrix, activation, flows[layer - 1])
            else:
                torch.mm(work.flows[layer], self._matrices[layer], out=work.flows[layer - 1])
                _through_tanh(flows[layer - 1], activation)
        self._adam.descend(*self._arrays, self._learning_rate)
        return work.values

    def state(self) -> dict[str, Any]:
        """Return a copy: weights, Adam's moments, random stream, statistics."""
        return {
            "weights": self._weights.numpy().copy(),
            "adam": self._adam.state(),
            "rng": self._rng.bit_generator.state,
            "statistics": None if self._statistics is None else self._statistics.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Put back what `state` returned."""
        self._weights.copy_(torch.from_numpy(state["weights"]))
        self._adam.restore(state["adam"])
        self._rng.bit_generator.state = state["rng"]
        if self._statistics is not None:
            self._statistics.restore(state["statistics"])


class _Work(NamedTuple):
    """A minibatch's memory, for each hidden layer (B, width), with its views."""

    hidden: list[torch.Tensor]
    """Activations."""
    flows: list[torch.Tensor]
    """Gradients of the loss at what enters the activation."""
    hidden_transposed: list[torch.Tensor]
    flows_transposed: list[torch.Tensor]
    values: torch.Tensor
    """V_w, then the error, (B,)."""
    slope: torch.Tensor
    """Gradient of the loss at V_w, (B,)."""
    activations: list[np.ndarray]
    flow_arrays: list[np.ndarray]
    end_arrays: tuple[np.ndarray, np.ndarray]
    """`hidden`, `flows`, `values` and `slope` as numba reads them."""

    @classmethod
    def of(
        cls,
        hidden: list[torch.Tensor],
        flows: list[torch.Tensor],
        values: torch.Tensor,
        slope: torch.Tensor,
    ) -> _Work:
        return cls(
            hidden,
            flows,
            [part.t() for part in hidden],
            [part.t() for part in flows],
            values,
            slope,
            [part.numpy() for part in hidden],
            [part.numpy() for part in flows],
            (values.numpy(), slope.numpy()),
        )

    def first(self, size: int) -> _Work:
        """Return the part for a smaller minibatch."""
        return _Work.of(
            [part[:size] for part in self.hidden],
            [part[:size] for part in self.flows],
            self.values[:size],
            self.slope[:size],
        )


class RunningStatistics:
    """Mean and variance of all observations so far (Chan et al.'s parallel update)."""

    def __init__(self, size: int) -> None:
        self._count = 0
        self._mean = np.zeros(size)
        self._squares = np.zeros(size)  # sum of squared deviations from the mean

    def update(self, observations: np.ndarray) -> None:
        """Take in observations (B, o)."""
        count = len(observations)
        mean = observations.mean(axis=0)
        total = self._count + count
        shift = mean - self._mean
        self._squares += ((observations - mean) ** 2).sum(axis=0)
        self._squares += shift**2 * self._count * count / total
        self._mean = self._mean + shift * count / total
        self._count = total

    def normalised(self, observations: np.ndarray) -> np.ndarray:
        """Return observations (B, o) at mean 0 and standard deviation 1, clipped at 10."""
        if self._count == 0:
            return observations
        deviation = np.sqrt(self._squares / self._count) + 1e-8
        return np.clip((observations - self._mean) / deviation, -10.0, 10.0)

    def state(self) -> tuple[int, np.ndarray, np.ndarray]:
        """Return a copy of count, mean and sum of squares."""
        return self._count, self._mean.copy(), self._squares.copy()

    def restore(self, state: tuple[int, np.ndarray, np.ndarray]) -> None:
        """Put back what `state` returned."""
        self._count, self._mean, self._squares = state[0], state[1].copy(), state[2].copy()


def _views(flat: torch.Tensor, shapes: Sequence[tuple[int, ...]]) -> list[torch.Tensor]:
    parts = flat.split([math.prod(shape) for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


# Products and sums may be contracted to fused ones, as torch's own loops do.
@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _output_flow(
    error: np.ndarray,
    slope: np.ndarray,
    flow: np.ndarray,
    activation: np.ndarray,
    targets: np.ndarray,
    bias: np.ndarray,
    row: np.ndarray,
) -> None:
    """From the last hidden layer's `activation` (B, width) and its product with `row` in `error`:
    write V - G to `error` (B,), the loss's gradient at V to `slope` (B,), and the one at what
    enters the activation to `flow` (B, width); tanh' = 1 - tanh^2."""
    size, one = np.float32(len(error)), np.float32(1.0)
    for i in range(len(error)):
        error[i] = error[i] + bias[0] - targets[i]
        slope[i] = error[i] / size
        for j in range(len(row)):
            y = activation[i, j]
            flow[i, j] = slope[i] * row[j] * (one - y * y)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _through_tanh(flow: np.ndarray, activation: np.ndarray) -> None:
    """Take the loss's gradient at the activation, `flow` (B, width), to what enters it."""
    one = np.float32(1.0)
    for i in range(len(flow)):
        for j in range(flow.shape[1]):
            y = activation[i, j]
            flow[i, j] *= one - y * y
