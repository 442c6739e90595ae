"""Which tuner: tuners over many problems and numbers of experiments.

    python -m zoac.run experiment=suite -m
    python -m zoac.analysis.suite runs --out tables

The files are suite.md, suite.csv with a row for each run, and the figure suite. In place of a
folder of runs the command also reads such a suite.csv. `zoac.analysis.statistics.profiles` says
what a score is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from zoac.analysis.data import cli
from zoac.analysis.data.runs import Method, Run
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import TUNERS
from zoac.analysis.pages.formatting import NOTHING, pipes
from zoac.analysis.statistics import profiles
from zoac.analysis.statistics.intervals import Interval
from zoac.analysis.statistics.profiles import RANDOM
from zoac.core.errors import ConfigError, RunFolderError, suggest

COLUMNS = ["problem", "parameters", "tuner", "experiments", "seed", "cost", "seconds"]
KEY = ["problem", "tuner", "experiments", "seed"]
"""What tells runs apart."""

FAILED = "failed"
"""In place of a median cost: half of the runs or more have no finite one."""

LIMITS = np.linspace(0.0, 1.5, 151)
"""Scores of the profiles' axis."""


@cli.command(
    "suite", "Tuners over many problems.", "tables", "format",
    against={"default": RANDOM, "metavar": "TUNER", "help": f"default: {RANDOM}"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write tables and figure."""
    found = read(options.runs) if options.runs.suffix == ".csv" else frame_of(options)
    runs = profiles.failures_last(found)
    if (twice := runs.duplicated(KEY)).any():
        what = ", ".join(f"{name} {runs.loc[twice, name].iloc[0]}" for name in KEY)
        raise RunFolderError(f"{options.runs}: two runs of {what}; keep one variant a folder")
    if options.against not in (known := sorted(set(runs["tuner"]))):
        raise ConfigError(f"no run of tuner {options.against!r}; {suggest(options.against, known)}")
    cli.write(options.out / "suite.csv", runs.to_csv(index=False, lineterminator="\n"))
    cli.write_markdown(options.out / "suite.md", markdown(runs, options.against))
    style.save(lambda: figure(profiles.with_scores(runs)), options, "suite")


def frame_of(options: argparse.Namespace) -> pd.DataFrame:
    """Return a row for each finished run whose budget was given in experiments; refuse none."""
    runs = [
        run
        for run in cli.load_runs(options, episodes=False).some_finished()
        if run.config.get("experiments") is not None
    ]
    if not runs:
        raise RunFolderError(
            f"{options.runs}: no finished run has a number of experiments; make some with "
            "experiment=suite, or experiments=100"
        )
    frame = pd.DataFrame([_row(run) for run in runs], columns=COLUMNS)
    return frame.sort_values(KEY, ignore_index=True)


def _row(run: Run) -> list[object]:
    # Rounded as `zoac.analysis.compact` rounds them.
    return [
        run.method.task,
        len(run.outcome["parameters"]),
        run.method.tuner,
        int(run.config["experiments"]),
        run.seed,
        float(f"{run.cost_mean:.5g}"),
        round(run.outcome["compute_seconds"], 2),
    ]


def read(path: Path) -> pd.DataFrame:
    """Return the rows of a suite.csv; refuse another file."""
    try:
        frame = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read as CSV: {error}") from None
    if missing := [name for name in COLUMNS if name not in frame]:
        raise RunFolderError(f"{path}: no column {missing[0]!r}; expected {', '.join(COLUMNS)}")
    for name in set(COLUMNS) - {"problem", "tuner"}:
        if not pd.api.types.is_numeric_dtype(frame[name]):
            raise RunFolderError(f"{path}: column {name!r}: expected numbers only")
    return frame[COLUMNS]


def markdown(runs: pd.DataFrame, against: str) -> str:
    """Return the tables: scores, who is better than `against` how often, experiments needed, costs.

    The runs are rows as in suite.csv, as `failures_last` returns them.
    """
    scored = profiles.with_scores(runs)
    text = [
        "# Which tuner\n",
        f"{scored['problem'].nunique()} problems. A score is (cost - best) / (reference - best): "
        "best is the lowest cost of all runs on the problem, and the reference is the median of "
        "random search with the fewest experiments. In brackets: 95% intervals of the bootstrap "
        "over problems and seeds.\n",
    ]
    text += _left_out(runs[~runs["problem"].isin(scored["problem"])])
    for count, group in scored.groupby("experiments"):
        text += [f"## {count:,} experiments\n", _scores(group, against)]
    needed = profiles.experiments_needed(scored)
    text += [
        f"## Experiments until most runs score at most {profiles.NEAR:g}\n",
        _needed(needed, _sizes(scored)),
        "## Costs\n\nMedian over the seeds; the lowest of a row is bold.\n",
        _costs(runs),
    ]
    return "\n".join(text)


def _left_out(runs: pd.DataFrame) -> list[str]:
    """Return a sentence for each reason why problems have no scores."""
    known = {str(name): profiles.reference_cost(own) for name, own in runs.groupby("problem")}
    failed = [name for name, cost in known.items() if np.isinf(cost)]
    others = [name for name in known if name not in failed]
    reasons = {
        "random search was not run there, or no run beats it": others,
        "random search fails in half of its runs there, or more": failed,
    }
    return [f"Left out, since {why}: {', '.join(of)}.\n" for why, of in reasons.items() if of]


def _scores(group: pd.DataFrame, against: str) -> str:
    rows = []
    for tuner, own in group.groupby("tuner"):
        other = group[group["tuner"] == against]
        better = NOTHING if tuner == against else _cell(profiles.improvement(own, other))
        near = profiles.share_within(own["score"].to_numpy(), [profiles.NEAR])[0]
        mean = profiles.mean_score(own)
        cells = [
            _name(str(tuner)), _cell(mean), f"{near:.0%}", better,
            str(int((~np.isfinite(own["score"])).sum())), f"{own['seconds'].median():.1f}",
            f"{own['problem'].nunique()} x {own['seed'].nunique()}",
        ]  # fmt: skip
        rows.append((mean.estimate, cells))
    head = [
        "Tuner", "mean score, each at most 1", f"score <= {profiles.NEAR:g}",
        f"P(costs less than {_name(against)})", "failed", "processor seconds (median)",
        "problems x seeds",
    ]  # fmt: skip
    return pipes([head, *(cells for _, cells in sorted(rows, key=lambda row: row[0]))]) + "\n"


def _needed(needed: pd.DataFrame, sizes: pd.Series) -> str:
    rows = [["Problem", "parameters", *(_name(str(tuner)) for tuner in needed)]]
    for problem in sizes.index:
        cells = [NOTHING if np.isnan(v) else f"{v:,.0f}" for v in needed.loc[problem]]
        rows.append([problem, str(sizes[problem]), *cells])
    return pipes(rows) + "\n"


def _costs(runs: pd.DataFrame) -> str:
    table = runs.pivot_table(
        index=["problem", "experiments"], columns="tuner", values="cost", aggfunc="median"
    )
    rows = [["Problem", "experiments", *(_name(str(tuner)) for tuner in table)]]
    order = {problem: k for k, problem in enumerate(_sizes(runs).index)}
    for key in sorted(table.index, key=lambda key: (order[key[0]], key)):
        (problem, count), costs = key, table.loc[key]
        text = [_cost(cost) for cost in costs]
        least = _cost(costs.min())
        bold = (f"**{t}**" if t == least != FAILED else t for t in text)
        rows.append([problem, str(count), *bold])
    return pipes(rows) + "\n"


def _cost(cost: float) -> str:
    return NOTHING if np.isnan(cost) else FAILED if np.isinf(cost) else f"{cost:.4g}"


def _sizes(runs: pd.DataFrame) -> pd.Series:
    """Return the number of parameters of each problem, few first."""
    sizes = runs.groupby("problem")["parameters"].first().reset_index()
    return sizes.sort_values(["parameters", "problem"]).set_index("problem")["parameters"]


def _name(tuner: str) -> str:
    return TUNERS.get(tuner, tuner)


def _cell(value: Interval) -> str:
    if np.isnan(value.estimate):
        return NOTHING
    return f"{value.estimate:.2f} [{value.low:.2f}, {value.high:.2f}]"


def figure(scored: pd.DataFrame) -> style.Figure:
    """Return the performance profiles: the share of runs within each score, by experiments."""
    counts = sorted(set(scored["experiments"]))
    drawn = style.blank(style.PAGE, 2.4)
    panels = drawn.subplots(1, len(counts), sharey=True, squeeze=False)[0]
    methods = {tuner: Method("suite", tuner, None) for tuner in sorted(set(scored["tuner"]))}
    looks = style.looks(methods.values())
    for axes, count in zip(panels, counts, strict=True):
        group = scored[scored["experiments"] == count]
        for tuner, own in group.groupby("tuner"):
            share = profiles.share_within(own["score"].to_numpy(), list(LIMITS))
            axes.plot(
                LIMITS, share, label=_name(str(tuner)), markevery=25,
                **looks[methods[str(tuner)]].line,
            )  # fmt: skip
        axes.set_title(f"{count:,} experiments")
        axes.set_xlabel("Score")
        axes.margins(x=0)
    panels[0].set_ylabel("Share of runs")
    panels[0].set_ylim(0, 1)
    style.legend_above(drawn, style.entries(drawn))
    return drawn


if __name__ == "__main__":
    raise SystemExit(main())
