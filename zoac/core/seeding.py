"""Named random streams: every random number of a run comes from one of them.

A stream is named by its purpose and an index, so adding an environment or a tuner that draws more
numbers never shifts anybody else's stream.
"""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def global_random_kept() -> Iterator[None]:
    """Leave numpy's global random state as it is, whatever a library draws from it."""
    state = np.random.get_state()  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002


def stream_seed(seed: int, name: str, index: int = 0) -> int:
    """Return the 128-bit integer seed of stream `name[index]` under the run's `seed`.

    Integers, unlike generators, are what Gymnasium's `reset(seed=...)` takes.
    """
    sequence = np.random.SeedSequence([seed, zlib.crc32(name.encode()), index])
    return int.from_bytes(sequence.generate_state(4).tobytes(), "little")


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return a fresh generator at the beginning of stream `name[index]`."""
    return np.random.Generator(np.random.PCG64(stream_seed(seed, name, index)))
