"""Numbers on the command lines of the analysis."""

import argparse

import pytest

from zoac.analysis import beyond, cli, compact, landscape, robustness, table2


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
    ("text", "seeds"), [("3", [3]), ("0,4", [0, 4]), ("8-11", [8, 9, 10, 11]), ("1,3-4", [1, 3, 4])]
)
def test_seeds_are_a_list_or_a_range(text, seeds):
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
