"""The margins of a PID's loop against python-control and against simulations."""

import math

import numpy as np
import pytest

from zoac.controllers.pid import PID
from zoac.controllers.pid_loop import LoopsPID, SampledLoop
from zoac.envs.linear_loop import LoopVecEnv, sampled
from zoac.specs import loops

control = pytest.importorskip("control")

SAMPLE_TIME = 0.05
PI = {"Kp": 0.8, "Ki": 0.9}
FULL = {"Kp": 1.2, "Ki": 1.1, "Kd": 0.15, "Tf": 0.05}


def plant(dead_time=0.12):
    return sampled(control.tf([2.0], [0.1, 0.7, 1.0]), SAMPLE_TIME, dead_time)


def closed(parameters, dead_time=0.12):
    return SampledLoop(plant(dead_time)).at(PID(sample_time=SAMPLE_TIME), parameters)


def by_control(parameters, dead_time=0.12):
    """Return the open loop as a state-space system of python-control."""
    a, b, c = plant(dead_time).state_space()
    z = control.tf([1, 0], [1], SAMPLE_TIME)
    kp, ki, kd, tf = (parameters.get(name, 0.0) for name in ("Kp", "Ki", "Kd", "Tf"))
    pid = kp + ki * SAMPLE_TIME / (z - 1)
    if kd:
        pid = pid + kd * (z - 1) / ((tf + SAMPLE_TIME) * z - tf)
    return control.ss(a, b[:, None], c[None], 0, SAMPLE_TIME) * control.ss(pid)


@pytest.mark.parametrize(("parameters", "dead_time"), [(FULL, 0.0), (PI, 0.12), (FULL, 0.2)])
def test_margins_are_those_of_python_control(parameters, dead_time):
    loop, theirs = closed(parameters, dead_time), by_control(parameters, dead_time)
    omega = np.logspace(-3, math.log10(math.pi / SAMPLE_TIME), 5001)
    response = control.frd(theirs, omega)
    gain, phase, *_ = control.stability_margins(response)
    assert loops.gain_margin(loop) == pytest.approx(gain, rel=2e-3)
    assert loops.phase_margin(loop) == pytest.approx(phase, abs=0.05)
    values = response.frdata.reshape(-1)
    assert loops.max_sensitivity(loop) == pytest.approx((1 / np.abs(1 + values)).max(), rel=1e-3)
    # control.disk_margins takes continuous loops only; its formula is 1 / |S - 1/2|.
    sensitivity = 1 / (1 + values)
    assert loops.disk_margin(loop) == pytest.approx(1 / np.abs(sensitivity - 0.5).max(), rel=1e-3)
    assert loops.bandwidth(loop) == pytest.approx(
        omega[np.flatnonzero(np.abs(1 - sensitivity) < math.sqrt(0.5))[0]], rel=0.01
    )


@pytest.mark.parametrize("zeta", [0.05, 0.002, 0.0005])
def test_the_peak_of_a_weakly_damped_mode_of_the_plant_is_found(zeta):
    ts = 0.01
    mode = control.tf([-1.8 * zeta * 2500], [1, 100 * zeta, 2500])
    of_mode = sampled(control.tf([0.5], [1, 1]) + mode, ts)
    found = loops.max_sensitivity(SampledLoop(of_mode).at(PID(sample_time=ts), {"Kp": 1.0}))
    z = np.exp(1j * ts * 50 * (1 + zeta * np.linspace(-5, 5, 100001)))
    exact = (1 / np.abs(1 + of_mode.response(z))).max()
    assert exact > 1.3
    assert found == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("name", ["Kp", "Ki", "Kd"])
def test_a_loop_is_unstable_beyond_its_gain_margin_and_in_the_simulation_too(name):
    base = dict(FULL)
    low, high = 1.0, 100.0
    for _ in range(40):  # the factor of one gain at which the loop becomes unstable
        middle = math.sqrt(low * high)
        stable = closed({**base, name: middle * base[name]}).stable
        low, high = (middle, high) if stable else (low, middle)
    stable, loop = (closed({**base, name: f * low * base[name]}) for f in (0.98, 1.02))
    assert stable.stable
    assert not loop.stable
    assert (loops.gain_margin(loop), loops.phase_margin(loop), loops.disk_margin(loop)) == (0, 0, 0)
    assert (loops.max_sensitivity(loop), loops.bandwidth(loop)) == (math.inf, 0.0)
    steps = 2000
    env = LoopVecEnv([plant()], 2, max_episode_steps=steps, load_at=steps)
    controller = LoopsPID(PID(sample_time=SAMPLE_TIME), 1)
    memory, observation, errors = controller.init(2), env.reset(seed=0)[0], []
    values = {key: np.full(2, value) for key, value in base.items()}
    values[name] *= low * np.array([0.98, 1.02])
    for _ in range(steps):
        action, memory, _ = controller.act(values, observation, memory)
        observation, *_ = env.step(action)
        errors.append(np.abs(1.0 - observation[:, 2]))
    early, late = np.max(errors[:200], axis=0), np.max(errors[-200:], axis=0)
    assert (late < early).tolist() == [True, False]


def test_a_loop_without_an_integral_is_stable_without_one():
    assert closed({"Kp": 0.5}).stable
    assert not closed({"Kp": 50.0}).stable


def test_several_loops_act_as_each_alone():
    pid = PID(sample_time=SAMPLE_TIME, r=1, output_limits=(-1.0, 1.0))
    rng = np.random.default_rng(0)
    many, one = LoopsPID(pid, 3), pid
    memory, alone = many.init(2), [one.init(2) for _ in range(3)]
    params = {name: np.array([value, 2 * value]) for name, value in FULL.items()}
    for _ in range(20):
        y, r = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
        u, memory, _ = many.act(params, np.concatenate([y, r, y], axis=1), memory)
        for k in range(3):
            expected, alone[k], _ = one.act(params, np.stack([y[:, k], r[:, k]], 1), alone[k])
            assert np.array_equal(u[:, k], expected[:, 0])
