"""An MPC of Klatt and Engell's reactor, do-mpc's example: tuned on a plant whose kinetics vary."""

import argparse

import gymnasium
import numpy as np
from gymnasium.spaces import Box

import zoac

GOAL, LIMIT = 0.6, 140.0  # [mol/l, C]


def reactor(x, u, p):
    """Return the derivative [1/h] for a feed [1/h] and heat [kJ/h]: A -> B -> C, 2 A -> D."""
    kelvin = x.reactor + 273.15
    k1, k3 = p.beta * 1.287e12 * np.exp(-9758.3 / kelvin), 9.043e9 * np.exp(-8560.0 / kelvin)
    heat = k1 * x.a * 4.2 - k1 * x.b * 11.0 - k3 * x.a**2 * 41.85
    cooled = 4032.0 * 0.215 * (x.reactor - x.jacket)
    a, b = u.feed * (5.1 - x.a) - k1 * x.a - k3 * x.a**2, k1 * (x.a - x.b) - u.feed * x.b
    warming = u.feed * (130.0 - x.reactor) - (heat + cooled / 10.01) / (0.9342 * 3.01)
    return a, b, warming, (u.heat + cooled) / (5.0 * 2.0)


MODEL = zoac.mpc.CasadiModel("a b reactor jacket", "feed heat", {"beta": 1.0}, derivative=reactor,
                             sample_time=0.005, substeps=2)  # fmt: skip


class Reactor(gymnasium.Env):
    """The plant: beta and the start differ from episode to episode."""

    observation_space, action_space = Box(-np.inf, np.inf, (4,)), Box(-8500.0, 100.0, (2,))

    def reset(self, *, seed=None, options=None):
        """Begin cold."""
        super().reset(seed=seed)
        self.x = self.np_random.uniform([0.7, 0.4, 132.0, 128.0], [0.9, 0.6, 136.0, 132.0])
        self.beta = self.np_random.uniform(0.9, 1.1, (1, 1))
        return self.x.copy(), {}

    def step(self, action):
        """Run for 18 s; the product's distance from its goal costs."""
        self.x = MODEL.predict(self.beta, self.x[None], action[None])[0]
        return self.x.copy(), -1e4 * float((self.x[1] - GOAL) ** 2), False, False, {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--budget", type=int, default=6_000)
    mpc = zoac.mpc.Mpc(
        MODEL, weights={"b": 1.0}, rate_weights={"feed": 1e-3, "heat": 1e-7}, reference={"b": GOAL},
        bounds={"feed": (5.0, 100.0), "heat": (-8500.0, 0.0), "reactor": (None, LIMIT)},
        linearisations=1, initial_guess="shifted",
    )  # fmt: skip
    print(zoac.tune(
        env=Reactor, controller=mpc, budget=parser.parse_args().budget, max_episode_steps=60,
        space=mpc.space("rate_weight", within=1e3, beta=(0.8, 1.2), high_reactor=(130.0, LIMIT)),
        constraints={"hot": lambda s: s.observations[1:, 2] - LIMIT}, quiet=True,
    ))  # fmt: skip
