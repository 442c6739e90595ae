import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter, ParameterSpace, choice, integer

SPACE = ParameterSpace(
    [
        Parameter("gain", 0.0, 10.0),
        Parameter("stiffness", -16e4, -8e4, unit="N/rad"),
        Parameter("weight", 1e-6, 1e2, "log"),
    ]
)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_normalise_inverts_denormalise(x):
    np.testing.assert_allclose(SPACE.normalise(SPACE.denormalise(np.array(x))), x, atol=1e-12)


def test_ends_of_the_box_are_the_bounds_exactly():
    ends = SPACE.values(np.array([[-1.0] * 3, [1.0] * 3]))
    assert ends.tolist() == [[0.0, -16e4, 1e-6], [10.0, -8e4, 1e2]]


def test_middle_is_arithmetic_or_geometric_mean():
    middle = SPACE.denormalise(np.zeros(3))
    assert middle["gain"] == pytest.approx(5.0)
    assert middle["stiffness"] == pytest.approx(-12e4)
    assert middle["weight"] == pytest.approx(1e-2)


def test_a_log_scale_below_zero_is_one_by_magnitude():
    space = ParameterSpace([Parameter("k", -100.0, -1.0, "log")])
    x = np.array([[-1.0], [0.0], [1.0]])
    assert space.values(x)[:, 0] == pytest.approx([-100.0, -10.0, -1.0])
    assert space.normalise({"k": space.values(x)[:, 0]}) == pytest.approx(x)


def test_values_outside_the_box_are_clipped():
    assert np.array_equal(SPACE.values(np.full(3, 7.0)), SPACE.values(np.ones(3)))


def test_denormalise_keeps_leading_shape():
    assert SPACE.denormalise(np.zeros((4, 2, 3)))["weight"].shape == (4, 2)


def test_mapping_leaves_its_argument_alone():
    x = np.array([2.0, 0.5, 0.5])
    SPACE.values(x)
    assert x.tolist() == [2.0, 0.5, 0.5]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("g", 1.0, 1.0), "lower bound must be below"),
        (("g", 2.0, 1.0), "lower bound must be below"),
        (("g", 0.0, 1.0, "log"), "positive lower bound"),
        (("g", -1.0, 1.0, "log"), "or a negative upper one"),
        (("g", 0.0, float("inf")), "must be finite"),
        (("g", 0.0, 1.0, "lgo"), "did you mean 'log'"),
    ],
)
def test_impossible_bounds_are_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        Parameter(*arguments)


def test_unknown_name_gets_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'gain'"):
        SPACE.normalise({"gian": 1.0})


def test_value_outside_its_bounds_is_named_with_unit():
    values = {"gain": 1.0, "stiffness": 0.0, "weight": 1.0}
    with pytest.raises(ConfigError, match=r"'stiffness': 0.0 lies outside .* N/rad"):
        SPACE.normalise(values)


def test_names_must_differ():
    with pytest.raises(ConfigError, match="repeated: g"):
        ParameterSpace([Parameter("g", 0, 1), Parameter("g", 0, 2)])


@pytest.mark.parametrize("method", ["clip", "values", "rounded", "denormalise", "named"])
def test_what_is_no_number_is_refused_and_named(method):
    space = ParameterSpace([Parameter("kp", 0, 1), choice("mode", ["a", "b"]), integer("n", 1, 3)])
    for place, name in enumerate(("kp", "mode=a", "mode=b", "n")):
        x = np.zeros(4)
        x[place] = np.nan
        with pytest.raises(ConfigError, match=f"got NaN for {name}$"):
            getattr(space, method)(x)
