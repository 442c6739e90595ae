"""What the README tells people to type."""

import re
import shlex
from pathlib import Path

import pytest

from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.run.command import multirun_first

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
COMMANDS = [
    shlex.split(line, comments=True)
    for language, text in BLOCKS
    if language == "bash"
    for line in text.splitlines()
]
RUNS = [c[3:] for c in COMMANDS if c[:3] == ["python", "-m", "zoac.run"]]


def test_make_targets_exist():
    targets = [c[1] for c in COMMANDS if c and c[0] == "make"]
    makefile = (ROOT / "Makefile").read_text()
    assert targets[:2] == ["run", "test"]
    assert all(f"\n{target}:" in makefile for target in targets)


def test_ci_runs_the_test_command_of_the_readme():
    assert re.search(r"^make .*\btest$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)


@pytest.mark.parametrize("arguments", RUNS, ids=" ".join)
def test_run_commands_compose_and_build(arguments):
    first = [
        re.sub(r"=([^,\[]+),.*", r"=\1", a)  # the first job of a sweep
        for a in multirun_first(arguments)
        if not a.startswith("-")
    ]
    config = resolved(compose_config(first))
    settings = factory.build_settings(config)
    factory.build_tuner(config["tuner"], factory.build_task(config), settings)
    factory.build_executor(config)


EXAMPLES = [text for language, text in BLOCKS if language == "python"]


def run_script(name, shown):
    """Run an example, which must end with what the README shows of it."""
    script = (ROOT / "examples" / f"{name}.py").read_text()
    assert script.endswith(shown)
    quick = script.replace("budget=60_000", "budget=4_000")
    quick = quick.replace("dead_time=", "seed=2, dead_time=")  # which needs few episodes
    exec(compile(quick, f"{name}.py", "exec"), {"__name__": "__main__"})


def test_the_first_example_prints_the_table(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("zoac.pid.tuning.EPISODES", 120)
    run_script("first", EXAMPLES[0])
    (table,) = (text for language, text in BLOCKS if language == "text")
    rows, shown = capsys.readouterr().out.splitlines()[-7:], table.splitlines()
    assert len(shown) == 7
    # Last digits may differ on another processor.
    for row, told in zip(rows, shown, strict=True):
        assert row.split()[0] == told.split()[0]
        assert row.endswith("  met") == told.endswith("  met")
    assert sum(row.endswith("  met") for row in rows) == 3
    assert (tmp_path / "step.svg").stat().st_size > 1000


def test_the_cart_is_tuned_and_its_specs_are_told(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    run_script("cart", EXAMPLES[1])
    assert "overshoot(x, goal) <= 0.05" in capsys.readouterr().out
    assert (tmp_path / "cart.png").stat().st_size > 1000
