"""A tuner looks the same in every figure; every label that is drawn stands in a whole legend."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex

from tests.analysis.folders import NOMINAL, write_run
from zoac.analysis import curves, landscape, robustness, trajectories
from zoac.analysis.data import plants, replay
from zoac.analysis.data.load import load, read
from zoac.analysis.data.runs import Method, by_method
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import method_labels
from zoac.core.measures import Trace

ROOT = Path(__file__).parents[2]
TUNERS = sorted(path.stem for path in (ROOT / "conf" / "tuner").glob("*.yaml"))


def test_every_tuner_has_a_look_and_no_two_share_colour_dashes_or_marker():
    assert set(TUNERS) <= style.LOOKS.keys()
    for part in ("colour", "dashes", "marker"):
        values = [getattr(look, part) for look in style.LOOKS.values()]
        assert [pair for pair in combinations(values, 2) if pair[0] == pair[1]] == [], part


def test_looks_of_the_shipped_results_are_all_different():
    methods = {run.method for run in load(ROOT / "results").runs}
    assert len(methods) > 10
    for family in ({m for m in methods if m.task.startswith(t)} for t in ("pid", "mpc")):
        looks = style.looks(family)
        labels = method_labels(family)
        one_look = {labels[m]: looks[m] for m in family}
        assert len(set(one_look.values())) == len(one_look)


def test_a_tuner_looks_the_same_whatever_stands_beside_it():
    mine = [Method("t", name, None) for name in ("mine", "other", "third")]
    plus = Method("t", "zoac_plus", None)
    alone = style.looks([plus])[plus]
    assert style.looks([*mine, plus, Method("t_reg", "zoac_plus", None)])[plus] == alone
    assert alone == style.LOOKS["zoac_plus"]
    together = style.looks(mine)
    assert len(set(together.values())) == 3
    assert style.looks(mine[:1])[mine[0]] == together[mine[0]]


def test_the_regularised_cost_and_each_variant_look_different():
    methods = [
        Method(task, tuner, variant)
        for task in ("t", "t_reg")
        for tuner in ("zoac", "zoac_plus", "mine")
        for variant in (None, "authors_code", "a", "b", "c")
    ]
    looks = style.looks(methods)
    assert len(set(looks.values())) == len(methods)
    for task, tuner in {(m.task, m.tuner) for m in methods}:
        same = [looks[m] for m in methods if (m.task, m.tuner) == (task, tuner)]
        assert len({(look.colour, look.marker) for look in same}) == 1


def test_forty_tuners_of_a_user_are_still_told_apart():
    looks = style.looks([Method("t", f"mine{k}", None) for k in range(40)])
    assert len(set(looks.values())) == 40


def test_before_and_after_are_told_apart_in_grey():
    assert style.BEFORE.dashes != style.AFTER.dashes


def test_runs_may_say_what_their_tuner_is_called(tmp_path):
    folder = write_run(tmp_path, "mine")
    file = folder / "run.json"
    file.write_text(
        file.read_text().replace('"tuner": "mine"', '"tuner": "mine", "tuner_name": "M"')
    )
    (panel,) = curves.all_panels(load(tmp_path), metric="cost_mean")
    (label,) = method_labels([c.method for c in panel.curves], panel.names).values()
    assert label == "M"


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """Six tuners, one of them in two variants, and the nominal controller."""
    root = tmp_path_factory.mktemp("runs")
    for k, tuner in enumerate(("zoac", "zoac_plus", "bo", "cmaes", "cmaes_full", "mine")):
        for seed in range(2):
            write_run(root, tuner, seed, costs=[3.0 + k, 4.0 + k + seed])
    write_run(root, "zoac", 0, variant="authors_code", costs=[5.0, 6.0])
    write_run(root, "nominal", costs=[2.0, 3.0], gains=NOMINAL, evaluations=())
    return root


def figures(root):
    collection = load(root)
    for metric in (None, "cost_mean"):
        panels = curves.all_panels(collection, metric=metric)
        yield f"curves {metric}", lambda panels=panels: curves.draw(panels, "env_steps")
    run = read(root / "pid_acc" / "zoac" / "seed=0")
    task = replay.rebuild(run)
    runs = chosen(collection)
    yield "trajectories", lambda: trajectories.draw(task, trajectories.loops_of(task, runs), "")
    loops = trajectories.before_and_after(task, run)
    yield "before and after", lambda: trajectories.draw(task, loops, "")
    seeds = by_method(collection.finished)[Method("pid_acc", "zoac", None)]
    for names in (["k"], ["k", "Kp", "Ki", "Kd"]):
        slices = landscape.sliced(task, run, names, 3, 2)
        yield f"landscape {len(names)}", lambda slices=slices: landscape.draw(seeds, slices)
    varied = plants.vary(run, {"preceding_std": (0.02, 0.2)}, 2, 2)
    around = plants.sensitivity(run, 2)
    yield "robustness", lambda: robustness.draw(varied, around)


def labels_of(figure):
    """Return the labels of everything drawn in the axes of a figure."""
    found = {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}
    return {label for label in found if not label.startswith("_")}


def test_legends_hold_every_label_and_lie_inside(many):
    made = list(figures(many))
    assert len(made) == 7
    for name, draw in made:
        with style.drawing(style.PAPER):
            figure = draw()
            figure.draw_without_rendering()
            legends = [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]
            assert legends, name
            told = {text.get_text() for legend in legends for text in legend.get_texts()}
            assert labels_of(figure) <= told, name
            whole = figure.bbox
            for legend in legends:
                box = legend.get_window_extent()
                inside = (whole.x0 <= box.x0, box.x1 <= whole.x1, whole.y0 <= box.y0,
                          box.y1 <= whole.y1)  # fmt: skip
                assert all(inside), (name, box, whole)


def test_lines_of_the_learning_curves_have_the_looks_of_their_legend(many):
    (panel,) = curves.all_panels(load(many), metric="cost_mean")
    with style.drawing(style.PAPER):
        figure = curves.draw([panel], "env_steps")
    (legend,) = figure.legends
    handles = zip(legend.get_texts(), legend.legend_handles, strict=True)
    colours = {text.get_text(): to_hex(handle.get_color()) for text, handle in handles}
    assert colours["ZOAC"] == to_hex(style.LOOKS["zoac"].colour)
    assert colours["ZOAC+"] == to_hex(style.LOOKS["zoac_plus"].colour)
    assert len(set(colours.values())) == len(colours) - 1  # the variant has its tuner's


def test_many_curves_have_their_interval_at_the_end_instead_of_bands(many):
    (panel,) = curves.all_panels(load(many), metric="cost_mean")
    few = curves.Panel(panel.task, panel.metric, panel.curves[:2])
    with style.drawing(style.PAPER):
        crowded, clear = (curves.draw([p], "env_steps").axes[0] for p in (panel, few))
    assert (len(crowded.containers), len(clear.containers)) == (7, 0)
    assert all(tick <= 1000 for tick in crowded.get_xticks())
    shown = [part.get_segments()[0][:, 1] for bars in crowded.containers for part in bars[2]]
    drawn = sorted((low, high) for low, high in shown)
    ends = sorted((c.low[-1], c.high[-1]) for c in panel.curves if len(c.x) > 1)
    np.testing.assert_allclose(drawn, ends)


def trace(y, label="Time [s]"):
    return Trace("y", 0.1 * np.arange(len(y)), y, label)


def test_a_limit_cycle_is_found_with_its_period():
    time = 0.1 * np.arange(1000)
    cycle = trajectories.limit_cycle([trace(np.sin(2 * np.pi * time / 2.5))])
    assert cycle is not None
    assert (cycle.samples, cycle.period) == (25, "2.5 s")
    decays = np.exp(-time / 10) * np.sin(2 * np.pi * time / 2.5)
    slow = np.sin(2 * np.pi * time / 40)
    noise = np.random.default_rng(0).normal(size=1000)
    for y in (decays, slow, noise, np.convolve(noise, np.ones(9)), np.zeros(1000), np.ones(3)):
        assert trajectories.limit_cycle([trace(y)]) is None
    assert trajectories.limit_cycle([trace(np.sin(time), "Path x [m]")]) is None


def test_a_limit_cycle_is_shaded_over_what_it_swings_between():
    time = 0.1 * np.arange(1000)
    y = 3.0 + np.sin(2 * np.pi * time / 2.5)
    cycle = trajectories.limit_cycle([trace(y)])
    assert cycle is not None
    low, high = trajectories.envelope(trace(y), cycle)
    np.testing.assert_allclose(low, 2.0, atol=0.01)
    np.testing.assert_allclose(high, 4.0, atol=0.01)
