"""A result in a few lines and as a small table."""

import numpy as np
import pytest

from tests.run.test_api import tune
from zoac.runs.loggers.summary import cost_lines

INTERVAL = "± is a 95% interval"


def told(after, before=None):
    baseline = None if before is None else {"cost_per_episode": before}
    return list(cost_lines({"cost_per_episode": after, "baseline": baseline}))


def test_the_difference_is_that_of_the_same_episodes():
    """Costs that vary by 100 between episodes, and differ by 1 in each."""
    before = [100.0, 200.0, 300.0]
    first, second = told([99.0, 199.0, 299.5], before)
    half = 1.96 * np.std([1.0, 1.0, 0.5], ddof=1) / np.sqrt(3)
    assert first.startswith("cost 199.2 ± 113, baseline values 200 ± 113 on the same 3 episodes")
    assert second == f"better than the baseline values by 0.8333 ± {half:.2g} (0%, {INTERVAL})"


@pytest.mark.parametrize(
    ("after", "before", "lines"),
    [
        ([4.0, 4.0], [2.0, 2.0], "worse than the baseline values by 2 (100%)"),
        (
            [1.0, 4.0],
            [2.0, 2.0],
            "no clear difference from the baseline values: higher by 0.5 ",
        ),
        ([90.0, 90.0], [2.0, 2.0], "worse than the baseline values by 88"),
        ([2.0, 2.0], [2.0, 2.0], ""),
        ([None, 2.0], [2.0, 2.0], ""),
    ],
)
def test_a_difference_is_claimed_only_where_there_is_one(after, before, lines):
    _, *more = told(after, before)
    assert "".join(more).startswith(lines)
    assert bool(more) == bool(lines)


def test_without_a_baseline_only_the_cost_is_told():
    assert told([1.0, 3.0]) == ["cost 2 ± 2 on 2 episodes"]


def test_rounding_is_no_interval():
    assert told([0.1 + 0.2, 0.3], [3.0, 3.0]) == [
        "cost 0.3, baseline values 3 on the same 2 episodes",
        "better than the baseline values by 2.7 (90%)",
    ]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return tune(
        folder=tmp_path_factory.mktemp("run"), tuner="random", baseline={"k": 0.5},
        space={"k": (0, 2), "<b>": 3.0}, controller=lambda p, obs: -p["k"] * obs[0],
    )  # fmt: skip


def test_a_notebook_shows_a_small_table(result):
    table = result._repr_html_()
    assert table.startswith("<table>")
    assert f"<td>k</td><td>0.5</td><td>{result.parameters['k']:.6g}</td>" in table
    assert "<td>cost</td>" in table
    assert "fixed: &lt;b&gt; = 3" in table


def test_the_history_draws_the_learning_curve(result):
    rows = result.history
    evaluations = rows[rows["kind"] == "eval"]
    (line,) = result.history.plot().lines
    np.testing.assert_array_equal(line.get_xdata(), evaluations["env_steps"])
    np.testing.assert_array_equal(line.get_ydata(), evaluations["cost_mean"])
    assert len(rows.plot(x="env_steps", y="wall_seconds").lines) == 1
    assert len(rows.plot.line(x="env_steps", y="wall_seconds").lines) == 1
    assert rows.index.tolist() == rows["env_steps"].tolist()
