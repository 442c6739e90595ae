"""Value targets (eq. 7) and advantages (eq. 9), from segments and the critic's values.

Costs are minimised, so values are costs to go and an advantage below zero is an improvement.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from zoac.core.segments import Segment


def residuals(segment: Segment, values: np.ndarray, gamma: float) -> np.ndarray:
    """Return delta_k = r_k + gamma V(s_{k+1}) - V(s_k), shape (T,).

    Termination does not bootstrap: nothing follows it. Truncation at the time limit and the cut
    at the end of a segment do, for the episode would have gone on.

    Args:
        segment: T steps.
        values: The critic's values (T + 1,) of the segment's observations.
        gamma: Discount factor.
    """
    following = values[1:].copy()
    if segment.terminated:
        following[-1] = 0.0
    return segment.costs + gamma * following - values[:-1]


def value_targets(deltas: np.ndarray, values: np.ndarray, decay: float) -> np.ndarray:
    """Return the target (eq. 7) of each state of a piece of episode, shape (T,).

    Args:
        deltas: Residuals (T,) along the piece.
        values: The critic's values (T,) of its states.
        decay: gamma lambda.
    """
    targets = np.empty(len(deltas))
    total = 0.0
    for k in range(len(deltas) - 1, -1, -1):
        total = deltas[k] + decay * total
        targets[k] = values[k] + total
    return targets


def pieces(segments: Sequence[Segment]) -> Iterable[list[int]]:
    """Yield lists of indices of segments that follow each other in one environment and one episode.

    A segment after which the environment was restored stands by itself: what the environment did
    next does not follow from it.
    """
    chains: dict[int, list[int]] = {}
    for index, segment in enumerate(segments):
        if segment.proposal.restore:
            yield [index]
            continue
        env_index = segment.proposal.env_index
        chain = chains.setdefault(env_index, [])
        if chain and segment.starts_episode:
            yield chain
            chain = chains[env_index] = []
        chain.append(index)
    yield from chains.values()


def estimate(
    segments: Sequence[Segment], values: Sequence[np.ndarray], gamma: float, lam: float
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the advantages (eq. 9) and the value targets (eq. 7) of an iteration.

    Args:
        segments: In the order in which their environments ran them.
        values: The critic's values of each segment's observations, (T + 1,) each.
        gamma: Discount factor.
        lam: GAE's lambda.

    Returns:
        One advantage per segment, (number of segments,); and per segment its targets, (T,).
    """
    decay = gamma * lam
    deltas = [residuals(s, v, gamma) for s, v in zip(segments, values, strict=True)]
    advantages = np.array([d @ decay ** np.arange(len(d)) for d in deltas])  # eq. (9)
    targets: list[np.ndarray] = [np.empty(0)] * len(segments)
    for piece in pieces(segments):
        together = value_targets(
            np.concatenate([deltas[i] for i in piece]),
            np.concatenate([values[i][:-1] for i in piece]),
            decay,
        )
        ends = np.cumsum([segments[i].length for i in piece])
        for i, part in zip(piece, np.split(together, ends[:-1]), strict=True):
            targets[i] = part
    return advantages, targets
