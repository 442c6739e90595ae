"""One iteration of the authors' released learner on cruise control, from a description of it.

Written without `zoac.algorithm`, as an oracle for `fidelity=authors_code`. A rule can be broken by
name, which shows that a comparison would see it: `ReleasedLearner(..., broken="a rule")`.
"""

from dataclasses import dataclass, field

import numpy as np
import torch

RULES = (
    "the comfort term charges the commanded increment",
    "a termination costs 1000",
    "perturbed parameters are clipped where they are mapped",
    "an episode goes on across iterations",
    "the rest of a segment is lost with its episode",
    "a terminated episode does not bootstrap",
    "a time limit bootstraps",
    "advantages discount by gamma lambda",
    "targets run through the segments of an episode",
    "targets are bootstrapped at the cut",
    "advantages come from the critic before its update",
    "advantages are standardised",
    "directions are unclipped in the gradient",
    "left-over states join the last minibatch",
    "the critic takes ten epochs",
    "the critic reads raw states",
    "the step size is constant",
    "Adam keeps its moments",
    "theta is clipped after its update",
)
GAMMA, LAM, MINIBATCH, EPOCHS, CRITIC_STEP = 0.99, 0.95, 128, 10, 5e-4
WORKERS, SEGMENTS, STEPS, SIGMA, STEP_SIZE = 10, 4, 10, 0.08, 3e-2


class Car:
    """A car that follows another with a PID in increments: the release's environment."""

    def __init__(self, rules, limit, preceding):
        self.rules, self.limit, self.preceding, self.episode = rules, limit, preceding, -1
        self.reset()

    def reset(self):
        self.history, self.u, self.steps = [np.zeros(3)] * 3, 0.0, 0
        self.episode += 1

    def observation(self):
        return np.concatenate([*self.history, [self.u]])

    def step(self, gains):
        """Return cost, whether the episode is dead, and whether its time is over."""
        k, kp, ki, kd = gains
        e0, e1, e2 = (k * x[0] + x[1] for x in self.history)
        asked = np.clip(kp * (e0 - e1) + ki * e0 + kd * (e0 - 2 * e1 + e2), -1.5, 0.6)
        u = np.clip(self.u + asked, -1.5, 0.6)
        charged = asked if self.rules("the comfort term charges the commanded") else u - self.u
        dd, dv, af = self.history[0]
        w = self.preceding[min(self.episode, len(self.preceding) - 1)][self.steps]
        rates = np.array([dv - 2.5 * af, w - af, (u - af) / 0.45])
        x = np.array([dd, dv, af]) + 0.1 * rates
        self.history, self.u, self.steps = [x, *self.history[:2]], u, self.steps + 1
        dd, dv, af = x
        cost = 0.1 * dv**2 + 0.06 * dd**2 + u**2 + 0.1 * charged**2
        cost += 0.5 * (0.25 * dv + 0.02 * dd - af) ** 2
        dead = abs(dd) > 5 or abs(dv) > 1
        if dead and self.rules("a termination costs"):
            cost += 1000
        return cost, dead, self.steps == self.limit


@dataclass
class Piece:
    """A segment: what one direction brought."""

    direction: np.ndarray
    states: list = field(default_factory=list)
    costs: list = field(default_factory=list)
    dead: bool = False
    over: bool = False

    def deltas(self, values, rules):
        following = list(values[1:])
        if self.dead and rules("a terminated episode does not"):
            following[-1] = 0.0
        if self.over and not self.dead and not rules("a time limit"):
            following[-1] = 0.0
        return [
            c + GAMMA * f - v for c, f, v in zip(self.costs, following, values[:-1], strict=True)
        ]


class ReleasedLearner:
    """Workers, critic and actor; `iterate` is one pass through all of them."""

    def __init__(self, theta, critic, limit, preceding, broken=None):
        """
        Args:
            theta: Mapped parameters (4,) to begin with.
            critic: A module; it is fitted in place.
            limit: Steps of an episode.
            preceding: Per worker a list, which may grow: the acceleration of the preceding car at
                each step of each episode.
            broken: One of `RULES`.
        """
        assert broken is None or broken in RULES
        self.theta, self.critic, self.broken = np.array(theta), critic, broken
        self.first_moment, self.second_moment, self.updates = np.zeros(4), np.zeros(4), 0
        self.cars = [Car(self.rules, limit, episodes) for episodes in preceding]
        self.critic_adam = torch.optim.Adam(critic.parameters(), lr=CRITIC_STEP)

    def rules(self, beginning):
        (rule,) = (rule for rule in RULES if rule.startswith(beginning))
        return rule != self.broken

    def iterate(self, noise, orders):
        """Run, learn, move.

        Args:
            noise: Directions (H, workers, 4).
            orders: Per epoch, the order of all states.

        Returns:
            Segments in order of H and worker, their advantages, and their states' targets.
        """
        if not self.rules("an episode goes on across"):
            for car in self.cars:
                car.reset()
        pieces = [
            [self.run(car, direction) for car, direction in zip(self.cars, row, strict=True)]
            for row in noise
        ]
        everything = [piece for row in pieces for piece in row]
        if not self.rules("advantages come from"):
            self.fit(everything, self.targets(pieces), orders)
        targets = self.targets(pieces)
        decay = GAMMA * LAM if self.rules("advantages discount") else LAM
        advantages = np.array(
            [
                sum(decay**k * d for k, d in enumerate(p.deltas(self.values(p), self.rules)))
                for p in everything
            ]
        )
        self.fit(everything, targets, orders)
        self.move(advantages, np.array([piece.direction for piece in everything]))
        return everything, advantages, targets

    def run(self, car, direction):
        piece = Piece(direction)
        perturbed = self.theta + SIGMA * direction
        if self.rules("perturbed parameters are clipped"):
            perturbed = np.clip(perturbed, -1, 1)
        piece.states.append(car.observation())
        while len(piece.costs) < STEPS:
            cost, piece.dead, piece.over = car.step(5 * (perturbed + 1))
            piece.costs.append(cost)
            piece.states.append(car.observation())
            if piece.dead or piece.over:
                car.reset()
                if self.rules("the rest of a segment"):
                    break
        return piece

    def values(self, piece):
        states = torch.tensor(np.array(piece.states)).float()
        return self.critic(self.shown(states))[:, 0].detach().double().numpy()

    def shown(self, states):
        if self.rules("the critic reads raw"):
            return states
        return (states - states.mean(0)) / (states.std(0) + 1e-8)

    def targets(self, pieces):
        """Return the targets of all states, (number,), in the order of segments."""
        found = {}
        for i in range(WORKERS):
            following = None  # the advantage of the next state, within this piece of episode
            for j in range(SEGMENTS - 1, -1, -1):
                piece = pieces[j][i]
                values = self.values(piece)
                deltas = piece.deltas(values, self.rules)
                if following is None and not self.rules("targets are bootstrapped"):
                    deltas[-1] -= 0.0 if piece.dead else GAMMA * values[-1]
                if piece.dead or piece.over or not self.rules("targets run through"):
                    following = None
                advantage, own = following or 0.0, []
                for k in range(len(deltas) - 1, -1, -1):
                    advantage = deltas[k] + GAMMA * LAM * advantage
                    own.insert(0, values[k] + advantage)
                following, found[j, i] = advantage, own
        order = [(j, i) for j in range(SEGMENTS) for i in range(WORKERS)]
        return np.concatenate([found[key] for key in order])

    def fit(self, everything, targets, orders):
        states = torch.tensor(np.concatenate([piece.states[:-1] for piece in everything])).float()
        wanted = torch.tensor(targets).float()
        epochs = EPOCHS if self.rules("the critic takes") else 1
        for order in orders[:epochs]:
            starts = list(range(0, len(order), MINIBATCH))
            if self.rules("left-over") and len(order) % MINIBATCH and len(starts) > 1:
                starts.pop()
            for start, end in zip(starts, [*starts[1:], len(order)], strict=True):
                chosen = torch.tensor(order[start:end])
                error = self.critic(self.shown(states[chosen]))[:, 0] - wanted[chosen]
                self.critic_adam.zero_grad()
                error.square().mean().backward()
                self.critic_adam.step()

    def move(self, advantages, directions):
        if self.rules("advantages are standardised"):
            advantages = (advantages - advantages.mean()) / advantages.std()
        if not self.rules("directions are unclipped"):
            directions = (np.clip(self.theta + SIGMA * directions, -1, 1) - self.theta) / SIGMA
        gradient = (advantages[:, None] * directions).mean(axis=0)
        if not self.rules("Adam keeps"):
            self.first_moment, self.second_moment = np.zeros(4), np.zeros(4)
        self.first_moment = 0.9 * self.first_moment + 0.1 * gradient
        self.second_moment = 0.999 * self.second_moment + 0.001 * gradient**2
        slope = 0.0 if self.rules("the step size is") else 2e-4
        step = STEP_SIZE - slope * self.updates
        self.updates += 1
        step *= np.sqrt(1 - 0.999**self.updates) / (1 - 0.9**self.updates)
        # Epsilon stands outside the bias correction.
        self.theta = self.theta - step * self.first_moment / (np.sqrt(self.second_moment) + 1e-8)
        if self.rules("theta is clipped"):
            self.theta = np.clip(self.theta, -1, 1)
