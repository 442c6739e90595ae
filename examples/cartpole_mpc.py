"""An MPC carries a pole to the end of its track: from guessed weights and a wrong model."""

import argparse

import gymnasium
import numpy as np
from gymnasium.spaces import Box

import zoac

STATES, DT, TRACK = ["position", "speed", "angle", "rate"], 0.05, 1.0  # [s], [m] to each side
STEPS = 80  # of an episode


def cart_pole(x, u, p):
    """Return the state's derivative; the angle is 0 where the pole [kg, half length m] stands."""
    sin, cos, total = np.sin(x.angle), np.cos(x.angle), 1.0 + p.pole
    push = (u.force + p.pole * p.length * x.rate**2 * sin) / total
    turn = (9.81 * sin - cos * push) / (p.length * (4 / 3 - p.pole * cos**2 / total))
    return x.speed, push - p.pole * p.length * turn * cos / total, x.rate, turn


MODEL = {"derivative": cart_pole, "sample_time": DT}
GUESS = zoac.mpc.CasadiModel(STATES, ["force"], {"pole": 0.1, "length": 0.5}, **MODEL)


class CartPole(gymnasium.Env):
    """The plant: a heavier, longer pole, and a target 5 cm from one end of the track."""

    observation_space, action_space = Box(-np.inf, np.inf, (5,)), Box(-10.0, 10.0, (1,))

    def reset(self, *, seed=None, options=None):
        """Begin near the middle."""
        super().reset(seed=seed)
        start = self.np_random.uniform(-1.0, 1.0, 4) * (0.3, 0.3, 0.1, 0.2)
        self.x = np.append(start, self.np_random.choice([-1.0, 1.0]) * (TRACK - 0.05))
        self.left = STEPS
        return self.x.copy(), {}

    def step(self, action):
        """Push for DT; distance to the target, angle and effort cost, and leaving the track.

        The earlier the cart leaves, the more that costs. Otherwise to leave at once is cheapest.
        """
        self.left -= 1
        self.x[:4] = GUESS.predict(np.array([[0.3, 0.8]]), self.x[None, :4], action[None])[0]
        lost = bool(abs(self.x[0]) > TRACK or abs(self.x[2]) > 1.0)
        cost = (self.x[0] - self.x[4]) ** 2 + 0.1 * self.x[2] ** 2 + 1e-4 * action[0] ** 2
        return self.x.copy(), -float(cost) - 5.0 * self.left * lost, lost, False, {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--budget", type=int, default=8_000)
    mpc = zoac.mpc.Mpc(
        GUESS, weights=dict(zip([*STATES, "force"], [10.0, 0.1, 1.0, 0.1, 0.01], strict=True)),
        bounds={"force": (-10.0, 10.0), "position": (-TRACK, TRACK)},
        reference={"position": slice(4, 5)}, linearisations=1, initial_guess="shifted",
    )  # fmt: skip
    result = zoac.tune(
        env=CartPole, controller=mpc, space=mpc.space("weight", "model", within=10.0),
        budget=parser.parse_args().budget, max_episode_steps=STEPS, final_episodes=100,
        quiet=True,
    )  # fmt: skip
    print(result, "\nepisodes that left the track, of 100:", result.record["terminations"])
