"""Search for a tuner's own options, such as ZOAC's sigma, N, H and step size, on Optuna.

python -m zoac.search task=pid_acc tuner=zoac budget=100000 search.trials=40

A trial is a few runs, one a seed; its value is their mean final cost. Give the same command in
several processes, on one machine or many that share the folder: they work on one study. A process
that is killed loses nothing: whoever comes next takes up its trial where its checkpoint stood.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from omegaconf import OmegaConf
from pydantic import Field

from zoac.cli.pipes import reader_may_leave
from zoac.cli.search_ranges import distributions, load_optuna, value_at
from zoac.config.compose import compose_config, resolved
from zoac.config.factory import build_task
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, ZoacError, suggest
from zoac.core.seeding import stream_seed
from zoac.core.types import Count, Natural
from zoac.runs.lock import HeldError, locked
from zoac.runs.schema import config_hash, write_json


class Search:
    """One process's part in a study."""

    def __init__(
        self,
        overrides: Sequence[str],
        *,
        ranges: Mapping[str, Any],
        trials: Count,
        seeds: Annotated[list[Natural], Field(min_length=1)],
        evaluation_seed: Natural,
        startup: Count,
        prune: bool,
        seed: Natural,
        folder: str,
        name: str | None,
        storage: str | None,
    ) -> None:
        """
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
            ConfigError: If the ranges, the folder or the storage cannot be used, or the study is
                of another configuration.
        """
        self._overrides = list(overrides)
        self._trials, self._seeds = trials, seeds
        self._evaluation_seed, self._startup, self._seed = evaluation_seed, startup, seed
        config = compose_config(overrides)
        choices = config.hydra.runtime.choices
        self._task, self._tuner = choices["task"], choices["tuner"]
        plain = resolved(config)
        self._box = distributions(ranges)
        defaults = {key: value_at(plain, key) for key in self._box}
        self._name = name or f"{self._task}-{self._tuner}"
        self._folder = Path(folder).expanduser() / self._name
        self._make(folder)
        self._study = self._open(storage, prune)
        self._begin(plain, defaults)

    def _make(self, folder: str) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            (self._folder / ".asking").touch()
        except OSError as error:
            raise ConfigError(
                f"search.folder={folder!r}: cannot make or use {self._folder}: {error.strerror}; "
                "choose another folder"
            ) from None

    def _open(self, storage: str | None, prune: bool) -> Any:
        optuna = load_optuna()
        from optuna.storages.journal import JournalFileBackend
        from sqlalchemy.exc import SQLAlchemyError

        where: Any = storage
        if storage is None:
            where = optuna.storages.JournalStorage(
                JournalFileBackend(str(self._folder / "study.journal"))
            )
        try:
            return optuna.create_study(
                study_name=self._name,
                storage=where,
                load_if_exists=True,
                pruner=optuna.pruners.MedianPruner(n_startup_trials=5)
                if prune
                else optuna.pruners.NopPruner(),
            )
        except (
            ImportError, OSError, ValueError, SQLAlchemyError, optuna.exceptions.OptunaError
        ) as error:  # fmt: skip
            what = str(error).partition("\n")[0]  # SQLAlchemy's advice for programmers left out
            raise ConfigError(
                f"search.storage={storage!r}: {what}; expected the URL of a database, such as "
                "sqlite:///study.db, or null for a file in the study's folder"
            ) from error

    def _begin(self, plain: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
        """Mark a fresh study as one of this configuration and begin it at the defaults."""
        from zoac.training.identity import with_code

        identified, _ = with_code(plain, build_task(plain))
        about = {
            "config_hash": config_hash({**identified, "seed": self._seeds}),
            "ranges": {key: str(value) for key, value in self._box.items()},
            "evaluation_seed": self._evaluation_seed,
        }
        with locked(self._folder / ".asking", wait=True):
            earlier = self._study.user_attrs.get("about")
            if earlier is None:
                self._study.set_user_attr("about", about)
                if all(self._box[key]._contains(value) for key, value in defaults.items()):
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

        None if there are enough.
        """
        optuna = load_optuna()
        with locked(self._folder / ".asking", wait=True):
            known = self._study.get_trials(deepcopy=False)
            for frozen in known:
                if frozen.state == optuna.trial.TrialState.RUNNING:
                    with suppress(HeldError):
                        holding.enter_context(self._lock(frozen.number))
                        return optuna.trial.Trial(self._study, frozen._trial_id)
            waiting = sum(t.state == optuna.trial.TrialState.WAITING for t in known)
            if len(known) - waiting >= self._trials:
                return None
            self._study.sampler = self._sampler(len(known))
            trial = self._study.ask(self._box)
            holding.enter_context(self._lock(trial.number))
            return trial

    def _lock(self, number: int) -> AbstractContextManager[None]:
        return locked(self._folder / f".trial-{number}")

    def _sampler(self, number: int) -> Any:
        """Return a sampler for one trial: what it draws depends on the study's history alone."""
        optuna = load_optuna()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return optuna.samplers.TPESampler(
                seed=stream_seed(self._seed, "search", number) % 2**32,
                n_startup_trials=self._startup,
                multivariate=True,
                constant_liar=True,  # trials that other processes are at count as bad ones
            )

    def _carry_out(self, trial: Any) -> None:
        """Run a trial's seeds, those that are done already excepted, and tell the study."""
        optuna = load_optuna()
        costs: list[float] = []
        try:
            for seed in self._seeds:
                costs.append(self._cost(trial, seed))
                trial.report(float(np.mean(costs)), step=len(costs))
                if len(costs) < len(self._seeds) and trial.should_prune():
                    self._study.tell(trial.number, state=optuna.trial.TrialState.PRUNED)
                    print(f"trial {trial.number} dropped after {len(costs)} seed(s)", flush=True)
                    return
        except ZoacError:
            self._study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
            raise
        self._study.tell(trial.number, float(np.mean(costs)))
        print(f"trial {trial.number}: mean cost {np.mean(costs):.4g}", flush=True)

    def _cost(self, trial: Any, seed: int) -> float:
        """Return the final cost of one run, which goes on where it was left, if it was."""
        from zoac.training.lifecycle import run_session

        config = resolved(compose_config([*self._overrides, *_options(trial.params)]))
        config["evaluation"]["seed"] = self._evaluation_seed
        config.update(
            seed=seed,
            runs_dir=str(self._folder / "runs"),
            variant=f"trial-{trial.number}",
            resume="auto",
        )
        result = run_session(config, task=self._task, tuner=self._tuner, command=sys.argv)
        return float(result["cost_mean"])

    def conclude(self) -> None:
        """Print the best trial as overrides for `zoac.run`, and write it to `best.json`."""
        optuna = load_optuna()
        trials = self._study.get_trials(states=[optuna.trial.TrialState.COMPLETE])
        if not trials:
            print(f"no trial of {self._folder} has come to its end")
            return
        best = min(trials, key=lambda t: t.value)
        first = trials[0]
        write_json(
            self._folder / "best.json",
            {"trial": best.number, "cost_mean": best.value, "options": best.params,
             "trials": len(trials), "first_cost_mean": first.value},
        )  # fmt: skip
        print(
            f"best of {len(trials)} whole trials: trial {best.number}, mean cost {best.value:.4g} "
            f"over {len(self._seeds)} seeds (trial {first.number}: {first.value:.4g})\n"
            f"  {' '.join(_options(best.params))}"
        )


def _options(params: Mapping[str, Any]) -> list[str]:
    return [f"{key}={'null' if value is None else value}" for key, value in params.items()]


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the overrides of the runs, and those of the search.

    Without `search=<choice>` the search is called like the tuner.

    Raises:
        ConfigError: If an argument is none, or belongs to the search itself.
    """
    runs, own, choice, tuner = [], [], None, "zoac"
    for argument in arguments:
        key, equals, value = argument.lstrip("+~").partition("=")
        if argument in ("-m", "--multirun"):
            raise ConfigError("a search is no sweep: leave out -m, and use search.seeds")
        if not equals and not argument.startswith("~"):
            raise ConfigError(f"cannot read the override {argument!r}; write key=value")
        if key in ("seed", "variant", "runs_dir", "resume", "evaluation.seed"):
            raise ConfigError(f"{key} is set for each run of a search; see search.seeds")
        if key == "search":
            choice = value
        elif key.startswith("search."):
            own.append(argument)
        else:
            runs.append(argument)
            tuner = value if key == "tuner" else tuner
    return runs, [f"+search={choice or tuner}", *own]


def _options_of_search(runs: Sequence[str], own: Sequence[str]) -> dict[str, Any]:
    """Return `Search`'s options from the command line, checked."""
    choice, *changes = own
    known = [str(key) for key in compose_config([*runs, choice]).search]
    for change in changes:
        path = change.lstrip("+~").partition("=")[0]
        name = path.split(".")[1]
        if name not in known:
            raise ConfigError(f"unknown key 'search.{name}'; {suggest(name, known)}")
    node = compose_config([*runs, *own]).search
    plain = OmegaConf.to_container(node, resolve=True)
    assert isinstance(plain, dict)
    options = {str(key): value for key, value in plain.items()}
    check_arguments(Search, options, "search", provided=("overrides",))
    return options


@reader_may_leave()
def main() -> None:
    """Run the command line; exits with 1 and one message on a user's error."""
    if sys.argv[1:] in (["--help"], ["-h"]):
        print(__doc__)
        return
    try:
        runs, own = split(sys.argv[1:])
        search = Search(runs, **_options_of_search(runs, own))
        search.run()
        search.conclude()
    except ZoacError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
