"""Tasks of the suite. None of them tells a tuner any gains: they have no baseline."""

from __future__ import annotations

import numpy as np

from zoac.controllers.neural import linear
from zoac.controllers.pid import PID
from zoac.core.types import Count, Natural, Positive
from zoac.rollout.task import Task
from zoac.tasks.given_task import make_task
from zoac.tasks.pid_loop import Design, designed
from zoac.tasks.suite import reactor, water_tank
from zoac.tasks.suite.loops import draw
from zoac.tasks.user_task import user_task

LANDER = {
    "angle_x": 0.5, "angle_vx": 1.0, "max_angle": 0.4, "hover_x": 0.55, "kp_angle": 0.5,
    "kd_angle": 1.0, "kp_hover": 0.5, "kd_hover": 0.5, "leg_angle": 0.0, "leg_hover": 0.5,
    "main_above": 0.05, "side_above": 0.05,
}  # fmt: skip
"""The numbers of Gymnasium's own heuristic (`gymnasium.envs.box2d.lunar_lander.heuristic`)."""


def built_in(name: str, mpc_solver: str | None) -> Task:
    """Return a task of `zoac.tasks` without its baseline.

    Args:
        name: As in `task=`.
        mpc_solver: As in `mpc_solver=`, of a task with an MPC; else None.
    """
    task = make_task(name) if mpc_solver is None else make_task(name, mpc_solver=mpc_solver)
    task.baseline = None
    return task


def loop(index: Natural) -> Task:
    """Return a PI or PID for a plant of `zoac.tasks.suite.loops`, tuned for its absolute error.

    Args:
        index: Number of the plant.
    """
    plant = draw(index)
    design = Design(
        [plant.system], [plant.dead_time], plant.sample_time, plant.structure, plant.input_limits,
        plant.noise,
    )  # fmt: skip
    task, _ = designed(design, "simc")
    task.specs, task.signals = (), {}  # the environment's own cost is that integral
    task.baseline = None
    return task


def tank() -> Task:
    """Return a PI for MathWorks' water tank."""
    return user_task(
        env=water_tank.WaterTank,
        controller=PID(sample_time=water_tank.SAMPLE_TIME, r=1),
        space=water_tank.SPACE,
        max_episode_steps=water_tank.STEPS,
    )


def stirred_tank() -> Task:
    """Return a PID for the stirred tank: cooling less raises the temperature and lowers C."""
    return user_task(
        env=reactor.StirredTank,
        controller=PID(sample_time=reactor.SAMPLE_TIME, r=1),
        space={"Kp": (-500.0, 0.0), "Ki": (-500.0, 0.0), "Kd": (-200.0, 0.0)},
        max_episode_steps=reactor.STEPS,
    )


def hummingbird() -> Task:
    """Return RotorPy's geometric controller for a quadrotor in wind."""
    from zoac.tasks.suite import quadrotor  # no other problem waits for Numba's import

    return user_task(
        env=quadrotor.Quadrotor,
        controller=quadrotor.fly,
        space=quadrotor.SPACE,
        max_episode_steps=quadrotor.STEPS,
    )


def policy(env: str, steps: Count, bound: Positive) -> Task:
    """Return a linear policy for an environment of Gymnasium.

    Args:
        env: Its id.
        steps: Time limit of an episode.
        bound: Weights lie in [-bound, bound].
    """
    controller, space = linear(env, bound=bound)
    return user_task(env=env, controller=controller, space=space, max_episode_steps=steps)


def land(p: dict[str, float], s: np.ndarray) -> int:
    """Return the engine that Gymnasium's heuristic fires, with the numbers `p`."""
    angle = np.clip(s[0] * p["angle_x"] + s[2] * p["angle_vx"], -p["max_angle"], p["max_angle"])
    turn = (angle - s[4]) * p["kp_angle"] - s[5] * p["kd_angle"]
    lift = (p["hover_x"] * abs(s[0]) - s[1]) * p["kp_hover"] - s[3] * p["kd_hover"]
    if s[6] or s[7]:
        turn, lift = p["leg_angle"], -s[3] * p["leg_hover"]
    if lift > abs(turn) and lift > p["main_above"]:
        return 2
    if abs(turn) > p["side_above"]:
        return 3 if turn < 0 else 1
    return 0


def lander() -> Task:
    """Return Gymnasium's heuristic for LunarLander-v3, its twelve numbers to be tuned."""
    return user_task(
        env="LunarLander-v3",
        controller=land,
        space=dict.fromkeys(LANDER, (0.0, 1.2)),
        max_episode_steps=400,
    )
