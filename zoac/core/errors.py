"""Errors meant for the person at the keyboard.

The command line prints any `ZoacError` as one message, without a traceback, and exits with
code 1. Every message says what was wrong, what was expected and, where there is one, the
nearest valid choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any


class ZoacError(Exception):
    """Something the user can mend: the message says what and how."""


class ConfigError(ZoacError):
    """A configuration value is unknown, of the wrong type, out of range or in conflict."""


class RunFolderError(ZoacError):
    """A run folder is missing, damaged, locked or belongs to another configuration."""


class ControllerError(ZoacError):
    """A controller raised, or returned actions of the wrong shape or not finite."""


class UnsavableError(ZoacError):
    """Something cannot be saved: a checkpoint cannot hold it, or it cannot be restored."""


class WorkerError(ZoacError):
    """A worker died repeatedly on the same work, or its environments cannot be restored."""


class EnvironmentContractError(ZoacError):
    """An environment broke the rules of Gymnasium's interface."""


class EnvironmentFailure(EnvironmentContractError):
    """An environment raised, or gave an observation or a cost that is not finite."""


class CallbackError(ZoacError):
    """A user's callback raised; see `zoac.Callback`."""


class NothingWorksError(ZoacError):
    """Every episode failed, so that there is nothing to tune on."""


class StudyError(ZoacError):
    """A study cannot do what it was asked for: no such trial, another result, nothing known yet."""


class TrialsPending(StudyError):
    """The next experiment of a study depends on trials that have no result yet."""


class StudyFinished(StudyError):
    """A study has asked for all of its experiments."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or a SIGTERM stopped a run after an iteration; its checkpoint is written.

    Args:
        message: How the run goes on.
        record: What is known so far, with keys of `result.json`.

    Attributes:
        result: The record as a `zoac.Result`; of `zoac.tune` only.
    """

    result: Any

    def __init__(self, message: str, record: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.record = record or {}


RENAMED = {
    "lanes": "num_envs",
    "start": "baseline",
    "scout": "initial_samples",
    "trust": "initial_sigma",
    "spread": "initial_sigma",
    "gate": "acceptance_test",
    "common_episodes": "common_random_numbers",
    "race_share": "halving_fraction",
    "race_rounds": "halving_rounds",
    "race_survivors": "halving_survivors",
    "finals_share": "selection_fraction",
    "finals_entries": "selection_candidates",
    "tolerated_terminations": "max_termination_rate",
    "reevaluate_share": "reevaluate_fraction",
    "linearise_about": "initial_guess",
    "segment_length": "exploration.segment_length",
    "segments": "exploration.segments",
    "sigma": "exploration.sigma",
    "mirrored": "exploration.mirrored",
    "step_size_end": "step_size.last",
    "step_size_slope": "step_size.slope",
    "anneal": "step_size.anneal",
    "hidden": "critic.hidden",
    "critic_step_size": "critic.step_size",
    "epochs": "critic.epochs",
    "minibatch": "critic.minibatch",
    "normalise_observations": "critic.normalise_observations",
    "critic_target_scale": "critic.target_scale",
    "ours": "zoac",
    "ours_reg": "zoac_reg",
}
"""Former names of options -> their names."""


@contextmanager
def needs_matplotlib() -> Iterator[None]:
    """Say which extra to install if what runs inside finds no Matplotlib. Also a decorator.

    Raises:
        ConfigError: If it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        raise ConfigError("figures need Matplotlib: pip install 'zoac[figures]'") from error


def nearest(name: str, choices: Iterable[str]) -> str | None:
    """Return the choice that is spelt nearly like `name`, if there is one."""
    return next(iter(get_close_matches(name, choices, n=1, cutoff=0.5)), None)


def as_text(error: BaseException) -> str:
    """Return the class and the message of an exception, or its class alone if it has none."""
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def suggest(name: str, choices: Iterable[str]) -> str:
    """Return "did you mean ...?" and the list of valid choices, as one clause.

    Args:
        name: What the user wrote.
        choices: The valid names.
    """
    known = sorted(str(choice) for choice in choices)
    place, dot, last = str(name).rpartition(".")
    if (now := f"{place}{dot}{RENAMED.get(last, last)}") in known and last in RENAMED:
        return f"it is now called {now!r}"
    by_last = {choice.rpartition(".")[2]: choice for choice in reversed(known)}
    close = nearest(last, by_last)
    hint = f"did you mean {by_last[close]!r}? " if close is not None else ""
    if len(known) > MAX_LISTED:
        listed = get_close_matches(str(name), known, n=MAX_LISTED, cutoff=0.0)
        return f"{hint}nearest of {len(known)} known: {', '.join(listed)}"
    return f"{hint}known: {', '.join(known) if known else '(none)'}"


def option_names(node: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return the names of a node's options, those inside a group by "group.option"."""
    names = []
    for key, value in node.items():
        if isinstance(value, Mapping) and "_target_" not in value and value:
            names += option_names(value, f"{prefix}{key}.")
        elif not str(key).startswith("_"):
            names.append(f"{prefix}{key}")
    return names


MAX_LISTED = 40
"""How many choices a message lists: it must fit one screen."""
