"""A study: it proposes experiments and is told what came of them."""

from __future__ import annotations

import inspect
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.config.settings import converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, TrialsPending
from zoac.core.parameters import ParameterSpace
from zoac.core.types import Count, Natural, Positive, is_number
from zoac.runs.export import export
from zoac.runs.schema import is_done
from zoac.specs.spec import Spec
from zoac.study.loop import experiments_left
from zoac.study.proposals import Proposals
from zoac.study.state import folder as files
from zoac.study.state.ledger import Ledger
from zoac.study.state.settings import new_settings
from zoac.study.state.trial import Trial, measured, number_of, reason_of

if TYPE_CHECKING:
    import pandas as pd

READ_LATER = ("self", "space", "baseline", "constraints", "specs")
"""Arguments of `Study` that their type hints do not check."""

NO_SETTINGS = ("self", "space", "folder", "trial_timeout", "name", "variant")
"""Arguments of `Study` that may differ where a study goes on."""


class Study:
    """Experiments that something else runs: a rig, a licensed simulator, a person.

        study = zoac.Study(space={"kp": (0, 20), "ki": (0, 5)}, folder="rig", experiments=60)
        for trial in study:
            study.tell(trial, cost(trial.parameters))
        print(study.best.parameters)

    The folder is the study: several processes may open it at once, and each may be killed at any
    instant. A result that was told is on the disk when `tell` returns, and counts once. The
    parameters of an experiment depend on the settings and the results of earlier ones, and on
    nothing else: neither on who asks, nor on the order of results, nor on restarts.
    """

    def __init__(
        self,
        space: ParameterSpace | Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
        *,
        tuner: str = "auto",
        experiments: Count = 60,
        seed: Natural = 0,
        workers: Count = 1,
        baseline: Mapping[str, Any] | None = None,
        baseline_first: bool = True,
        constraints: Mapping[str, float] | None = None,
        specs: Sequence[Spec] = (),
        acceptance_test: float | None = None,
        initial_sigma: float | None = None,
        initial_samples: int | None = None,
        tuner_options: Mapping[str, Any] | None = None,
        trial_timeout: Positive | None = None,
        name: str | None = None,
        variant: str | None = None,
    ) -> None:
        """
        Args:
            space: Bounds by name, as `zoac.tune` takes them; None: open the study in `folder`,
                whose other settings are then its own.
            folder: Its folder, in which a study of the same settings continues; None: temporary.
            tuner: "bo", "botorch", "cmaes", "cmaes_full", "es", "halving", "nevergrad", "optuna",
                "random", "smac"; "auto": "bo" for one worker and few experiments, else CMA-ES.
            experiments: Number of experiments, failed and abandoned ones included.
            seed: Seed of all random numbers.
            workers: Number of experiments that the tuner plans at a time. More may be under way
                if its batches are larger.
            baseline: Values in use today, beside those that `space` names.
            baseline_first: Make the baseline values the first experiment.
            constraints: Limits by name: a measured value above its limit is a violation, and less
                violation goes before less cost.
            specs: Requirements of `zoac.specs` on the traces that `tell` receives.
            acceptance_test: Fraction of the experiments, such as 0.2, that measure baseline and
                recommendation in turn. The answer is the baseline unless the recommendation
                proves better.
            initial_sigma: As in `zoac.tune`.
            initial_samples: As in `zoac.tune`.
            tuner_options: Options of the tuner, by name.
            trial_timeout: Seconds after which a trial without a result is abandoned, at the next
                `ask`; None: never.
            name: Name of a new study in tables and reports; None: its folder's name.
            variant: Distinguishes it, in tables, from studies of the same name, tuner and seed.

        Raises:
            ConfigError: If something given cannot be used.
            RunFolderError: If the folder holds another study, or cannot be used.
        """
        given = converted(Study.__init__, locals())
        check_arguments(Study, {k: v for k, v in given.items() if k not in READ_LATER}, "")
        if space is None and folder is None:
            raise ConfigError("a study needs a space, or the folder of one that was begun")
        self.folder = path = Path(folder or tempfile.mkdtemp(prefix="zoac-study-")).expanduser()
        of_study = {key: value for key, value in given.items() if key not in NO_SETTINGS}
        usual = inspect.signature(Study).parameters
        extra = [key for key, value in of_study.items() if value is not usual[key].default]
        if space is None and extra:
            raise ConfigError(
                f"{', '.join(extra)}: a study that is opened by its folder alone keeps its own "
                "settings; give the space too, or leave this out"
            )
        settings = None if space is None else new_settings(space, **of_study)
        called = {"task": name or path.resolve().name, "variant": variant}
        limit = given["trial_timeout"]
        self.settings, self.trial_timeout = files.opened(path, settings, limit, called)
        self._ledger = Ledger(path, self.settings.limits)
        if self.finished and not is_done(path):  # killed before the result was written
            with self._ledger.writing():
                self._finish()

    def ask(self, *, by: str = "", wait: float = 0.0) -> Trial:
        """Return the next experiment.

        Args:
            by: Who asks; kept with the trial, for people.
            wait: Seconds to wait for results of other trials if this one depends on them.

        Raises:
            ConfigError: If an argument cannot be used.
            StudyFinished: If all experiments have been asked for.
            TrialsPending: If the next experiment depends on trials without a result.
            NothingWorksError: If each of the first ten experiments failed.
        """
        check_arguments(self.ask, {"by": by}, "")
        if not (is_number(wait) and wait >= 0):
            raise ConfigError(f"wait={wait!r}: expected seconds, 0 or more")
        until = time.monotonic() + wait
        while True:
            try:
                return self._ask(by)
            except TrialsPending:
                if (left := until - time.monotonic()) <= 0:
                    raise
            time.sleep(min(0.05, left))

    def _ask(self, by: str) -> Trial:
        with self._ledger.writing():
            self._ledger.abandon_overdue(self.trial_timeout or np.inf)
            self._finish()
            number = self._ledger.next_number(self.settings.experiments)
            x = self.settings.space.clip(self._tuner.x(number, self._ledger.trial))
            parameters = {**self.settings.space.named(x), **self.settings.fixed}
            self._ledger.write("asked", number, {"by": by, "parameters": parameters, "x": x})
            return self._ledger.trial(number)

    def tell(
        self,
        trial: Trial | int,
        cost: Any = None,
        *,
        failed: str | Exception | None = None,
        trace: pd.DataFrame | None = None,
        metrics: Mapping[str, float] | None = None,
        constraints: Mapping[str, float] | None = None,
    ) -> Trial:
        """Take the result of an experiment; return the trial with it.

        Telling the same result again changes nothing.

        Args:
            trial: The trial or its number.
            cost: To be minimised; or a mapping with `cost`, and if wanted `metrics` and
                `constraints`.
            trace: Instead: the signals of the experiment by column, and `time` [s]. The study's
                specs judge it; those without a limit are the cost, unless all have one.
            failed: Instead: why the experiment failed. It then ranks behind all that did not.
            metrics: Further numbers by name, which are recorded.
            constraints: Measured values by name.

        Raises:
            ConfigError: If the result cannot be used; nothing is recorded.
            StudyError: If there is no such trial, or it has another result.
        """
        if (cost is None and trace is None) == (failed is None):
            raise ConfigError("tell needs a cost, a trace or the reason of a failure, one of them")
        if failed is not None:
            return self._end(trial, "failed", reason_of(failed))
        limits, specs = self.settings.limits, self.settings.specs
        result = measured(cost, limits, metrics, constraints, trace=trace, specs=specs)
        return self._end(trial, "told", result)

    def abandon(self, trial: Trial | int, reason: str = "given up") -> Trial:
        """Give up an experiment that will never have a result; it counts as failed.

        Raises:
            ConfigError: If the reason is no text.
            StudyError: If there is no such trial, or it has a result.
        """
        return self._end(trial, "abandoned", reason_of(reason))

    def _end(self, trial: Trial | int, kind: str, result: Mapping[str, Any]) -> Trial:
        number = number_of(trial)
        with self._ledger.writing():
            if not self._ledger.has(number, {"kind": kind, **result}):
                self._ledger.write(kind, number, result)
            self._finish()
            return self._ledger.trial(number)

    def __iter__(self) -> Iterator[Trial]:
        """Yield the experiments that are left, and wait for results of others where needed.

        With `workers=1`, the trials that an earlier loop left without a result come first, unless
        another process has a loop over the study. A wait of more than ten seconds is told on
        standard error, with the trials that it is for.

        Raises:
            StudyError: If the next is wanted before the last has a result.
        """
        return experiments_left(self.folder, self.settings.workers, lambda: self.pending, self.ask)

    def trial(self, number: int) -> Trial:
        """Return a trial as it is now; a `StudyError` if there is none of this number."""
        return self._ledger.refreshed().trial(number_of(number))

    @property
    def trials(self) -> list[Trial]:
        """All trials so far, by number."""
        return self._ledger.refreshed().trials

    @property
    def pending(self) -> list[Trial]:
        """Trials without a result."""
        return [trial for trial in self.trials if trial.pending]

    @property
    def finished(self) -> bool:
        """Whether every experiment has a result."""
        return sum(not trial.pending for trial in self.trials) == self.settings.experiments

    @property
    def best(self) -> Trial:
        """The experiment of the answer: the one of the least violation, and of the least cost.

        After an acceptance test or repetitions, of those with the values that were chosen.

        Raises:
            StudyError: If no experiment has succeeded yet.
        """
        return self._conclusion[0]

    @property
    def outcome(self) -> dict[str, Any]:
        """The verdict of a finished acceptance test; empty without one."""
        return self._conclusion[1]

    @property
    def _conclusion(self) -> tuple[Trial, dict[str, Any]]:
        with self._ledger.mutex:
            trials = self.trials
            repeats = len({trial.x for trial in trials}) < len(trials)
            again = repeats and self._tuner.tuner.measures_again
            if not (self.finished and (again or self.settings.acceptance_test is not None)):
                return self._ledger.best(), {}
            x, outcome = self._tuner.conclusion(self._ledger.trial)
            return self._ledger.best(x), outcome

    @cached_property
    def _tuner(self) -> Proposals:
        return Proposals(self.settings)

    @property
    def history(self) -> pd.DataFrame:
        """A row for each trial: number, state, cost, its parameters, metrics and constraints."""
        return self._ledger.refreshed().frame()

    def export(self, path: str | Path) -> Path:
        """Write the best parameters as `.yaml`, `.json`, `.h` (C) or `.m` (MATLAB).

        Raises:
            ConfigError: If it cannot be written so.
            StudyError: If no experiment has succeeded yet.
        """
        units = {p.name: p.unit for p in self.settings.space.parameters}
        return export(self.best.parameters, path, units)

    def _finish(self) -> None:
        """Write the result of a study that is finished; the lock must be held."""
        trials = self.trials
        succeeded = any(trial.state == "told" for trial in trials)
        if self.finished and succeeded and not is_done(self.folder):
            best, outcome = self._conclusion
            found = {**files.result(self.settings, trials, best), **outcome}
            files.write_result(self.folder, found, trials, best)
