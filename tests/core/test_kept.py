"""A state that is a copy of attributes."""

from dataclasses import dataclass

import numpy as np

from zoac.core.state import Kept, decode, encode


@dataclass(frozen=True)
class Pair:
    low: float
    array: np.ndarray


class Inner(Kept):
    kept = "array"

    def __init__(self):
        self.array = np.zeros(2)


class Base(Kept):
    kept = "_rng _pair"

    def __init__(self):
        self._rng, self._pair = np.random.default_rng(0), Pair(1.0, np.ones(2))


class Outer(Base):
    kept = "_list _inner _none"

    def __init__(self):
        super().__init__()
        self._list, self._inner, self._none, self.other = [np.arange(3)], Inner(), None, 5


def disturb(made):
    """Change everything in place."""
    made._list[0] += 1
    made._list.append(7)
    made._pair.array[:] = 9.0
    made._inner.array += 1
    return made._rng.random()


def test_what_classes_and_their_bases_name_is_saved_and_restored_as_copies():
    made = Outer()
    state = made.state()
    assert set(state) == {"_rng", "_pair", "_list", "_inner", "_none"}
    encoded = encode(state)
    drawn = disturb(made)
    assert encode(state) == encoded  # the state did not change with the object
    twin = Outer()
    disturb(twin)
    state = decode(encoded)
    twin.restore(state)
    np.testing.assert_equal(twin.state(), decode(encoded))
    assert isinstance(twin._pair, Pair)
    assert disturb(twin) == drawn
    np.testing.assert_equal(twin.state(), made.state())
    np.testing.assert_equal(state, decode(encoded))  # nor with what was restored from it
