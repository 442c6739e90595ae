"""A search for a tuner's own options: a study of Optuna's, whose trials are runs."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from zoac.config.compose import compose_config, resolved
from zoac.config.factory import build_task
from zoac.core.errors import ConfigError, ZoacError
from zoac.core.seeding import stream_seed
from zoac.core.types import Count, Natural
from zoac.runs.lock import HeldError, locked
from zoac.runs.schema import config_hash, write_json
from zoac.search.ranges import contains, distributions, load_optuna, value_at

CONTINUES = "continues"
"""Attribute of a trial that goes on with an earlier one: that one's number."""


def origin(trial: Any) -> int:
    """Return the number of the trial that this one goes on with, its own if none."""
    return int(trial.user_attrs.get(CONTINUES, trial.number))


@dataclass(kw_only=True)
class Search:
    """One process's part in a study.

    Args:
        overrides: Of every run, as on the command line.
        ranges: What is searched, nested like the configuration; see `distributions`.
        trials: Of the whole study, whoever runs them.
        seeds: Of a trial's runs.
        evaluation_seed: Of the episodes that judge them.
        startup: Random trials before the first model.
        prune: Drop a trial whose first seeds are worse than the median trial's.
        seed: Of the sampler.
        folder: Where studies lie.
        name: Of the study; None: `<task>-<tuner>`.
        storage: Optuna's URL; None: a journal file in the study's folder.

    Raises:
        ConfigError: If the ranges, the folder or the storage cannot be used, or the study is of
            another configuration.
    """

    overrides: Sequence[str]
    ranges: Mapping[str, Any]
    trials: Count
    seeds: Annotated[list[Natural], Field(min_length=1)]
    evaluation_seed: Natural
    startup: Count
    prune: bool
    seed: Natural
    folder: str
    name: str | None
    storage: str | None

    def __post_init__(self) -> None:
        self._optuna = load_optuna()
        self._states = self._optuna.trial.TrialState
        config = compose_config(self.overrides)
        choices = config.hydra.runtime.choices
        self._task, self._tuner = choices["task"], choices["tuner"]
        plain = resolved(config)
        self._box = distributions(self.ranges)
        defaults = {key: value_at(plain, key) for key in self._box}
        self._name = self.name or f"{self._task}-{self._tuner}"
        self._folder = Path(self.folder).expanduser() / self._name
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            (self._folder / ".asking").touch()
        except OSError as error:
            raise ConfigError(
                f"search.folder={self.folder!r}: cannot make or use {self._folder}: "
                f"{error.strerror}; choose another folder"
            ) from None
        self._study = self._open()
        self._begin(plain, defaults)

    def _open(self) -> Any:
        from optuna.storages.journal import JournalFileBackend

        where: Any = self.storage
        if where is None:
            journal = JournalFileBackend(str(self._folder / "study.journal"))
            where = self._optuna.storages.JournalStorage(journal)
        pruners = self._optuna.pruners
        pruner = pruners.MedianPruner(n_startup_trials=5) if self.prune else pruners.NopPruner()
        try:
            return self._optuna.create_study(
                study_name=self._name, storage=where, load_if_exists=True, pruner=pruner
            )
        except _faults_of_a_storage() as error:
            what = str(error).partition("\n")[0]  # SQLAlchemy's advice for programmers left out
            raise ConfigError(
                f"search.storage={self.storage!r}: {what}; expected the URL of a database, such as "
                "sqlite:///study.db, or null for a file in the study's folder"
            ) from error

    def _begin(self, plain: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
        """Mark a fresh study as one of this configuration and begin it at the defaults."""
        from zoac.runs.training.identity import with_code

        identified, _ = with_code(plain, build_task(plain))
        about = {
            "config_hash": config_hash({**identified, "seed": self.seeds}),
            "ranges": {key: str(value) for key, value in self._box.items()},
            "evaluation_seed": self.evaluation_seed,
        }
        with locked(self._folder / ".asking", wait=True):
            earlier = self._study.user_attrs.get("about")
            if earlier is None:
                self._study.set_user_attr("about", about)
                if all(contains(self._box[key], value) for key, value in defaults.items()):
                    self._study.enqueue_trial(dict(defaults))
            elif earlier != about:
                raise ConfigError(
                    f"{self._folder} holds a search of another configuration, code or ranges; use "
                    "those, or another search.name"
                )

    def run(self) -> None:
        """Work on trials until the study has enough of them.

        Raises:
            ZoacError: If a trial's configuration cannot be used; the trial counts as failed.
            KeyboardInterrupt: If a signal stopped a run.
        """
        while True:
            with ExitStack() as holding:
                trial = self._take(holding)
                if trial is None:
                    return
                self._carry_out(trial)

    def _take(self, holding: ExitStack) -> Any | None:
        """Return a trial and hold its lock: one that its process left unfinished, else a new one.

        Of a trial that was left the study knows a second one, with the same options, that goes on
        in the same run folders. None if there are enough trials.
        """
        with locked(self._folder / ".asking", wait=True):
            self._give_up_left_trials()
            known = self._study.get_trials(deepcopy=False)
            begun = {origin(t) for t in known if t.state != self._states.WAITING}
            to_go_on = any(t.state == self._states.WAITING and origin(t) in begun for t in known)
            if len(begun) >= self.trials and not to_go_on:
                return None
            self._study.sampler = self._sampler(len(begun))
            trial = self._study.ask(self._box)
            holding.enter_context(self._lock(trial.number))
            return trial

    def _give_up_left_trials(self) -> None:
        """Have trials whose process has ended gone on with by the next that asks."""
        for trial in self._study.get_trials(deepcopy=False, states=[self._states.RUNNING]):
            with suppress(HeldError), self._lock(trial.number):
                self._study.tell(trial.number, state=self._states.FAIL)
                self._study.enqueue_trial(trial.params, user_attrs={CONTINUES: origin(trial)})

    def _lock(self, number: int) -> AbstractContextManager[None]:
        return locked(self._folder / f".trial-{number}")

    def _sampler(self, number: int) -> Any:
        """Return a sampler for one trial: what it draws depends on the study's history alone."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", self._optuna.exceptions.ExperimentalWarning)
            return self._optuna.samplers.TPESampler(
                seed=stream_seed(self.seed, "search", number) % 2**32,
                n_startup_trials=self.startup,
                multivariate=True,
                constant_liar=True,  # trials that other processes are at count as bad ones
            )

    def _carry_out(self, trial: Any) -> None:
        """Run a trial's seeds, those that are done already excepted, and tell the study."""
        costs: list[float] = []
        try:
            for seed in self.seeds:
                costs.append(self._cost(trial, seed))
                trial.report(float(np.mean(costs)), step=len(costs))
                if len(costs) < len(self.seeds) and trial.should_prune():
                    self._study.tell(trial.number, state=self._states.PRUNED)
                    print(f"trial {origin(trial)} dropped after {len(costs)} seed(s)", flush=True)
                    return
        except ZoacError:
            self._study.tell(trial.number, state=self._states.FAIL)
            raise
        self._study.tell(trial.number, float(np.mean(costs)))
        print(f"trial {origin(trial)}: mean cost {np.mean(costs):.4g}", flush=True)

    def _cost(self, trial: Any, seed: int) -> float:
        """Return the final cost of one run, which goes on where it was left, if it was."""
        from zoac.runs.training.lifecycle import run_session

        config = resolved(compose_config([*self.overrides, *as_overrides(trial.params)]))
        config["evaluation"]["seed"] = self.evaluation_seed
        config |= {"seed": seed, "resume": "auto", "variant": f"trial-{origin(trial)}",
                   "runs_dir": str(self._folder / "runs")}  # fmt: skip
        result = run_session(config, task=self._task, tuner=self._tuner, command=sys.argv)
        return float(result["cost_mean"])

    def conclude(self) -> None:
        """Print the best trial as overrides for `zoac.run`, and write it to `best.json`."""
        trials = self._study.get_trials(states=[self._states.COMPLETE])
        if not trials:
            print(f"no trial of {self._folder} has come to its end")
            return
        best = min(trials, key=lambda t: t.value)
        first = min(trials, key=origin)
        write_json(
            self._folder / "best.json",
            {"trial": origin(best), "cost_mean": best.value, "options": best.params,
             "trials": len(trials), "first_cost_mean": first.value},
        )  # fmt: skip
        print(
            f"best of {len(trials)} whole trials: trial {origin(best)}, mean cost {best.value:.4g} "
            f"over {len(self.seeds)} seeds (trial {origin(first)}: {first.value:.4g})\n"
            f"  {' '.join(as_overrides(best.params))}"
        )


def _faults_of_a_storage() -> tuple[type[Exception], ...]:
    """Return what Optuna raises of a storage; asked for after a fault, since the import is slow."""
    from optuna.exceptions import OptunaError
    from sqlalchemy.exc import SQLAlchemyError

    return ImportError, OSError, ValueError, SQLAlchemyError, OptunaError


def as_overrides(params: Mapping[str, Any]) -> list[str]:
    """Return a trial's options as overrides of the command line."""
    return [f"{key}={'null' if value is None else value}" for key, value in params.items()]
