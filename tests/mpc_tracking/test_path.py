"""The reference path against its formula in SPEC."""

import numpy as np

from zoac.tasks.mpc_tracking import path

X = np.linspace(-300.0, 1500.0, 400)


def y_r(x: np.ndarray) -> np.ndarray:
    return (
        7.5 * np.sin(2 * np.pi * x / 200)
        + 2.5 * np.sin(2 * np.pi * x / 300)
        - 5 * np.sin(2 * np.pi * x / 400)
    )


def test_height_is_the_sum_of_three_sines() -> None:
    np.testing.assert_allclose([path.lateral(x) for x in X], y_r(X), atol=1e-13)


def test_heading_is_the_direction_of_the_path() -> None:
    slope = (y_r(X + 1e-4) - y_r(X - 1e-4)) / 2e-4
    np.testing.assert_allclose([path.heading(x) for x in X], np.arctan(slope), atol=1e-9)


def test_preview_goes_on_at_reference_speed_from_the_cars_own_x() -> None:
    points = np.empty(75)
    path.preview(12.3, points)
    x = 12.3
    for x_r, y, phi in points.reshape(25, 3):
        x += 18.0 * 0.1 * np.cos(path.heading(x))
        np.testing.assert_allclose([x_r, y, phi], [x, y_r(x), path.heading(x)], rtol=1e-12)
