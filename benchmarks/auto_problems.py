"""Problems on which the rule of `tuner="auto"` is measured: 1 to 12 parameters.

`benchmarks.auto_tuner` tunes them.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial

import numpy as np

from benchmarks import water_tank
from benchmarks.loop_plants import draw
from zoac.controllers.neural import linear
from zoac.controllers.pid import PID
from zoac.rollout.task import Task
from zoac.tasks.given_task import make_task
from zoac.tasks.pid_loop import Design, designed
from zoac.tasks.user_task import user_task

LANDER_STEPS = 400


def loop(index: int, structure: str) -> Task:
    """Return a PID for a plant of the suite of loops, its cost the integral of the absolute error.

    Args:
        index: Of the plant.
        structure: "P", "PI" or "PID".
    """
    plant = draw(index)
    design = Design(
        [plant.system], [plant.dead_time], plant.sample_time, structure, plant.input_limits,
        plant.noise,
    )  # fmt: skip
    task = copy(designed(design, "simc")[0])
    task.specs, task.signals = (), {}  # the environment's own cost is that integral
    return task


def tank() -> Task:
    """Return MathWorks' water tank, of which every episode has another reference."""
    return user_task(
        env=water_tank.WaterTank,
        controller=PID(sample_time=water_tank.SAMPLE_TIME, r=1),
        space=water_tank.SPACE,
        max_episode_steps=water_tank.STEPS,
    )


def policy(env: str, steps: int, bound: float = 1.0) -> Task:
    """Return a linear policy for an environment of Gymnasium."""
    controller, space = linear(env, bound=bound)
    return user_task(env=env, controller=controller, space=space, max_episode_steps=steps)


LANDER = {
    "angle_x": 0.5, "angle_vx": 1.0, "max_angle": 0.4, "hover_x": 0.55, "kp_angle": 0.5,
    "kd_angle": 1.0, "kp_hover": 0.5, "kd_hover": 0.5, "leg_angle": 0.0, "leg_hover": 0.5,
    "main_above": 0.05, "side_above": 0.05,
}  # fmt: skip
"""The numbers of Gymnasium's own heuristic (`gymnasium.envs.box2d.lunar_lander.heuristic`)."""


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
        max_episode_steps=LANDER_STEPS,
    )


PROBLEMS: dict[str, Callable[[], Task]] = {
    "loop 0, P": partial(loop, 0, "P"),
    "lqr": partial(make_task, "lqr"),
    "water tank, PI": tank,
    "loop 1, PI": partial(loop, 1, "PI"),
    "loop 7, PID": partial(loop, 7, "PID"),
    "pid_acc": partial(make_task, "pid_acc"),
    "pendulum": partial(make_task, "pendulum"),
    "CartPole, linear": partial(policy, "CartPole-v1", 200),
    "lane_change": partial(make_task, "lane_change"),
    "LunarLander, heuristic": lander,
}
"""By name, from few parameters to many."""


HELD_OUT: dict[str, Callable[[], Task]] = {
    "MountainCarContinuous, linear": partial(policy, "MountainCarContinuous-v0", 500, 10.0),
    "loop 42, PID": partial(loop, 42, "PID"),
    "Swimmer, linear": partial(policy, "Swimmer-v5", 300),
    "Acrobot, linear": partial(policy, "Acrobot-v1", 300),
}
"""Problems on which the rule was not chosen."""


def without_baseline(make: Callable[[], Task]) -> Task:
    """Return a problem of which no tuner knows any gains."""
    task = copy(make())
    task.baseline = None
    return task
