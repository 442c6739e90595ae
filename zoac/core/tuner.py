"""What a tuner is: it asks for rollouts, is told what happened, and recommends."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from zoac.core.errors import ConfigError
from zoac.core.parameters import ParameterSpace
from zoac.core.seeding import stream
from zoac.core.segments import Proposal, Segment


@dataclass(frozen=True)
class Problem:
    """What a tuner may know about what it tunes.

    Args:
        space: The parameters; a tuner searches the mapped box [-1, 1]^d.
        observation_size: Length o of an observation.
        num_envs: Number of environments n that roll out side by side.
        budget: Environment steps that the run will give to tuning.
        max_episode_steps: An episode's time limit.
        seed: The run's seed.
        start: Mapped reference parameters (d,), for tasks that have them.
        supports_snapshots: Whether environments can be restored to an earlier state.
        baseline: Mapped parameters (d,) of the baseline, a candidate of every final selection.
        shortest_horizon: Steps from the start of an episode that can tell good parameters from bad
            ones, such as a dead time and a rise time; 0: not known.
    """

    space: ParameterSpace
    observation_size: int
    num_envs: int
    budget: int
    max_episode_steps: int
    seed: int
    start: np.ndarray | None = None
    supports_snapshots: bool = True
    baseline: np.ndarray | None = None
    shortest_horizon: int = 0

    def rng(self, name: str) -> np.random.Generator:
        """Return the run's random stream called `name`, from its beginning."""
        return stream(self.seed, name)

    def baseline_start(self, wanted_by: str) -> np.ndarray:
        """Return a copy of `start` (d,).

        Args:
            wanted_by: The option that asks for it, for the message.

        Raises:
            ConfigError: If there is none.
        """
        if self.start is None:
            raise ConfigError(f"{wanted_by} needs baseline values, and this task has none")
        return np.array(self.start, dtype=np.float64)


class Tuner(ABC):
    """Ask, tell, recommend; and a state that can be saved and restored exactly.

    A tuner's constructor takes the `Problem` first and its options, all by keyword, after it.
    """

    whole_episodes: ClassVar[bool] = True
    """Whether every proposal is for a whole episode, over which alone specs can be judged."""

    display_name: str = ""
    """Name in tables and figures, such as "CMA-ES"; empty: the name of its configuration."""
    measures_again: ClassVar[bool] = False
    """Whether its recommendation is that of several measurements, not of the luckiest one."""

    @abstractmethod
    def ask(self) -> list[Proposal]:
        """Return the next batch of proposals; an empty list means there is nothing left to do."""

    @abstractmethod
    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """Take what came back, in the order of the proposals; return numbers to log.

        Costs are to be minimised. They may be NaN or infinite, which means: bad.
        """

    def background_update(self) -> None:  # noqa: B027 (most tuners have nothing to do)
        """Do work that only the next `tell` needs; called while rollouts run elsewhere.

        It may be called often or never, anywhere between `ask` and `tell`: `tell` and `state` must
        do themselves what is still to be done, so that the numbers are the same.
        """

    @abstractmethod
    def recommend(self) -> np.ndarray:
        """Return the mapped parameters (d,) that the tuner would use now.

        Must not change the tuner's state or draw random numbers.
        """

    @abstractmethod
    def state(self) -> Any:
        """Return a copy of everything that `ask`, `tell` and `recommend` depend on.

        Numbers, text, arrays, and dicts, lists and tuples of them; see `zoac.core.state`. A dict
        has always the same keys.
        """

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Restore what `state` returned; the tuner then continues as it would have, bit for bit."""

    def end_search(self) -> bool:
        """End the search before the budget is spent, as a callback asks; may be called repeatedly.

        Returns:
            Whether `ask` still returns proposals, which choose or test the answer.
        """
        return False

    def outcome(self) -> dict[str, Any]:
        """Return what `result.json` must say beside the parameters, by name."""
        return {}

    def describe(self) -> dict[str, Any]:
        """Return the choices that a fair comparison must show, by name, for run log and tables."""
        return {}
