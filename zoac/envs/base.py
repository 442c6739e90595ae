"""Vectorised environments: the base classes of the built-in ones and of the Gymnasium adapter.

Each of the environments side by side owns its state (rows of arrays) and its random stream, so it
can be saved, restored and moved to another process without touching the others.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from zoac.core.errors import ConfigError, needs_matplotlib, suggest

Snapshot = dict[str, Any]

Watch = Callable[[int, str], AbstractContextManager[None]]
"""Takes an environment's index and the method that is called while the context lasts."""


class VecEnv(VectorEnv, ABC):
    """A `gymnasium.vector.VectorEnv` whose environments can be masked, saved and restored.

    Autoreset is disabled: a finished environment is reset by the caller through
    `reset(options={"reset_mask": ...})`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED, "render_modes": []}

    limited = True
    """Episodes are truncated at `max_episode_steps`. False: one that gets there is an error."""
    remarks: tuple[str, ...] = ()
    """What a user should know before a run, a sentence each."""
    saved_by = ""
    """What saves the state, for messages; empty: deepcopy, and pickle in a checkpoint."""

    def __init__(
        self,
        num_envs: int,
        observation_space: gymnasium.spaces.Box,
        action_space: gymnasium.spaces.Box,
        max_episode_steps: int,
        render_mode: str | None = None,
    ) -> None:
        self.num_envs = num_envs
        self.single_observation_space = observation_space
        self.single_action_space = action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        self.max_episode_steps = max_episode_steps
        known = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in known:
            raise ConfigError(
                f"render_mode: unknown {render_mode!r}; {suggest(render_mode, known)}"
            )
        self.render_mode = render_mode
        self._steps = np.zeros(num_envs, dtype=np.int64)

    @abstractmethod
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: One seed per environment; or one number, to which the environment's index is
                added; an environment whose seed is None goes on with its random stream.
            options: `reset_mask` (n,) bool: which environments to reset, all by default;
                `demonstration` bool: begin the task's fixed demonstration episode.

        Returns:
            Observations (n, o), and infos.
        """

    def _to_reset(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> list[tuple[int, int | None]]:
        """Return index and seed of each environment that `reset` is to reset."""
        if isinstance(seed, (int, np.integer)):
            seed = [int(seed) + env_index for env_index in range(self.num_envs)]
        mask = (options or {}).get("reset_mask")
        indices = range(self.num_envs) if mask is None else np.flatnonzero(mask).tolist()
        return [(k, None if seed is None else seed[k]) for k in indices]

    @abstractmethod
    def step(
        self, actions: np.ndarray, mask: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance the environments, or only those where `mask` (n,) holds; the others stand still.

        Returns:
            Observations (n, o), rewards (n,) = -cost, terminated (n,), truncated (n,), and
            infos with `cost` (n,). An environment that stood still reports cost 0 and no end. Infos
            of `step` and `reset` may hold `failures`, env_index ->
            `zoac.core.errors.EnvironmentFailure`; those of `step` `actions` (n, m) as applied,
            where they differ from those given.
        """

    @abstractmethod
    def state(self, env_indices: Sequence[int] | np.ndarray) -> Snapshot:
        """Return a copy of the state at `env_indices`, random streams included."""

    @abstractmethod
    def restore(self, env_indices: Sequence[int] | np.ndarray, state: Snapshot) -> np.ndarray:
        """Restore `state` at `env_indices`; return the observations (n, o) of all."""

    def watch(self, watch: Watch) -> None:
        """Call every `reset` and `step` of an environment within `watch(env_index, name)`.

        Raises:
            ConfigError: If environments are not called one by one.
        """
        raise ConfigError(
            f"step_timeout: the environments of {type(self).__name__} are stepped all at once, so "
            "that no step of one can be ended; leave it out"
        )


class ArrayVecEnv(VecEnv):
    """Environments as rows of arrays: the base class of the built-in environments.

    A subclass keeps everything that lasts in `self.arrays` (name -> array with one row per
    environment), fills an environment's rows in `_start` and advances all rows in `_advance`. It
    must draw random numbers in `_start` only, and compute each environment from that environment's
    rows alone, so that it gives the same bits in any batch. One with render modes also defines
    `_frame(env_index)`, which returns a picture (height, width, 3) uint8.
    """

    _frame: Callable[[int], np.ndarray]

    def __init__(
        self,
        num_envs: int,
        observation_space: gymnasium.spaces.Box,
        action_space: gymnasium.spaces.Box,
        max_episode_steps: int,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(num_envs, observation_space, action_space, max_episode_steps, render_mode)
        self._bounds = action_space.low, action_space.high
        self.arrays: dict[str, np.ndarray] = {}
        self._generators: list[np.random.Generator | None] = [None] * num_envs

    @abstractmethod
    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        """Begin an episode at `env_index`; draw all of its randomness from `rng`."""

    @abstractmethod
    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Advance every environment by `actions` (n, m); return cost (n,) and terminated (n,)."""

    def _applied(self, actions: np.ndarray) -> np.ndarray:
        """Return what `_advance` will apply of `actions` (n, m); here: clipped to the bounds."""
        return np.clip(actions, *self._bounds)

    @abstractmethod
    def _observe(self) -> np.ndarray:
        """Return a new array (n, o) of observations."""

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of every environment, if made with `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        with needs_matplotlib():
            return tuple(self._frame(env_index) for env_index in range(self.num_envs))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        demonstration = bool((options or {}).get("demonstration", False))
        for env_index, env_seed in self._to_reset(seed, options):
            rng = self._generators[env_index]
            if env_seed is not None or rng is None:
                rng = np.random.Generator(np.random.PCG64(env_seed))
                self._generators[env_index] = rng
            self._steps[env_index] = 0
            self._start(env_index, rng, demonstration)
        return self._observe(), {}

    def step(
        self, actions: np.ndarray, mask: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        applied = self._applied(actions)
        if mask is None:
            cost, terminated = self._advance(actions)
            self._steps += 1
        else:
            still = ~mask
            before = {name: array[still] for name, array in self.arrays.items()}
            cost, terminated = self._advance(np.where(mask[:, None], actions, 0.0))
            for name, array in self.arrays.items():
                array[still] = before[name]
            cost[still] = 0.0
            terminated[still] = False
            self._steps += mask
        truncated = (self._steps >= self.max_episode_steps) & ~terminated
        if mask is not None:
            truncated &= mask
        infos = {"cost": cost, "actions": applied}
        return self._observe(), -cost, terminated, truncated, infos

    def state(self, env_indices: Sequence[int] | np.ndarray) -> Snapshot:
        env_indices = np.asarray(env_indices)
        return {
            "arrays": {name: array[env_indices].copy() for name, array in self.arrays.items()},
            "steps": self._steps[env_indices].copy(),
            "generators": [
                None if rng is None else rng.bit_generator.state
                for rng in (self._generators[env_index] for env_index in env_indices)
            ],
        }

    def restore(self, env_indices: Sequence[int] | np.ndarray, state: Snapshot) -> np.ndarray:
        env_indices = np.asarray(env_indices)
        for name, rows in state["arrays"].items():
            self.arrays[name][env_indices] = rows
        self._steps[env_indices] = state["steps"]
        for env_index, rng_state in zip(env_indices, state["generators"], strict=True):
            if rng_state is None:
                self._generators[env_index] = None
                continue
            generator = np.random.Generator(np.random.PCG64())
            generator.bit_generator.state = rng_state
            self._generators[env_index] = generator
        return self._observe()


class SingleEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One environment of a `VecEnv` as a plain `gymnasium.Env`, with the same numbers."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, vec_env: VecEnv) -> None:
        """
        Args:
            vec_env: A vectorised environment with `num_envs=1`, which this object then owns.
        """
        self.vec_env = vec_env
        self.observation_space = vec_env.single_observation_space
        self.action_space = vec_env.single_action_space
        self.render_mode = vec_env.render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; see `VecEnv.reset`."""
        super().reset(seed=seed)
        observations, _ = self.vec_env.reset(seed=None if seed is None else [seed], options=options)
        return observations[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one step; `info["cost"]` carries the cost, the reward is its negative."""
        observations, rewards, terminated, truncated, infos = self.vec_env.step(
            np.asarray(action, dtype=np.float64)[None]
        )
        info = {"cost": float(infos["cost"][0])}
        ended = bool(terminated[0]), bool(truncated[0])
        return observations[0], float(rewards[0]), *ended, info

    def render(self) -> Any:
        """Return the environment's picture (height, width, 3) uint8, if made with `rgb_array`."""
        frames = self.vec_env.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Release what the environment holds."""
        self.vec_env.close()
