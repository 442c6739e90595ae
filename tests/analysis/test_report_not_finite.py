"""Reports on runs with costs that are not finite."""

import json

import pytest

from tests.analysis.folders import write_run
from zoac.analysis.curves import draw_panel
from zoac.analysis.pages import sweep
from zoac.analysis.report import main


def page(root, out):
    assert main([str(root), "--out", str(out), "--no-replay"]) == 0
    return (out / "report.html").read_text()


def without_costs(folder):
    """Write that no evaluation while tuning had a finite cost, and return the folder."""
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    lost = {"cost_mean": None, "cost_per_episode": [None, None]}
    rows = [{**row, **lost} if row.get("final") is False else row for row in rows]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


@pytest.mark.usefixtures("undrawn")
def test_a_method_without_finite_costs_leaves_the_other_curves_in_view(tmp_path, monkeypatch):
    views = []

    def drawn(axes, *rest):
        draw_panel(axes, *rest)
        views.append(axes.get_ylim())

    monkeypatch.setattr(sweep, "draw_panel", drawn)
    result = {"baseline": {"cost_mean": 5.0, "cost_per_episode": [5.0, 5.0]}}
    for seed in (0, 1):
        without_costs(write_run(tmp_path, "zoac", seed, costs=(2.0, 2.0), result=result))
        write_run(tmp_path, "bo", seed, costs=(0.1, 0.1), result=result)
    page(tmp_path, tmp_path / "out")
    bottom, top = views[0]
    assert bottom == pytest.approx(0.08)
    assert top > 5.0


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_run_without_finite_costs_has_a_page_without_warnings(tmp_path):
    folder = without_costs(write_run(tmp_path, costs=(2.0, 2.0)))
    assert "Learning curve" in page(folder, tmp_path / "out")


@pytest.mark.usefixtures("undrawn")
def test_a_baseline_without_a_finite_cost_is_not_compared_with(tmp_path):
    folder = write_run(tmp_path, costs=(3.0,), result={"cost_std": 0, "baseline_cost_mean": None})
    assert "baseline values" not in page(folder, tmp_path / "out")
