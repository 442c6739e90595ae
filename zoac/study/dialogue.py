"""A study that a person carries out: parameters are shown, results are typed."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from zoac.core.errors import ConfigError, StudyError, StudyFinished, TrialsPending
from zoac.study.state.ledger import told
from zoac.study.state.trial import Trial
from zoac.study.study import Study

HELP = """\
  a number        the cost of this experiment
  failed [why]    it failed: the motor tripped, say
  repeat          show the values again, for another try of the same experiment
  baseline        show the baseline values, to put the plant back to them
  stop            leave; the same command goes on with this experiment"""


class Dialogue:
    """Asks a person for one result after the other, on standard input and output."""

    def __init__(self, study: Study) -> None:
        """
        Args:
            study: What is carried out.
        """
        self._study = study

    def run(self) -> None:
        """Go on until the experiments are used up or the person stops."""
        print(f"{self._study.folder}\n{HELP}")
        try:
            while (trial := self._next()) is not None:
                self._show(trial)
                if not self._answer(trial):
                    break
        except (EOFError, KeyboardInterrupt):
            print("\nstopped")
        with suppress(StudyError):
            best = self._study.best
            print(f"best so far: experiment {best.number}, {told(best)}")
            self._values(best.parameters)

    def _next(self) -> Trial | None:
        if pending := self._study.pending:
            return pending[0]
        try:
            return self._study.ask(by="person")
        except StudyFinished:
            print("every experiment has its result")
        except TrialsPending as error:
            print(error)
        return None

    def _answer(self, trial: Trial) -> bool:
        """Take the person's answers until the trial has a result; False: they stop."""
        while True:
            word, _, rest = input("cost> ").strip().partition(" ")
            if word == "stop":
                return False
            if word == "repeat":
                self._show(trial)
            elif word == "baseline":
                self._baseline()
            elif word == "failed":
                self._study.tell(trial, failed=rest or "failed")
                return True
            elif word and self._cost(trial, f"{word}{rest}"):
                return True

    def _cost(self, trial: Trial, text: str) -> bool:
        try:
            cost = float(text)
        except ValueError:
            print(f"{text!r} is no number\n{HELP}")
            return False
        try:
            self._study.tell(trial, cost)
        except ConfigError as error:
            print(error)
            return False
        return True

    def _show(self, trial: Trial) -> None:
        print(f"\nexperiment {trial.number} of {self._study.settings.experiments}")
        self._values(trial.parameters)

    def _baseline(self) -> None:
        baseline = self._study.settings.baseline
        if baseline is None:
            print("  this study has no baseline values")
            return
        print("  baseline values:")
        self._values({**baseline, **self._study.settings.fixed})

    def _values(self, parameters: Mapping[str, Any]) -> None:
        units = {p.name: p.unit for p in self._study.settings.space.parameters}
        width = max(map(len, parameters))
        for name, value in parameters.items():
            shown = f"{value:.6g}" if isinstance(value, float) else value
            print(f"  {name:{width}}  {shown} {units.get(name, '')}".rstrip())
