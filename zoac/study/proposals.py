"""From results to the parameters of the next experiments, by any tuner of whole episodes.

An experiment is told to the tuner as an episode of one step. A tuner asks for a batch and learns
once all of it has a result. So the parameters of an experiment depend on the results of earlier
batches alone: neither on the order in which results are told nor on restarts.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import compress
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from zoac.algorithm.strategies.base import search_budget
from zoac.config import factory
from zoac.core.errors import ConfigError, RunFolderError, TrialsPending
from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Problem, Tuner
from zoac.study.state.settings import StudySettings
from zoac.study.state.trial import Trial

SAME = 1e-9
"""Normalised parameters closer than this are one experiment."""

DRIFT = 1e-6
"""How far another processor's rounding may move what a tuner proposes."""

Results = Callable[[int], Trial]
"""The trial of a number."""


class Proposals:
    """The parameters of a study's experiments, one after the other.

    The baseline is the first experiment, if that is wanted. If the tuner's first batch holds it
    too, it is measured once. Where a tuner has nothing more to ask, its recommendation is measured
    again.
    """

    def __init__(self, settings: StudySettings) -> None:
        self._settings = settings
        space = settings.space
        self._baseline = None if settings.baseline is None else space.normalise(settings.baseline)
        self.tuner = self._make()
        self._first = 1  # number of the batch's first experiment
        self.batch, self._places = self._next()
        """The experiments that the tuner waits for, and where in them is what it asked for."""
        if self._baseline is not None and settings.baseline_first:
            asked = [self.batch[place] for place in self._places]
            new = [not np.allclose(p.x, self._baseline, rtol=0.0, atol=SAME) for p in asked]
            self.batch = [Proposal(self._baseline, 0), *compress(asked, new)]
            self._places = np.where(new, np.cumsum(new, dtype=int), 0)

    def _next(self) -> tuple[list[Proposal], np.ndarray]:
        asked = self.tuner.ask()
        if any(p.restore or p.horizon is not None for p in asked):
            raise ConfigError(
                f"tuner={self._settings.tuner!r} asks for parts of episodes, and a study has "
                "whole experiments only"
            )
        return asked or [Proposal(self.tuner.recommend(), 0)], np.arange(len(asked))

    def _make(self) -> Tuner:
        settings = self._settings
        problem = Problem(
            space=settings.space,
            observation_size=1,
            num_envs=settings.workers,
            budget=max(1, settings.experiments - settings.baseline_first),
            max_episode_steps=1,
            seed=settings.config["seed"],
            start=self._baseline,
            supports_snapshots=False,
            baseline=self._baseline,
        )
        names = ("seed", "num_envs", "acceptance_test", "initial_sigma", "initial_samples")
        of_run = {"budget": problem.budget, **{name: settings.config[name] for name in names}}
        return factory.build_tuner_for(
            settings.config["tuner"], problem, factory.build_settings(of_run)
        )

    def x(self, number: int, results: Results) -> np.ndarray:
        """Return the normalised parameters (d,) of an experiment.

        Args:
            number: Of the experiment; not below that of the last call.
            results: Returns earlier trials.
        """
        while number >= self._first + len(self.batch):
            self._advance(results)
        return self.batch[number - self._first].x

    def conclusion(self, results: Results) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the tuner's recommendation (d,) after all experiments, and its outcome."""
        while self._first + len(self.batch) <= self._settings.experiments + 1:
            self._advance(results)
        return self.tuner.recommend(), self.tuner.outcome()

    # The models of a study are small: more threads make them slower, and round otherwise.
    @threadpool_limits.wrap(limits=1)
    def _advance(self, results: Results) -> None:
        """Tell the tuner the batch and ask for the next."""
        numbers = range(self._first, self._first + len(self.batch))
        trials = [results(number) for number in numbers]
        if pending := [str(trial.number) for trial in trials if trial.pending]:
            raise TrialsPending(
                f"the next experiment depends on trial(s) {', '.join(pending)}, which have no "
                "result yet; tell or abandon them"
            )
        for proposal, trial in zip(self.batch, trials, strict=True):
            x = self._settings.space.clip(proposal.x)
            if not np.allclose(x, trial.x, rtol=0.0, atol=DRIFT):
                raise RunFolderError(
                    f"trial {trial.number} has other parameters than tuner "
                    f"{self._settings.tuner!r} proposes here and now for the same results. Go on "
                    "with the versions that run.json names, or start a new study"
                )
        if len(self._places):
            segments = [segment(p, t) for p, t in zip(self.batch, trials, strict=True)]
            self.tuner.tell([segments[place] for place in self._places])
        self._first += len(self.batch)
        self.batch, self._places = self._next()


def check(settings: StudySettings) -> Tuner:
    """Return the tuner; refuse one whose first batch is larger than what it may spend."""
    searches = settings.experiments - settings.baseline_first
    Proposals(settings)  # says what is wrong with its settings
    if settings.acceptance_test is not None:
        searches = search_budget(searches, settings.acceptance_test)
    plain = {"budget": searches, "baseline_first": False, "acceptance_test": None,
             "initial_samples": None}  # fmt: skip
    proposals = Proposals(StudySettings({**settings.config, **plain}, settings.tuner))
    size = len(proposals.batch)
    if size > searches:
        raise ConfigError(
            f"experiments={settings.experiments}: tuner {settings.tuner!r} learns from {size} at "
            f"a time, and {searches} are left for its search; allow more experiments, or choose "
            "a tuner that learns from each, such as bo"
        )
    return proposals.tuner


def segment(proposal: Proposal, trial: Trial) -> Segment:
    """Return a trial as an episode of one step; a cost without bound if it failed."""
    told = trial.state == "told"
    return Segment(
        proposal=proposal,
        observations=np.zeros((2, 1)),
        actions=np.zeros((1, 1)),
        commands=np.zeros((1, 1)),
        costs=np.array([trial.cost if told else np.inf], dtype=np.float64),
        terminated=not told,
        truncated=told,
        starts_episode=True,
        failure=None if told else (trial.reason or trial.state),
        violation=trial.violation,
    )
