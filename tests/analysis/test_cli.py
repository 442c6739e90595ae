"""Numbers on the command lines of the analysis."""

import argparse

import pytest

from tests.analysis.folders import write_run
from zoac.analysis import (
    beyond,
    compact,
    curves,
    landscape,
    report,
    robustness,
    table2,
    trajectories,
)
from zoac.analysis.data import cli


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (compact, "--every"),
        (compact, "--digits"),
        (landscape, "--points"),
        (landscape, "--episodes"),
        (robustness, "--plants"),
        (robustness, "--episodes"),
        (table2, "--budget"),
    ],
)
@pytest.mark.parametrize("value", ["0", "-3", "2.5", "x"])
def test_counts_start_at_one(tmp_path, capsys, command, option, value):
    with pytest.raises(SystemExit) as ended:
        command.main([str(tmp_path), f"{option}={value}"])
    assert ended.value.code == 2
    told = f"argument {option}: expected a whole number of at least 1, got '{value}'"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "seeds"), [("3", [3]), ("0,4", [0, 4]), ("8-11", [8, 9, 10, 11]), ("1,3-4", [1, 3, 4]),
     ("0-2,1", [0, 1, 2]), ("5,3,5", [3, 5])],
)  # fmt: skip
def test_seeds_are_a_list_or_a_range_each_once(text, seeds):
    assert cli.seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "x", "3-1", "1-", "-1", "1.5", "0,,1"])
def test_other_texts_are_no_seeds(text):
    with pytest.raises(argparse.ArgumentTypeError, match="seeds such as 0,3,4 or 0-9"):
        cli.seeds(text)


@pytest.mark.parametrize("command", [beyond, table2])
def test_a_bad_list_of_seeds_is_told_by_the_option(tmp_path, capsys, command):
    with pytest.raises(SystemExit):
        command.main([str(tmp_path), "--seeds=0-x"])
    assert "argument --seeds: expected seeds such as 0,3,4 or 0-9" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["-1", "0.5", "x"])
def test_a_seed_is_a_whole_number(tmp_path, capsys, value):
    with pytest.raises(SystemExit):
        robustness.main([str(tmp_path), f"--seed={value}"])
    told = f"argument --seed: expected a whole number of at least 0, got '{value}'"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [beyond, compact, curves, landscape, report, robustness, table2, trajectories]
)
def test_without_a_finished_run_there_is_one_message_and_no_file(tmp_path, capsys, command):
    write_run(tmp_path / "runs", task="mpc_tracking", finished=False)
    assert command.main([str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 1
    *_, told = capsys.readouterr().err.splitlines()
    expected = "error: no finished run among 1; relaunching an unfinished one resumes it"
    assert told == expected
    assert not (tmp_path / "out").exists()


def test_a_file_that_cannot_be_written_is_one_message(sweep, tmp_path, capsys):
    (tmp_path / "out" / "table2.md").mkdir(parents=True)
    arguments = [str(sweep), "--task", "pid_acc", "--out", str(tmp_path / "out")]
    assert table2.main(arguments) == 1
    told = f"error: cannot write {tmp_path}/out/table2.md: Is a directory\n"
    assert capsys.readouterr().err == told


def test_a_film_that_cannot_be_written_is_one_message(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("zoac.analysis.figures.film.FRAMES", 1)
    monkeypatch.setattr("zoac.analysis.figures.film.HOLD", 0)
    path = tmp_path / "loop.gif"
    path.mkdir()
    assert trajectories.main([str(write_run(tmp_path / "runs")), "--animate", str(path)]) == 1
    told = capsys.readouterr().err.splitlines()
    told = [line for line in told if not line.startswith("compiling")]  # of the first run ever
    assert told == [f"error: cannot write {path}: Is a directory"]


def test_prose_and_bullets_of_markdown_are_wrapped_and_rows_are_not(tmp_path, capsys):
    row, prose = f"| {'cell ' * 40}|", f"{'word ' * 40}end"
    # At the right edge stands a minus sign, with which no line may begin: it would be a bullet.
    claim = f"- ZOAC {'x' * 83} (w/ reg) - CMA-ES = {'word ' * 20}end"
    cli.write_markdown(tmp_path / "a.md", f"{prose}\n\n{row}\n\n{claim}\n")
    text = (tmp_path / "a.md").read_text()
    assert capsys.readouterr().out.startswith(text)
    wrapped, kept, bullet = text.removesuffix("\n").split("\n\n")
    assert kept == row
    for part, indent in ((wrapped, ""), (bullet, "  ")):
        first, *others = part.split("\n")
        assert 90 < len(first) <= 100
        assert others
        assert all(len(line) <= 100 and line.startswith(indent) for line in others)
        assert not any(line.lstrip().startswith("-") for line in others)
    assert [" ".join(part.split()) for part in (wrapped, bullet)] == [prose, claim]
