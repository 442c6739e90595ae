import math

import numpy as np
import pytest

import zoac
from tests.analysis.folders import GAINS
from zoac.analysis.data import replay
from zoac.tasks.mpc_tracking import figures as tracking_figures
from zoac.tasks.mpc_tracking import path
from zoac.tasks.pid_acc import PidAcc
from zoac.tasks.pid_acc import figures as following_figures
from zoac.tasks.pid_acc.plant import demonstration_profile
from zoac.tasks.rendering import OTHER, frame


def middle_of(picture, colour):
    """Return the mean (row, column) of the pixels that have `colour`."""
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return np.argwhere((np.abs(picture.astype(int) - wanted) < 6).all(axis=2)).mean(axis=0)


def following(clearance_error):
    observation = np.zeros(10)
    observation[:2] = clearance_error, 0.1
    return frame(lambda axes: following_figures.draw(axes, observation))


def tracking(off, turned=0.0):
    x = 5.0
    y, phi = path.lateral(x) + off, path.heading(x) + turned
    states = np.array([[x, y, phi, 18.0, 0.0, 0.0]])
    return frame(lambda axes: tracking_figures.draw(axes, states, 0.0))


def test_a_picture_is_rgb_and_depends_on_nothing_but_its_state():
    picture = following(1.0)
    assert (picture.shape, picture.dtype) == ((240, 640, 3), np.uint8)
    np.testing.assert_array_equal(picture, following(1.0))


def test_the_preceding_car_stands_where_the_clearance_error_says():
    near, far = (middle_of(following(dd), OTHER)[1] for dd in (-2.0, 3.0))
    dots_per_metre = 640 / 34  # 34 m across
    assert far - near == pytest.approx(5.0 * dots_per_metre, abs=1.5)


def test_the_path_lies_to_the_left_of_a_car_right_of_it():
    rows = []
    for off in (-2.0, 2.0):
        picture = tracking(off).astype(int)
        orange = picture[:, 200:240, 0] - picture[:, 200:240, 2] > 80  # just ahead of the car
        rows.append(np.argwhere(orange)[:, 0].mean())
    assert rows[0] < 120 < rows[1]


def test_a_car_that_turns_left_points_up():
    car = np.argwhere(np.abs(tracking(0.0, 0.6).astype(int) - (0, 114, 178)).max(axis=2) < 6)
    rows, columns = car[car[:, 0] < 180].T
    assert np.polyfit(columns, rows, 1)[0] < -0.3


def test_traces_of_car_following_show_the_profile_it_followed():
    task = PidAcc(max_episode_steps=100)
    (segment,) = replay.demonstrate(task, [GAINS])
    clearance, _, acceleration, command = task.traces(segment)
    assert acceleration.reference is not None
    np.testing.assert_allclose(acceleration.reference[1], demonstration_profile(100), atol=1e-12)
    np.testing.assert_array_equal(clearance.y, segment.observations[:, 0])
    applied = np.cumsum(segment.actions[:, 0])
    np.testing.assert_allclose(command.y, applied, atol=1e-12)  # no bound is reached


def test_traces_of_tracking_begin_at_the_demonstration_start():
    task = zoac.make_task("mpc_tracking", max_episode_steps=2)
    assert task.baseline is not None
    (segment,) = replay.demonstrate(task, [task.baseline])
    traces = {trace.title: trace for trace in task.traces(segment)}
    assert traces["Lateral error [m]"].y[0] == pytest.approx(0.25)
    assert traces["Heading error [°]"].y[0] == pytest.approx(math.degrees(0.04))
    assert traces["Speed error [m/s]"].y[0] == pytest.approx(-0.4)
    assert len(traces["Steering angle [°]"].y) == 2
