"""Runs in three small files say what the run folders say."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.folders import write_run
from zoac.analysis import beyond, compact, curves, landscape, table2
from zoac.analysis.data.load import load

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    for seed in range(2):
        write_run(root, seed=seed, costs=(3.0 + seed / 3, 4.0, 5.0, 6.1))
        write_run(root, "bo", seed=seed, variant="tuner.noise=0.1", costs=(4.0, 5.0, 6.0, 7.0))
    write_run(root, "nominal", costs=(3.0, 3.0, 3.0, 1 / 3), evaluations=())
    return root


@pytest.fixture
def small(runs, tmp_path):
    assert compact.main([str(runs), "--out", str(tmp_path / "results")]) == 0
    return tmp_path / "results"


def test_results_and_identities_come_back_exactly(runs, small):
    for run, twin in zip(load(runs).runs, load(small).runs, strict=True):
        assert (twin.method, twin.seed) == (run.method, run.seed)
        assert dict(twin.config) == dict(run.config)
        assert np.array_equal(twin.costs, run.costs)
        assert twin.outcome["parameters"] == run.outcome["parameters"]


def test_equal_episodes_are_written_once(runs, small):
    assert "3.0*3 0.3333333333333333" in (small / "runs.csv").read_text()


def test_results_can_be_kept_to_fewer_digits(runs, tmp_path):
    few = tmp_path / "few"
    assert compact.main([str(runs), "--out", str(few), "--digits", "3"]) == 0
    assert "3*3 0.333" in (few / "runs.csv").read_text()
    for run, twin in zip(load(runs).runs, load(few).runs, strict=True):
        np.testing.assert_allclose(twin.costs, run.costs, rtol=2e-3)


def test_a_summary_has_means_only_and_the_table_of_ratios_is_the_same(runs, tmp_path):
    out = tmp_path / "summary"
    assert compact.main([str(runs), "--out", str(out), "--summary"]) == 0
    assert [run.evaluations for run in load(out).runs] == [[]] * 5
    assert "cost_per_episode" not in (out / "runs.csv").read_text()
    for source, tables in ((runs, "a"), (out, "b")):
        assert beyond.main([str(source), "--out", str(tmp_path / tables)]) == 0
    for name in ("beyond.md", "beyond.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.parametrize("command", [table2, curves, landscape, compact])
def test_what_needs_single_episodes_refuses_a_summary(runs, tmp_path, capsys, command):
    out = tmp_path / "summary"
    assert compact.main([str(runs), "--out", str(out), "--summary"]) == 0
    assert command.main([str(out), "--out", str(tmp_path / "x")]) == 1
    assert "only means over the episodes were kept" in capsys.readouterr().err


def test_evaluations_come_back_to_six_digits(runs, small):
    for run, twin in zip(load(runs).runs, load(small).runs, strict=True):
        assert len(twin.evaluations) == (len(run.evaluations) if run.tuned else 0)
        for row, again in zip(run.evaluations, twin.evaluations, strict=False):
            assert again["env_steps"] == row["env_steps"]
            assert again["cost_mean"] == pytest.approx(row["cost_mean"], rel=1e-5)
            assert again["cost_per_episode"] == pytest.approx(row["cost_per_episode"], rel=1e-5)


def test_parameters_while_tuning_come_back_if_asked_for(runs, tmp_path):
    assert compact.main([str(runs), "--out", str(tmp_path / "small"), "--parameters"]) == 0
    for run, twin in zip(load(runs).runs, load(tmp_path / "small").runs, strict=True):
        for row, again in zip(run.evaluations, twin.evaluations, strict=False):
            assert again["parameters"] == pytest.approx(row["parameters"], rel=1e-5)


def test_tables_of_both_are_the_same_bytes(runs, small, tmp_path):
    for source, out in ((runs, "a"), (small, "b")):
        assert table2.main([str(source), "--task", "pid_acc", "--out", str(tmp_path / out)]) == 0
    for name in ("table2.md", "table2.tex", "table2.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_folder_with_a_file_missing_is_refused_and_the_file_named(small, capsys):
    (small / "methods.json").unlink()
    assert table2.main([str(small)]) == 1
    assert "methods.json" in capsys.readouterr().err


def test_one_record_serves_all_seeds_of_a_method(small):
    records = json.loads((small / "methods.json").read_text())
    assert [record["tuner"] for record in records] == ["bo", "nominal", "zoac"]


def test_where_runs_lay_is_not_kept(tmp_path):
    folder = write_run(tmp_path / "runs")
    for name in ("run.json", "result.json"):
        record = json.loads((folder / name).read_text())
        record.setdefault("config", {})["runs_dir"] = str(tmp_path)
        (folder / name).write_text(json.dumps(record))
    assert compact.main([str(tmp_path / "runs"), "--out", str(tmp_path / "kept")]) == 0
    assert str(tmp_path) not in (tmp_path / "kept" / "methods.json").read_text()


def test_a_folder_of_another_format_is_refused_and_named(small, capsys):
    (small / "methods.json").write_text('{"methods": []}')
    assert table2.main([str(small)]) == 1
    assert "write them anew with python -m zoac.analysis.compact" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("cut", "told"),
    [
        (lambda b: b[:-3], "the end of runs.csv is lost"),
        (lambda b: b[: b.rindex(b"pid_acc")] + b"a,b,,1,5,6\n", "has not the columns"),
        (lambda b: b[:-1] + b",7\n", "has not the columns"),
    ],
)
def test_a_file_that_was_cut_off_is_refused_and_named(small, capsys, cut, told):
    path = small / "runs.csv"
    path.write_bytes(cut(path.read_bytes()))
    assert table2.main([str(small), "--task", "pid_acc"]) == 1
    error = capsys.readouterr().err
    assert told in error
    assert "write them anew with python -m zoac.analysis.compact" in error


def test_what_run_json_says_comes_back(runs, small):
    for run, twin in zip(load(runs).runs, load(small).runs, strict=True):
        kept = {k: v for k, v in run.identity.items() if k not in ("command", "started")}
        assert twin.identity == kept


@pytest.mark.parametrize(("every", "kept"), [(1, [0, 500]), (600, [0])])
def test_evaluations_can_be_thinned(runs, tmp_path, every, kept):
    out = tmp_path / "thin"
    assert compact.main([str(runs), "--out", str(out), "--every", str(every)]) == 0
    run = next(run for run in load(out).runs if run.method.tuner == "zoac")
    assert [row["env_steps"] for row in run.evaluations] == kept


@pytest.mark.usefixtures("undrawn")
def test_figures_do_without_what_was_not_kept(small, tmp_path):
    few = ["--task", "pid_acc", "--points", "2", "--episodes", "1", "--format", "svg"]
    assert landscape.main([str(small), *few, "--out", str(tmp_path / "out")]) == 0
    assert load(small).runs[0].start is None


@pytest.mark.parametrize("value", ["speed", "1", "null", "", 'a "b", *2 c', None, True, [8, 8]])
def test_chosen_values_come_back_as_they_were(tmp_path, value):
    write_run(tmp_path / "runs", gains={"better": value, "k": 2.0}, evaluations=())
    assert compact.main([str(tmp_path / "runs"), "--out", str(tmp_path / "small")]) == 0
    (run,) = load(tmp_path / "small").runs
    assert run.outcome["parameters"] == {"better": value, "k": 2.0}


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_numbers_that_are_not_finite_come_back(tmp_path, bad):
    write_run(tmp_path / "runs", evaluations=[(0, bad)], result={"cost_per_episode": [1.0, bad]})
    arguments = [str(tmp_path / "runs"), "--digits", "3", "--out", str(tmp_path / "small")]
    assert compact.main(arguments) == 0
    (run,) = load(tmp_path / "small").runs
    np.testing.assert_array_equal(run.costs, [1.0, bad])
    np.testing.assert_array_equal(run.evaluations[0]["cost_per_episode"], [bad, bad])
    np.testing.assert_array_equal(run.evaluations[0]["cost_mean"], bad)


@pytest.mark.parametrize(("name", "options"), [("", []), ("careful", ["--summary"])])
def test_the_logged_runs_of_this_repository_are_compact_already(tmp_path, name, options):
    assert (
        compact.main([str(RESULTS / name), "--out", str(tmp_path), "--digits", "5", *options]) == 0
    )
    for made in tmp_path.iterdir():
        assert made.read_bytes() == (RESULTS / name / made.name).read_bytes()
