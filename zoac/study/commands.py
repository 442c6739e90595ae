"""The commands of `python -m zoac.study`: JSON on standard output, the rest on standard error."""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from zoac.core.errors import ConfigError, StudyError, StudyFinished, TrialsPending, ZoacError
from zoac.runs.schema import RUN, plain
from zoac.specs.spec import Spec
from zoac.study.carry_out import carry_out
from zoac.study.dialogue import carry_out_by_hand
from zoac.study.program import program
from zoac.study.state.trial import Trial
from zoac.study.study import Study
from zoac.tasks.user_specs import specs_of

if TYPE_CHECKING:
    import pandas as pd

ERROR, WAITS, FINISHED, INTERRUPTED = 1, 3, 4, 130
"""Exit statuses beside 0, and 2 for a command line that cannot be read."""

EXIT_STATUS = """\
exit status:
  0    done
  1    an error, which standard error tells
  2    the command line cannot be read
  3    ask: the next experiment depends on trials without a result; try again later
  4    ask: every experiment has been asked for
"""


def command(arguments: Sequence[str]) -> int:
    """Run one command; return its exit status."""
    try:
        options = _parser().parse_args(_with_equals(arguments))
        found = options.run(options)
    except TrialsPending as error:
        return _say(error, WAITS)
    except StudyFinished as error:
        return _say(error, FINISHED)
    except ZoacError as error:
        return _say(f"error: {error}", ERROR)
    except KeyboardInterrupt:
        return _say("interrupted; the same command goes on", INTERRUPTED)
    if found is not None:
        print(json.dumps(plain(found), allow_nan=False))
    return 0


def _say(what: object, status: int) -> int:
    print(what, file=sys.stderr)
    return status


def _with_equals(arguments: Sequence[str]) -> list[str]:
    """Return arguments in which `--cost -1e-3` is one: argparse would see an option in it."""
    joined = list(arguments)
    if "--cost" in joined[:-1]:
        at = joined.index("--cost")
        joined[at : at + 2] = [f"--cost={joined[at + 1]}"]
    return joined


AS_IN_PYTHON = (
    "tuner", "experiments", "seed", "workers", "acceptance_test", "trial_timeout",
)  # fmt: skip
"""Options of `create` that `Study` takes as they are."""


def _create(options: argparse.Namespace) -> dict[str, Any]:
    folder = Path(options.folder).expanduser()
    if (folder / RUN).exists():
        raise ConfigError(f"{folder} holds a study or run already; choose another folder")
    study = Study(
        space=_mapping(options.space),
        folder=folder,
        baseline=_mapping(options.baseline),
        baseline_first=not options.no_baseline_first,
        constraints=_numbers(options.limit, "--limit"),
        specs=_specs(options.specs),
        **{name: getattr(options, name) for name in AS_IN_PYTHON},
    )
    return {"folder": str(study.folder), "tuner": study.settings.tuner}


def _yaml(path: str, kind: type, expected: str) -> Any:
    """Return what a YAML file holds, a mapping or a list."""
    try:
        content = OmegaConf.to_container(OmegaConf.load(path))
    except OSError as error:
        why = error.strerror or "expected entries by name, or a list"  # OmegaConf: a number, say
        raise ConfigError(f"{path}: {why}") from None
    except Exception as error:  # whatever a YAML reader raises
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from None
    if not isinstance(content, kind):
        raise ConfigError(f"{path}: expected {expected}")
    return content


def _specs(path: str | None) -> tuple[Spec, ...]:
    return specs_of(_yaml(path, list, "a list of specs")) if path else ()


def _mapping(path: str | None) -> dict[str, Any] | None:
    if path is None:
        return None
    content = _yaml(path, dict, "entries by name, such as `kp: [0, 20]`")
    return {str(name): value for name, value in content.items()}


def _numbers(given: Sequence[str] | None, option: str) -> dict[str, float]:
    numbers = {}
    for text in given or ():
        name, equals, value = text.partition("=")
        try:
            numbers[name] = float(value)
        except ValueError:
            equals = ""
        if not equals or not name:
            raise ConfigError(f"{option} {text!r}: expected name=number")
    return numbers


def _ask(options: argparse.Namespace) -> dict[str, Any]:
    trial = options.study.ask(by=options.by, wait=options.wait)
    return {"number": trial.number, "parameters": trial.parameters}


def _tell(options: argparse.Namespace) -> dict[str, Any]:
    trial = options.study.tell(
        options.number,
        options.cost,
        failed=options.failed,
        trace=None if options.trace is None else _table(options.trace),
        metrics=_numbers(options.metric, "--metric"),
        constraints=_numbers(options.constraint, "--constraint"),
    )
    return _told(trial)


def _table(path: str) -> pd.DataFrame:
    """Return the table of a CSV file whose first line names the columns."""
    import pandas as pd

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # values beyond the columns
            # Some loggers end each row with a comma, from which pandas would make an index.
            table = pd.read_csv(path, index_col=False)
        names = pd.read_csv(path, header=None, nrows=1).iloc[0].dropna()
    except (OSError, ValueError, pd.errors.ParserWarning) as error:
        raise ConfigError(f"{path}: cannot be read as a table: {error}") from None
    if len(twice := names[names.duplicated()]):  # pandas would give the second another name
        raise ConfigError(f"{path}: several columns are called {twice.iloc[0]!r}; expected one")
    return table


TOLD = ("number", "state", "parameters", "cost", "reason", "metrics", "constraints")


def _told(trial: Trial) -> dict[str, Any]:
    told = {name: getattr(trial, name) for name in TOLD}
    return {name: value for name, value in told.items() if value not in (None, {})}


def _status(options: argparse.Namespace) -> dict[str, Any]:
    study: Study = options.study
    states = [trial.state for trial in study.trials]
    best = None
    with suppress(StudyError):
        best = _told(study.best)
    return {
        "experiments": study.settings.experiments,
        "asked": len(states),
        **{state: states.count(state) for state in ("told", "failed", "abandoned")},
        "pending": [trial.number for trial in study.pending],
        "finished": study.finished,
        "best": best,
    }


def _run(options: argparse.Namespace) -> dict[str, Any]:
    cost = program(options.command, timeout=options.timeout, retries=options.retries)
    carry_out(options.study, cost)
    return _told(options.study.best)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m zoac.study",
        description="Experiments that a script, a rig or a person runs.",
        epilog=EXIT_STATUS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="command")

    def add(name: str, run: Callable[[argparse.Namespace], Any], text: str) -> Any:
        added = commands.add_parser(name, help=text, description=text)
        added.set_defaults(run=run)
        if run is _create:
            added.add_argument("folder", help="of the study")
        else:
            added.add_argument("study", type=lambda folder: Study(folder=folder), metavar="folder",
                               help="of the study")  # fmt: skip
        return added

    create = add("create", _create, "begin a study")
    create.add_argument("--space", required=True, metavar="YAML",
                        help="file with bounds by name, such as `kp: [0, 20]`")  # fmt: skip
    create.add_argument("--experiments", type=int, default=60)
    create.add_argument("--tuner", default="auto")
    create.add_argument("--seed", type=int, default=0)
    create.add_argument("--workers", type=int, default=1, help="experiments planned side by side")
    create.add_argument("--baseline", metavar="YAML", help="file with the values in use today")
    create.add_argument("--no-baseline-first", action="store_true",
                        help="do not make the baseline the first experiment")  # fmt: skip
    create.add_argument("--limit", action="append", metavar="NAME=NUMBER", help="of a constraint")
    create.add_argument("--specs", metavar="YAML", help="file with a list of specs, such as "
                        "`- overshoot: {y: y, r: r, max: 0.05}`")  # fmt: skip
    create.add_argument("--acceptance-test", type=float, metavar="FRACTION",
                        help="of the experiments, to compare answer and baseline")  # fmt: skip
    create.add_argument("--trial-timeout", type=float, metavar="SECONDS",
                        help="after which an experiment without a result is abandoned")  # fmt: skip
    ask = add("ask", _ask, "print the next experiment")
    ask.add_argument("--by", default="", help="who asks, for people")
    ask.add_argument("--wait", type=float, default=0.0, metavar="SECONDS",
                     help="for results that the next experiment depends on")  # fmt: skip
    tell = add("tell", _tell, "tell the result of an experiment")
    tell.add_argument("number", type=int)
    tell.add_argument("--cost", type=float)
    tell.add_argument("--failed", metavar="WHY")
    tell.add_argument("--trace", metavar="CSV", help="judged by the study's specs")
    for kind in ("metric", "constraint"):
        tell.add_argument(f"--{kind}", action="append", metavar="NAME=NUMBER")
    abandon = add("abandon", lambda o: _told(o.study.abandon(o.number, o.reason)),
                  "give up an experiment that never comes back")  # fmt: skip
    abandon.add_argument("number", type=int)
    abandon.add_argument("--reason", default="given up")
    add("status", _status, "print how far the study is")
    add("best", lambda o: _told(o.study.best), "print the answer so far")
    export = add("export", lambda o: {"file": str(o.study.export(o.file))},
                 "write the answer as .yaml, .json, .h or .m")  # fmt: skip
    export.add_argument("file")
    run = add("run", _run, "carry the study out with a program that answers in JSON")
    run.add_argument("--timeout", type=float, metavar="SECONDS")
    run.add_argument("--retries", type=int, default=0)
    run.add_argument("command", nargs="+", help="behind --")
    add("interactive", lambda o: carry_out_by_hand(o.study), "run the experiments by hand")
    return parser
