import numpy as np
import pytest

from zoac.core.types import is_number


@pytest.mark.parametrize("value", [1, 1.5, float("nan"), np.float32(1), np.int64(3)])
def test_real_numbers_are_numbers(value):
    assert is_number(value)


@pytest.mark.parametrize("value", [True, np.bool_(True), "1", None, 1j, np.complex64(1), [1.0]])
def test_nothing_else_is(value):
    assert not is_number(value)
