import numpy as np
import pytest

from tests.analysis.folders import write_run
from zoac.analysis.curves import all_panels, main, series
from zoac.analysis.data.load import load, read
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import method_labels
from zoac.core.errors import ConfigError


def curve(root, tuner, metric=None, against="env_steps"):
    (panel,) = all_panels(load(root), task="pid_acc", metric=metric, against=against)
    (found,) = [c for c in panel.curves if c.method.tuner == tuner]
    return found


def test_a_curve_is_the_mean_over_seeds(tmp_path):
    write_run(tmp_path, seed=0, evaluations=[(0, 10.0), (500, 4.0)], costs=(2.0, 2.0))
    write_run(tmp_path, seed=1, evaluations=[(0, 20.0), (500, 8.0)], costs=(4.0, 4.0))
    found = curve(tmp_path, "zoac", "cost_mean")
    assert found.x.tolist() == [0, 500, 1000]
    np.testing.assert_allclose(found.centre, [15.0, 6.0, 3.0])


def test_between_its_evaluations_a_seed_stands_where_it_was(tmp_path):
    write_run(tmp_path, seed=0, evaluations=[(0, 10.0), (400, 4.0)])
    write_run(tmp_path, seed=1, evaluations=[(0, 10.0), (600, 8.0)])
    found = curve(tmp_path, "zoac", "cost_mean")
    assert found.centre[found.x == 400] == (4.0 + 10.0) / 2


def test_few_seeds_show_their_range(tmp_path):
    for seed, cost in enumerate((10.0, 20.0, 60.0)):
        write_run(tmp_path, seed=seed, evaluations=[(0, cost)])
    found = curve(tmp_path, "zoac", "cost_mean")
    assert (found.low[0], found.high[0]) == (10.0, 60.0)


def test_all_points_of_a_panel_use_the_same_episodes(tmp_path):
    folder = write_run(tmp_path, costs=(2.0, 4.0, 100.0, 100.0))
    _, costs = series(read(folder), "cost_mean", "env_steps", episodes=2)
    assert costs[-1] == 3.0
    write_run(tmp_path, "nominal", costs=(1.0, 3.0, 100.0, 100.0), evaluations=())
    assert curve(tmp_path, "nominal", "cost_mean").centre.tolist() == [2.0]


def test_a_tuners_own_number_of_the_same_name_is_another_one(tmp_path):
    metrics = write_run(tmp_path) / "metrics.jsonl"
    metrics.write_text(metrics.read_text().replace('"iteration": 1', '"cost_mean": 1e9'))
    assert curve(tmp_path, "zoac", "cost_mean").x.tolist() == [0, 500, 1000]


def test_a_curve_ends_where_its_shortest_seed_ends(tmp_path):
    write_run(tmp_path, seed=0)
    write_run(tmp_path, seed=1, result={"env_steps": 800})
    assert curve(tmp_path, "zoac", "cost_mean").x[-1] == 800


def test_any_logged_number_can_be_shown_against_time(sweep):
    assert curve(sweep, "bo", "prediction_error", "wall_seconds").centre[0] == 2e-4


def test_an_unknown_metric_is_answered_with_what_was_logged(sweep):
    with pytest.raises(ConfigError, match="'cost_meen'; did you mean 'cost_mean'"):
        all_panels(load(sweep), metric="cost_meen")


def test_a_metric_that_no_method_logged_in_all_seeds_is_refused_with_a_seed(tmp_path, capsys):
    for tuner in ("zoac", "bo"):
        write_run(tmp_path, tuner, 0, result={"extra": 1.0})
        write_run(tmp_path, tuner, 1)
    assert main([str(tmp_path), "--metric", "extra"]) == 1
    told = "no method has a curve in all of its seeds: bo on pid_acc: seed 1 logged no 'extra'"
    assert told in capsys.readouterr().err


def test_a_method_that_lacks_the_metric_in_a_seed_is_left_out_with_a_word(tmp_path, capsys):
    write_run(tmp_path, "zoac", 0, result={"extra": 1.0})
    write_run(tmp_path, "bo", 0, result={"extra": 1.0})
    write_run(tmp_path, "bo", 1)
    (panel,) = all_panels(load(tmp_path), metric="extra")
    assert [curve.method.tuner for curve in panel.curves] == ["zoac"]
    told = "left out bo on pid_acc: seed 1 logged no 'extra' against env_steps\n"
    assert capsys.readouterr().err.endswith(told)


def test_the_same_runs_give_the_same_pictures(sweep, tmp_path):
    for out in ("a", "b"):
        assert main([str(sweep), "--metric", "cost_mean", "--out", str(tmp_path / out)]) == 0
    for kind in ("svg", "pdf", "png"):
        one, other = (tmp_path / out / f"curves.{kind}" for out in ("a", "b"))
        assert one.read_bytes() == other.read_bytes()


def test_an_unknown_format_is_refused(sweep, capsys):
    with pytest.raises(SystemExit):
        main([str(sweep), "--format", "gif"])
    assert "unknown format 'gif'; known: pdf, png, svg" in capsys.readouterr().err


def test_the_authors_cost_stands_beside_the_papers_and_their_code_has_lines_of_its_own(tmp_path):
    for task in ("pid_acc_code", "mpc_tracking", "pid_acc"):
        write_run(tmp_path, task=task)
    write_run(tmp_path, task="mpc_tracking", variant="authors_code")
    panels = all_panels(load(tmp_path), metric="cost_mean")
    assert [panel.task for panel in panels] == ["pid_acc", "pid_acc_code", "mpc_tracking"]
    methods = [curve.method for curve in panels[-1].curves]
    text, code = style.looks(methods).values()
    assert (text.colour, text.marker) == (code.colour, code.marker)
    assert text.dashes != code.dashes
    assert list(method_labels(methods).values()) == ["ZOAC", "ZOAC (authors' code)"]
