import numpy as np
import pytest

from zoac.algorithm.saturation import Unsaturated


def layer(share, size=48, width=21, inputs=5, above=7, seed=0):
    """Activations of which about `share` is not +-1, and what surrounds them."""
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.normal(size=shape).astype(np.float32)

    activation = np.sign(normal(size, width))
    inside = rng.random((size, width)) < share
    activation[inside] = np.tanh(normal(inside.sum()))
    return activation, normal(size, inputs), normal(size, above), normal(above, width)


@pytest.mark.parametrize("width", [8, 21, 64])
@pytest.mark.parametrize("size", [48, 13])
def test_flow_and_gradient_are_the_dense_products(width, size):
    activation, below, above, matrix = layer(0.02, size, width)
    unsaturated = Unsaturated(48, width)
    flow, gradient = np.full((size, width), np.nan, np.float32), np.full((width, 5), np.nan)
    assert unsaturated.find(activation)
    unsaturated.flow(above, matrix, activation, flow)
    unsaturated.gradient(flow, below, gradient)
    expected = (above @ matrix) * (1 - activation**2)
    np.testing.assert_allclose(flow, expected, rtol=1e-5, atol=1e-6)
    assert flow.any()
    np.testing.assert_allclose(gradient, expected.T @ below, rtol=1e-5, atol=1e-6)


def test_a_layer_saturated_everywhere_passes_nothing():
    activation, below, above, matrix = layer(0.0)
    unsaturated = Unsaturated(48, 21)
    flow, gradient = np.ones((48, 21), np.float32), np.ones((21, 5), np.float32)
    assert unsaturated.find(activation)
    unsaturated.flow(above, matrix, activation, flow)
    unsaturated.gradient(flow, below, gradient)
    assert not flow.any()
    assert not gradient.any()


def test_whether_it_pays_depends_on_the_layer_alone_and_not_on_those_before():
    few, many = layer(0.01)[0], layer(0.3)[0]
    unsaturated = Unsaturated(48, 21)
    found = [unsaturated.find(activation) for activation in (few, many, few, many, many, few)]
    assert found == [True, False, True, False, False, True]


def test_what_is_not_a_number_is_not_taken_for_saturated():
    activation, _, above, matrix = layer(0.0)
    activation[3, 4] = np.nan
    unsaturated = Unsaturated(48, 21)
    flow = np.zeros((48, 21), np.float32)
    assert unsaturated.find(activation)
    unsaturated.flow(above, matrix, activation, flow)
    assert np.isnan(flow[3, 4])
