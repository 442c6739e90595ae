"""Whatever a state may hold comes back as it was; whatever else is refused by its place."""

import pickle
from collections import OrderedDict
from dataclasses import dataclass

import cloudpickle
import numpy as np
import pytest

from zoac.core.errors import UnsavableError
from zoac.core.state import OwnObject, decode, encode

NUMBERS = [
    0, -1, 2**200, True, 0.1, -0.0, 5e-324, float("inf"), float("nan"), "", "é\ud800", None,
    np.float64(0.1), np.float32(0.1), np.int64(3), np.bool_(True), np.uint8(3), np.complex64(1j),
]  # fmt: skip
ARRAYS = [
    np.zeros(()), np.zeros((0, 3)), np.arange(6.0).reshape(2, 3), np.asfortranarray(np.eye(3)),
    np.arange(6.0).reshape(2, 3).T[::-1], np.array([np.nan, -0.0]), np.array(["a", "bcd"]),
    np.arange(4, dtype=">i2"), np.array([True, False]), np.array([1j]),
]  # fmt: skip


def back(state):
    return decode(encode(state))


@pytest.mark.parametrize("number", NUMBERS, ids=repr)
def test_numbers_and_text_come_back_to_the_bit_and_of_their_type(number):
    found = back(number)
    assert type(found) is type(number)
    assert pickle.dumps(found) == pickle.dumps(number)


@pytest.mark.parametrize("array", ARRAYS, ids=repr)
def test_arrays_come_back_to_the_bit_with_their_layout(array):
    found = back([array, array])[1]
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.tobytes() == array.tobytes()
    assert found.flags.f_contiguous == array.copy("K").flags.f_contiguous or not array.flags.fnc
    found[...] = found  # it may be written to


def test_nested_ones_keep_their_kinds_keys_and_order():
    state = {3: [1, (2, [])], "b": {}, None: ((),), True: {"dict": [[1, 2]], "array": (1,)}}
    assert back(state) == state
    assert list(back(state)) == list(state)
    assert type(back(state)[3][1]) is tuple


@pytest.mark.parametrize("kind", ["PCG64", "MT19937", "Philox", "SFC64", "PCG64DXSM"])
def test_a_generator_goes_on_where_it_stood(kind):
    rng = np.random.Generator(getattr(np.random, kind)(7))
    rng.standard_normal(5)
    rng.integers(3, dtype=np.int32)
    twin = back(rng)
    assert np.array_equal(twin.standard_normal(9), rng.standard_normal(9))


@dataclass
class Own:
    x: int


@pytest.mark.parametrize(
    "thing", [Own(1), {1}, b"x", OrderedDict(), np.array([Own(1)]), np.zeros(1, "i4,f8"), Own, len]
)
def test_anything_else_is_refused_by_its_place_and_nothing_is_pickled(thing, monkeypatch):
    monkeypatch.setattr(cloudpickle, "dumps", None)
    with pytest.raises(
        UnsavableError, match=r"the state\['a'\]\[1\] is a .*zoac.core.state.OwnObject"
    ):
        encode({"a": [0, thing]})


def test_objects_that_belong_together_stay_together_and_apart_from_the_rest():
    one = Own(1)
    encoded = encode({"first": OwnObject(one), "second": (OwnObject([one]), 2.0)})
    assert b"Own" not in encoded.plain
    found = decode(encoded)
    assert found["second"][0].value[0] is found["first"].value
    again = cloudpickle.loads(cloudpickle.dumps(found["first"]))
    assert (type(again), again.value) == (OwnObject, one)


def test_without_objects_there_is_no_pickle():
    assert encode({"a": np.zeros(3)}).objects == b""
