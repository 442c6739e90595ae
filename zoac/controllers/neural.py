"""A linear and a small neural policy, for environments without a controller of their own.

controller, space = zoac.controllers.neural.linear("CartPole-v1")
result = zoac.tune(env="CartPole-v1", controller=controller, space=space)
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from zoac.core.errors import ConfigError
from zoac.envs.single_env import EnvSource, single_env

MAX_STEPS = 1000
"""Of an episode with random actions."""

Space = dict[str, tuple[float, float]]
Act = Callable[[Mapping[str, float], np.ndarray], np.ndarray]


def linear(env: EnvSource, bound: float = 1.0, random_episodes: int = 0) -> tuple[Act, Space]:
    """Return u = W x + b, squashed into the action bounds, and its space.

    Args:
        env: As `zoac.tune` takes it; observations are scaled by their bounds, if they have any.
        bound: Weights lie in [-bound, bound].
        random_episodes: See `neural`.

    Raises:
        ConfigError: If its spaces are not a Box of observations and a Box or Discrete of actions.
    """
    return neural(env, hidden=0, bound=bound, random_episodes=random_episodes)


def neural(
    env: EnvSource, hidden: int = 8, bound: float = 1.0, random_episodes: int = 0
) -> tuple[Act, Space]:
    """Return a policy with one layer of tanh units, and its space.

    A Discrete action is the output that is largest; a Box's outputs are squashed by tanh into its
    bounds, or used as they are where it has none.

    Args:
        env: As `zoac.tune` takes it.
        hidden: Units of the layer; 0: none, a linear policy.
        bound: Weights lie in [-bound, bound]; those of a layer are divided by the square root of
            the number of its inputs.
        random_episodes: Episodes of random actions, at most 1,000 steps each, whose observations
            are normalised to mean 0 and standard deviation 1; 0: none, see `env` of `linear`.

    Raises:
        ConfigError: See `linear`.
    """
    observation, action = _spaces(env)
    centre, scale = _bounds(observation)
    if random_episodes:
        centre, scale = observation_moments(env, random_episodes)
    outputs = int(action.n) if isinstance(action, Discrete) else int(np.prod(action.shape))
    sizes = [scale.size, *([hidden] if hidden else []), outputs]
    shapes = [shape for a, b in pairwise(sizes) for shape in ((b, a), (b,))]  # W, b of each layer
    names = [
        f"{'bias' if len(shape) == 1 else 'weight'}_{k // 2}_{i}"
        for k, shape in enumerate(shapes)
        for i in range(int(np.prod(shape)))
    ]
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)]).tolist()
    parts = [slice(first, end) for first, end in pairwise(ends)]

    def act(params: Mapping[str, float], obs: np.ndarray) -> np.ndarray:
        weights = np.array([params[name] for name in names])
        x = (obs - centre) / scale
        for k in range(0, len(shapes), 2):
            matrix = weights[parts[k]].reshape(shapes[k])
            x = matrix @ x / math.sqrt(len(x)) + weights[parts[k + 1]]
            if k + 2 < len(shapes):
                x = np.tanh(x)
        return _action(action, x)

    return act, dict.fromkeys(names, (-bound, bound))


def observation_moments(env: EnvSource, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation (n,) of what is observed under random actions.

    Args:
        env: As `zoac.tune` takes it.
        episodes: How many, of at most 1,000 steps; their seeds are 0, 1, 2, ...
    """
    made = single_env(env)
    made.action_space.seed(0)
    seen = []
    for episode in range(episodes):
        seen.append(np.ravel(made.reset(seed=episode)[0]))
        for _ in range(MAX_STEPS):
            obs, _, terminated, truncated, _ = made.step(made.action_space.sample())
            seen.append(np.ravel(obs))
            if terminated or truncated:
                break
    made.close()
    std = np.std(seen, axis=0)
    return np.mean(seen, axis=0), np.where(std > 1e-8, std, 1.0)


def _spaces(env: EnvSource) -> tuple[Box, Box | Discrete]:
    made = env if isinstance(env, gymnasium.Env) else single_env(env)
    observation, action = made.observation_space, made.action_space
    if made is not env:
        made.close()
    if not isinstance(observation, Box) or not isinstance(action, (Box, Discrete)):
        raise ConfigError(
            f"a policy needs a Box of observations and a Box or Discrete of actions, got "
            f"{observation} and {action}"
        )
    return observation, action


def _bounds(space: Box) -> tuple[np.ndarray, np.ndarray]:
    scale = np.where(np.isfinite(space.high), np.abs(space.high), 1.0).reshape(-1)
    return np.zeros(scale.size), np.where((scale > 0) & (scale < 1e3), scale, 1.0)


def _action(space: Box | Discrete, x: np.ndarray) -> np.ndarray:
    if isinstance(space, Discrete):
        return np.array([space.start + x.argmax()], dtype=np.float64)
    low, high = space.low.reshape(-1), space.high.reshape(-1)
    bounded = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        squashed = low + (np.tanh(x) + 1.0) * 0.5 * (high - low)
    return np.where(bounded, squashed, x)
