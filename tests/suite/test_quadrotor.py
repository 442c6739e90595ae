"""The quadrotor beside RotorPy's own code."""

import numpy as np
import pytest

from zoac.tasks.suite import quadrotor

pytest.importorskip("rotorpy", reason="the quadrotor's equations are compared with RotorPy's")

from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

PUBLISHED = {
    "kp_xy": 6.5, "kp_z": 15.0, "kd_xy": 4.0, "kd_z": 9.0, "kp_att": 310.0, "kd_att": 57.0,
}  # fmt: skip
"""RotorPy's gains."""
WITHOUT_GAINS = {k: v for k, v in quad_params.items() if k not in ("kp_att", "kd_att")}


@pytest.fixture(params=range(3))
def flight(request):
    """A state (17,), a command (4,) and wind (3,), and RotorPy's state."""
    rng = np.random.default_rng(request.param)
    state, wind = rng.normal(size=17), rng.normal(size=3)
    state[6:10] /= np.linalg.norm(state[6:10])
    state[13:17] = rng.uniform(0.0, quadrotor.MAX_SPEED, 4)
    x, v, q, w, speeds = np.split(state, [3, 6, 10, 13])
    theirs = {"x": x, "v": v, "q": q, "w": w, "wind": wind, "rotor_speeds": speeds}
    return state, rng.uniform(0.0, quadrotor.MAX_SPEED, 4), wind, theirs


def test_forces_and_moments_are_rotorpys(flight):
    state, command, wind, theirs = flight
    expected = Multirotor(quad_params).statedot(theirs, {"cmd_motor_speeds": command}, 0.01)
    found = quadrotor.rates(state, command, wind)
    np.testing.assert_allclose(found[3:6], expected["vdot"], rtol=1e-9)
    np.testing.assert_allclose(found[10:13], expected["wdot"], rtol=1e-9)


def test_a_sample_is_rotorpys_by_exact_integration(flight):
    state, command, wind, theirs = flight
    vehicle = Multirotor(quad_params, integrator_kwargs={"rtol": 1e-10, "atol": 1e-10})
    after = vehicle.step(theirs, {"cmd_motor_speeds": command}, quadrotor.SAMPLE_TIME)
    expected = np.concatenate([after[name] for name in ("x", "v", "q", "w", "rotor_speeds")])
    found = quadrotor.advanced(state, command, wind)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=2e-3)


def test_the_controller_is_rotorpys(flight):
    state, _, _, theirs = flight
    reference = np.arange(9.0) / 5.0
    x, v, a = reference[:3], reference[3:6], reference[6:]
    goal = {"x": x, "x_dot": v, "x_ddot": a, "yaw": 0.0, "yaw_dot": 0.0}
    expected = SE3Control(WITHOUT_GAINS).update(0.0, theirs, goal)["cmd_motor_speeds"]
    found = quadrotor.fly(PUBLISHED, np.concatenate([state, reference]))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_reference_has_the_derivatives_of_the_curve():
    env = quadrotor.Quadrotor()
    env.reset(seed=0)
    curve = []
    for count in range(3):
        env._count = count
        env._follow()
        curve.append(env._reference)
    before, now, after = curve
    h = quadrotor.SAMPLE_TIME
    np.testing.assert_allclose((after[:3] - before[:3]) / (2 * h), now[3:6], atol=1e-3)
    np.testing.assert_allclose((after[3:6] - before[3:6]) / (2 * h), now[6:9], atol=1e-2)


def test_the_published_gains_follow_the_curve():
    env = quadrotor.Quadrotor()
    observation, _ = env.reset(seed=0)
    for _ in range(quadrotor.STEPS):
        action = np.clip(quadrotor.fly(PUBLISHED, observation), 0.0, quadrotor.MAX_SPEED)
        observation, _, lost, _, _ = env.step(action)
        assert not lost
    assert np.linalg.norm(observation[:3] - observation[17:20]) < 0.25
