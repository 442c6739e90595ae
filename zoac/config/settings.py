"""What a run is told beside its task and its tuner: the one place that states these settings.

The command line's types, `zoac.tune` and the comparison of runs are made from these fields. Their
defaults stand in `conf/run.yaml` too, and a test holds the two equal.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from zoac.core.types import Count, Fraction, Natural, NonNegative

# Keys of the configuration that cannot change a run's numbers.
WITHOUT_EFFECT = (
    "executor", "logger", "runs_dir", "variant", "resume", "checkpoint_seconds", "hydra",
)  # fmt: skip


SideBySide = Annotated[int, Field(ge=1, le=100_000)]  # all in memory at once


@dataclass(frozen=True)
class Evaluation:
    """Evaluation episodes, which cost no budget.

    Args:
        episodes: During tuning.
        final_episodes: For the final figure.
        seed: Of the episodes, the same for all runs that are compared.
    """

    episodes: SideBySide = 10
    final_episodes: SideBySide = 100
    seed: Natural = 0


@dataclass(frozen=True)
class Settings:
    """What a run is told beside its task and its tuner.

    Args:
        seed: Of everything but the evaluation episodes.
        budget: Environment steps for tuning; evaluation is not counted.
        experiments: Episodes of full length for tuning; they replace `budget`.
        num_envs: Environments side by side.
        eval_every: Environment steps between evaluations.
        evaluation: Episodes of the evaluations.
        checkpoint_seconds: Wall seconds between checkpoints.
        initial_sigma: Standard deviation of the search around the baseline in normalised
            parameters, such as 0.1; the search then begins at the baseline. See
            `zoac.algorithm.strategies.around_baseline`.
        acceptance_test: Fraction of the budget, such as 0.2, for held-out episodes on which the
            answer must beat the baseline; otherwise the baseline is the answer. The verdict is
            `acceptance_test` of the result's record. See
            `zoac.algorithm.strategies.acceptance_test.AcceptanceTest`.
        select: "best_evaluated": the answer is the best of the evaluated recommendations and the
            baseline, on held-out episodes that a fifth of the budget pays for, see
            `zoac.algorithm.strategies.final_selection`; "last" or None: what the tuner recommends
            at the end.
        failure_penalty: Cost of a step that fails, which ends its episode: controller or
            environment raises, or returns what is not finite; None: that ends the run with a
            message. The result's record counts `failures` and keeps the `first_failure`.
        step_timeout: Seconds that a step or reset of an environment may take, with
            executor=process. One that takes longer is ended, its worker replaced, and the episode
            has failed, as with `failure_penalty`.
        initial_samples: Random points, an episode each, of which the best is where the tuner
            starts; see `zoac.algorithm.strategies.initial_design.InitialDesign`.
        common_random_numbers: Whole episodes that the tuner asks for together begin alike; see
            `zoac.algorithm.strategies.initial_design.CommonRandomNumbers`.
    """

    seed: Natural = 0
    budget: Natural = 500_000
    experiments: Count | None = None
    num_envs: SideBySide = 10
    eval_every: Count = 10_000
    evaluation: Evaluation = Evaluation()
    checkpoint_seconds: NonNegative = 30.0
    failure_penalty: float | None = None
    step_timeout: Annotated[float, Field(gt=0)] | None = None
    initial_sigma: Annotated[float, Field(gt=0, le=1)] | None = None
    acceptance_test: Fraction | None = None
    select: Literal["last", "best_evaluated"] | None = None
    initial_samples: Count | None = None
    common_random_numbers: bool | None = None


@dataclass(frozen=True)
class RunSettings(Settings):
    """All keys of the command line but those of its groups.

    Args:
        runs_dir: Folder that run folders lie in.
        variant: Of the run's folder; None: what the overrides change.
        resume: What happens to a run that the folder holds already.
    """

    runs_dir: str = "runs"
    variant: str | None = None
    resume: Literal["auto", "never", "overwrite"] = "auto"


RUN_KEYS = tuple(f.name for f in fields(RunSettings))

CHANGES_THE_METHOD = tuple(
    f.name
    for f in fields(Settings)
    if f.default is None and f.name not in ("experiments", "failure_penalty", "step_timeout")
)
"""Settings that are off unless given, and then are part of the method: compared runs may differ in
them. What a failure is and costs is part of the task."""


def converted(
    owner: Callable[..., Any], given: Mapping[str, Any], text: bool = False
) -> dict[str, Any]:
    """Return arguments of `owner` as its types have them: 1e4 is a whole number too.

    What cannot be converted stays as it is, for `zoac.config.validate` to refuse.

    Args:
        owner: Its type hints say what is expected.
        given: By name.
        text: They were typed on a command line: "3" may be a number, and 1 the name of a variant.
    """
    hints = get_type_hints(owner, include_extras=True)
    kinds = (int, float, str) if text else (int, float)
    rules = ConfigDict(coerce_numbers_to_str=text, arbitrary_types_allowed=True)
    return {
        name: _converted(value, hints.get(name, Any), kinds, rules) for name, value in given.items()
    }


def _converted(value: Any, hint: Any, kinds: tuple[type, ...], rules: ConfigDict) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, kinds) or is_dataclass(hint):
        return value
    try:
        return TypeAdapter(hint, config=rules).validate_python(value)
    except ValidationError:
        return value
