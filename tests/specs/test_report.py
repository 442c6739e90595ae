"""The report has a green or red row per spec, and the response, without loading a user's code."""

import re

import pytest

import zoac
from tests.specs.loops_to_tune import tuned
from zoac.analysis import report
from zoac.analysis.data.load import load
from zoac.runs import schema


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    met = zoac.specs.steady_state_error("y", "r", max=0.2)
    unmet = zoac.specs.settling_time("y", "r", band=0.01, max=0.5)
    tuned(budget=800, specs=[met, unmet], folder=folder / "run")
    return load(folder)


def page_of(runs):
    return report.report(runs, [runs.finished[0].method.task], replay=False)


def test_each_spec_has_a_row_with_values_before_and_after_and_its_colour(runs):
    (run,) = runs.finished
    rows = re.findall(
        r'<tr(?: class="(\w+)")?><td data-label="Requirement">(.*?)</tr>', page_of(runs)
    )
    told = {cells.partition("(")[0]: (css, cells) for css, cells in rows}
    before, after = (f"{run.outcome['specs'][0][key]:.4g}" for key in ("baseline", "value"))
    css, cells = told["steady_state_error"]
    assert css == "met"
    assert re.search(f">≤ 0.2<.*✗</span> {before}<.*✓</span> {after}<", cells)
    css, cells = told["settling_time"]
    assert css == "unmet"
    assert cells.count('<span class="unmet">✗</span> never') == 2
    assert told["peak"][0] == ""


def test_the_response_is_drawn_from_the_folder_alone(runs):
    (run,) = runs.finished
    (run.folder / schema.TASK).unlink()
    assert "<h3>Response</h3>" in page_of(runs)
    (run.folder / schema.RESPONSES).rename(run.folder / "elsewhere")
    assert "<h3>Response</h3>" not in page_of(runs)


def test_names_from_a_folder_cannot_write_html(runs, monkeypatch):
    (run,) = runs.finished
    monkeypatch.setitem(run.outcome["specs"][0], "spec", "<script>alert(1)</script>")
    page = page_of(runs)
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
