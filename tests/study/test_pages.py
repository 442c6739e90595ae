"""Figures and reports speak of experiments."""

import warnings

import pytest

import zoac
from zoac.analysis import curves, report
from zoac.analysis.data.load import load


@pytest.fixture
def study(tmp_path):
    """Return the folder of a study with so many experiments."""

    def tuned(experiments):
        zoac.tune(cost=lambda p: (p["k"] - 1.0) ** 2, space={"k": (0.0, 3.0)}, quiet=True,
                  experiments=experiments, tuner="random", folder=tmp_path / "study")  # fmt: skip
        return tmp_path / "study"

    return tuned


def test_a_curve_is_over_experiments(study):
    (panel,) = curves.all_panels(load(study(8)))
    for against, label in (("env_steps", "Experiments"), ("wall_seconds", "Wall")):
        (axes,) = curves.draw([panel], against).axes
        assert axes.get_xlabel().startswith(label)


def test_one_experiment_has_a_report_and_warns_of_nothing(study, tmp_path):
    folder = study(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert report.main([str(folder), "--out", str(tmp_path / "out")]) == 0
    (page,) = (tmp_path / "out").glob("*.html")
    assert "in 1 experiment." in page.read_text()


def test_the_last_lines_speak_of_experiments(capsys):
    space = {"k": {"low": 0, "high": 3, "baseline": 2}}
    print(zoac.tune(cost=lambda p: (p["k"] - 1.0) ** 2, space=space, experiments=3, tuner="random"))
    text = capsys.readouterr().out
    assert "experiment 1 of 3: cost 1\n" in text
    assert " of 3; baseline values: cost 1\n" in text
    assert " over 1 experiment, baseline values 1\n" in text
    assert "  3 experiments, " in text
    assert "episode" not in text
    assert "step" not in text


def test_a_study_that_is_not_finished_is_named_with_the_experiments_that_it_reached(tmp_path):
    study = zoac.Study({"k": (0.0, 3.0)}, tmp_path, experiments=10, tuner="random", workers=3)
    study.tell(study.ask(), 1.0)
    study.tell(study.ask(), failed="tripped")
    study.ask()
    says = "unfinished, 2 of 10 experiments; relaunch resumes it"
    assert [told.partition(": ")[2] for told in load(tmp_path).left_out] == [says]
    (tmp_path / "journal.jsonl").write_text("{}\n")
    (skipped,) = load(tmp_path).left_out
    assert "journal.jsonl: line 1 is damaged" in skipped
