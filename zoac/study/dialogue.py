"""A study that a person carries out: parameters are shown, results are typed."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from zoac.core.errors import ConfigError, StudyError, StudyFinished, TrialsPending
from zoac.runs.loggers.summary import shown
from zoac.study.state.ledger import told
from zoac.study.state.trial import Trial
from zoac.study.study import Study

HELP = """\
  a number        the cost of this experiment
  failed [why]    it failed: the motor tripped, say
  repeat          show the values again, for another try of the same experiment
  baseline        show the baseline values, to put the plant back to them
  stop            leave; the same command goes on with this experiment"""


def carry_out_by_hand(study: Study) -> None:
    """Ask a person for one result after the other, on standard input and output.

    This ends when the experiments are used up or the person stops.
    """
    print(f"{study.folder}\n{HELP}")
    try:
        while (trial := _next(study)) is not None and _answered(study, trial):
            pass
    except (EOFError, KeyboardInterrupt):
        print("\nstopped")
    with suppress(StudyError):
        best = study.best
        print(f"best so far: experiment {best.number}, {told(best)}")
        _show(study, best.parameters)


def _next(study: Study) -> Trial | None:
    if pending := study.pending:
        return pending[0]
    try:
        return study.ask(by="person")
    except StudyFinished:
        print("every experiment has its result")
    except TrialsPending as error:
        print(error)
    return None


def _answered(study: Study, trial: Trial) -> bool:
    """Show a trial; take the person's answers until it has a result. False: they stop."""
    word, rest = "repeat", ""
    while word != "stop":
        if word == "repeat":
            print(f"\nexperiment {trial.number} of {study.settings.experiments}")
            _show(study, trial.parameters)
        elif word == "baseline":
            _show_baseline(study)
        elif word == "failed":
            study.tell(trial, failed=rest or "failed")
            return True
        elif word:
            typed = f"{word} {rest}".strip()
            try:
                study.tell(trial, float(typed))
                return True
            except ConfigError as error:
                print(error)
            except ValueError:
                print(f"{typed!r} is no number\n{HELP}")
        word, _, rest = input("cost> ").strip().partition(" ")
    return False


def _show_baseline(study: Study) -> None:
    baseline = study.settings.baseline
    if baseline is None:
        print("  this study has no baseline values")
        return
    print("  baseline values:")
    _show(study, {**baseline, **study.settings.fixed})


def _show(study: Study, parameters: Mapping[str, Any]) -> None:
    units = {p.name: p.unit for p in study.settings.space.parameters}
    width = max(map(len, parameters))
    for name, value in parameters.items():
        print(f"  {name:{width}}  {shown(value)} {units.get(name, '')}".rstrip())
