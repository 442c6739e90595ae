"""What a run prints."""

import fcntl
import io
import os
import pty
import struct
import termios
from contextlib import suppress

import numpy as np
import pytest

from zoac.runs.loggers.console import Console
from zoac.runs.loggers.summary import MAX_PARAMETERS

RUN = {
    "task": "tank",
    "tuner": "zoac",
    "seed": 3,
    "variant": None,
    "tuner_choices": {"start": "random"},
    "parameters": [{"name": "p0", "unit": "m^2/s"}],
}


class Terminal(io.StringIO):
    def isatty(self):
        return True


def evaluation(steps, cost, final=False, **more):
    return {"kind": "eval", "env_steps": steps, "wall_seconds": steps / 100, "cost_mean": cost,
            "cost_per_episode": [cost], "terminations": 4, "final": final, **more}  # fmt: skip


def live_lines(columns, seen=()):
    """Return what the line that moves shows, in a terminal of so many columns."""
    terminal, inside = pty.openpty()
    fcntl.ioctl(inside, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    with os.fdopen(inside, "w", encoding="utf-8") as stream:
        console = Console(500_000, stream=stream)
        console.start(RUN)
        if seen:
            console.resume(seen)
        console.row(evaluation(0, 3.25, baseline_cost_mean=2.198))
        console.row({"kind": "train", "env_steps": 125_000, "wall_seconds": 1250.0, "failures": 12})
        console.row(evaluation(250_000, 2.5))
    shown = b""
    with os.fdopen(terminal, "rb", buffering=0) as screen, suppress(OSError):  # at its end
        while part := screen.read(4096):
            shown += part
    return [line.rstrip() for line in shown.decode().split("\r") if "%|" in line]


def result(**changes):
    named = {f"p{k}": 0.1 * k for k in range(12)}
    baseline = {"cost_per_episode": [4.0, 4.0, 4.0]}
    told = {"cost_mean": 2.0, "cost_per_episode": [1.0, 2.0, 3.0], "baseline": baseline}
    return {"parameters": named, "warnings": [], **told, **changes}


def printed(stream, **options):
    console = Console(500_000, stream=stream, **options)
    console.start(RUN)
    for steps in (0, 250_000, 500_000):
        console.row(evaluation(steps, 123456.7 / (steps + 1), final=steps == 500_000))
    console.finish(result())
    return stream.getvalue()


def test_a_line_of_an_evaluation_fits_80_columns_without_the_runs_name():
    lines = printed(io.StringIO()).splitlines()
    told = [line for line in lines if " steps | " in line]
    assert len(told) == 3
    assert max(map(len, told)) <= 80
    assert not any("tank" in line or "seed" in line for line in told)
    assert told[1].split("|")[1].strip() == "41:40, 41:40 left"


def test_a_job_of_a_sweep_shows_the_line_that_moves_at_most():
    assert printed(io.StringIO(), brief=True) == ""
    assert printed(Terminal(), brief=True, live=False) == ""
    moving = printed(Terminal(), brief=True)
    assert "tank zoac seed=3   0%|" in moving
    assert "\n" not in moving


def test_a_terminal_has_one_line_that_moves():
    text = printed(Terminal())
    assert " steps | " not in text
    assert "\r" in text
    assert "best=0.2469" in text


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_the_line_that_moves_fits_and_leaves_out_what_matters_least(columns):
    lines = live_lines(columns)
    assert max(map(len, lines)) <= columns
    told = [f for f in ("best=2.5", "baseline=2.198", "failed=12", "terminated=4", "cost=2.5")
            if f in lines[-1]]  # fmt: skip
    assert (
        told
        == {
            60: ["best=2.5", "failed=12"],
            80: ["best=2.5", "baseline=2.198", "failed=12"],
            120: ["best=2.5", "baseline=2.198", "failed=12", "terminated=4", "cost=2.5"],
        }[columns]
    )
    assert "left" in lines[-1]


@pytest.mark.parametrize("failed", [np.nan, np.inf, -np.inf])
def test_a_cost_that_is_not_finite_is_never_the_best(failed):
    seen = [evaluation(0, 1.75), evaluation(1000, failed)]
    assert "best=1.75" in live_lines(120, seen)[-1]


def test_a_run_that_goes_on_shows_the_best_cost_and_the_failures_of_before():
    seen = [evaluation(0, 1.75, baseline_cost_mean=2.198), evaluation(1000, 4.0, failures=30)]
    _, first, *_, last = live_lines(120, seen)
    assert "best=1.75, baseline=2.198, failed=30" in first
    assert "best=1.75, baseline=2.198, failed=12" in last


def test_the_last_lines_tell_costs_with_their_interval_and_some_parameters(tmp_path):
    text = printed(io.StringIO(), folder=tmp_path / "a run")
    half = 1.96 * np.std([1.0, 2.0, 3.0], ddof=1) / np.sqrt(3)
    assert f"cost 2 ± {half:.2g}, baseline values 4 on the same 3 episodes" in text
    assert "p0 = 0 m^2/s" in text
    assert text.count(" = ") == MAX_PARAMETERS
    assert "and 2 more in result.json" in text
    assert f"python -m zoac.analysis.report '{tmp_path}/a run'" in text


@pytest.mark.parametrize("costs", [[1.0], [None, 1.0]])
def test_an_interval_that_cannot_be_told_is_left_out(costs):
    console = Console(1, stream=(stream := io.StringIO()))
    console.finish(result(cost_per_episode=costs, baseline=None))
    assert "±" not in stream.getvalue()


def test_a_parameter_stands_beside_its_baseline():
    console = Console(1, stream=(stream := io.StringIO()))
    console.start({**RUN, "nominal": {"p0": 2.0}})
    console.finish(result(parameters={"p0": 0.25, "kind": "fast"}))
    assert "  p0 = 0.25 m^2/s, baseline 2\n  kind = fast\n" in stream.getvalue()


def test_short_choices_of_a_tuner_share_a_line():
    console = Console(5000, stream=(stream := io.StringIO()))
    choices = {"start": "baseline", "hard specs": "chosen on held-out episodes", "sigma": 0.25}
    console.start({**RUN, "tuner_choices": choices})
    _, *lines = stream.getvalue().splitlines()
    assert lines == ["  hard specs: chosen on held-out episodes", "  start: baseline, sigma: 0.25"]


def test_large_costs_are_wrapped():
    console = Console(5000, stream=(stream := io.StringIO()))
    costs = [6.72e5 + 1000.0 * k for k in range(20)]
    baseline = {"cost_per_episode": [1.373e6 + 17_000.0 * k for k in range(20)]}
    console.finish(result(cost_per_episode=costs, baseline=baseline))
    lines = stream.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert "on the same 20 episodes" in " ".join(" ".join(lines).split())


def test_sentences_are_wrapped_and_a_callbacks_stop_is_told():
    console = Console(5000, stream=(stream := io.StringIO()))
    console.finish(result(warnings=["word " * 40], stopped_by="Patience", env_steps=1200))
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "stopped by the callback Patience after 1,200 of 5,000 steps" in text
