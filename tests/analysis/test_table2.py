import io
import json

import pandas as pd
import pytest

from tests.analysis.folders import NOMINAL, write_run
from zoac.analysis.data.load import load
from zoac.analysis.pages.formatting import estimate, number, plus_minus
from zoac.analysis.statistics.comparison import compare
from zoac.analysis.statistics.intervals import UNKNOWN, Interval, MeanStd
from zoac.analysis.table2 import TABLE2, csv, latex, main, main_cells, markdown


def table(root, **options):
    return markdown(compare(load(root), "pid_acc", **options))


def row(text, method):
    (line, *_) = [line for line in text.split("\n") if line.startswith(f"| {method} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def mpc(root):
    for seed in range(5):
        write_run(root, "zoac", seed, task="mpc_tracking", costs=(40.0 + seed, 42.0))
        write_run(root, "zoac", seed, task="mpc_tracking_reg", costs=(39.0, 41.0 + seed))
    write_run(root, "nominal", task="mpc_tracking", costs=(38.0, 39.0))
    return root


def test_a_row_is_mean_and_sample_deviation_over_seeds(sweep):
    # Seeds at 7.5, 7.6, ..., 7.9: mean 7.7, variance 0.1 / 4.
    assert row(table(sweep), "BO")[:3] == ["BO", "5", "7.70 ± 0.16"]


def test_what_a_tuner_chose_is_told_if_all_its_seeds_chose_it(tmp_path):
    for seed, mean_std in ((0, 0.1), (1, 0.2)):
        folder = write_run(tmp_path, "cmaes", seed)
        content = json.loads((folder / "run.json").read_text())
        content["tuner_choices"] = {"population": 11, "mean_std": mean_std}
        (folder / "run.json").write_text(json.dumps(content))
    assert "- CMA-ES: population 11\n" in table(tmp_path)


def test_ours_stands_beside_the_papers(tmp_path):
    text = markdown(compare(load(mpc(tmp_path)), "mpc_tracking", expected=TABLE2))
    assert row(text, "ZOAC")[3] == "41.7 ± 3.8"
    assert row(text, "ZOAC (w/ reg)")[5] == "(9.6 ± 4.5)e-5"
    assert row(text, "CMA-ES")[-1] == "(2.6 ± 0.1)e4"
    assert row(text, "Nominal")[3] == "37.16"


def test_methods_of_table_2_without_a_run_are_named(tmp_path):
    notes = compare(load(mpc(tmp_path)), "mpc_tracking", expected=TABLE2).notes
    assert "BO: 0 of 5 seeds; missing: 0, 1, 2, 3, 4" in notes
    assert "CMA-ES: 0 of 5 seeds; missing: 0, 1, 2, 3, 4" in notes


def test_a_missing_seed_is_named_and_its_row_says_so(sweep):
    (sweep / "pid_acc" / "bo" / "seed=2" / "result.json").unlink()
    text = table(sweep)
    assert row(text, "BO")[1] == "4 of 5"
    assert "- BO: 4 of 5 seeds; missing: 2" in text
    assert "seed=2: unfinished, 1000 of 1000 environment steps" in text


def test_a_seed_that_no_method_has_is_missed_when_asked_for(sweep):
    notes = compare(load(sweep), "pid_acc", seeds=range(6)).notes
    assert "ZOAC: 5 of 6 seeds; missing: 5" in notes


def test_seeds_that_were_not_asked_for_do_not_count(sweep):
    (zoac, *_) = compare(load(sweep), "pid_acc", seeds=[0, 1]).summaries
    assert zoac.seeds == (0, 1)
    assert zoac.missing == ()


def test_seeds_that_nobody_has_are_refused_with_those_there_are(tmp_path, capsys):
    for seed in (0, 3):
        write_run(tmp_path, "zoac", seed)
    assert main([str(tmp_path), "--seeds", "7"]) == 1
    told = "no finished run of task 'pid_acc' with these seeds; there are 0, 3"
    assert told in capsys.readouterr().err


def test_a_cost_that_is_not_a_number_is_named_and_nothing_is_averaged(sweep):
    for name in ("result.json", "metrics.jsonl"):
        path = sweep / "pid_acc" / "bo" / "seed=3" / name
        path.write_text(path.read_text().replace("6.3", "NaN", 1))
    text = table(sweep)
    assert "- BO: the cost of seed 3 is not finite; nothing is averaged" in text
    assert row(text, "BO")[2] == "--"
    assert "BO -" not in text


def test_variants_that_do_not_compare_are_offered_as_a_choice(sweep, tmp_path, capsys):
    write_run(sweep, "zoac", 0, variant="short", config={"budget": 500})
    command = [str(sweep), "--task", "pid_acc", "--out", str(tmp_path)]
    assert main(command) == 1
    assert "choose with --variant: none, short" in capsys.readouterr().err
    assert main([*command, "--variant", "short"]) == 0
    assert main([*command, "--variant", "none"]) == 0
    assert "5 seeds" in capsys.readouterr().out
    assert main([*command, "--variant", "shorter"]) == 1
    assert "no run of variant 'shorter'; did you mean 'short'?" in capsys.readouterr().err


def test_an_unknown_task_is_one_message(sweep, tmp_path, capsys):
    assert main([str(sweep), "--task", "mpc_tracking", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "error: no run of task 'mpc_tracking'; known: pid_acc\n"


def test_claims_follow_the_intervals(sweep):
    text = table(sweep)
    (clear,) = [line for line in text.split("\n") if line.startswith("- ZOAC - BO")]
    assert "ZOAC costs less on average; P(ZOAC better) = 1.00 [0." in clear
    assert clear.endswith("ZOAC is the better more often")
    (luck,) = [line for line in text.split("\n") if line.startswith("- BO - CMA-ES")]
    # One seed of five failed: neither the means nor the seeds tell the two apart.
    assert luck.count("no claim") == 2


def test_the_table_and_the_claims_tell_the_same_difference_to_nominal(sweep):
    comparison = compare(load(sweep), "pid_acc")
    told = {c.first: c.difference for c in comparison.claims if c.second == "Nominal"}
    assert len(told) == 3
    for summary in comparison.summaries:
        assert summary.intervals["minus_nominal"] == told.get(summary.label, UNKNOWN)


def test_minus_nominal_is_against_the_tuner_of_that_name(sweep):
    found = {
        s.label: s.intervals["minus_nominal"] for s in compare(load(sweep), "pid_acc").summaries
    }
    # A tuner of a user's own that took no step either, and sorts before.
    folder = write_run(sweep, "asis", 0, costs=(90.0,) * 4, evaluations=())
    for file in ("metrics.jsonl", "result.json"):
        text = (folder / file).read_text()
        assert '"env_steps": 1000' in text
        (folder / file).write_text(text.replace('"env_steps": 1000', '"env_steps": 0'))
    for summary in compare(load(sweep), "pid_acc").summaries:
        if summary.label in found:
            assert summary.intervals["minus_nominal"] == found[summary.label]


def test_four_seeds_carry_no_claim(sweep):
    text = table(sweep, seeds=range(4))
    assert "ZOAC - BO = -3.12: no claim, fewer than 5 seeds" in text


def test_seeds_of_an_untuned_controller_do_not_scatter(sweep):
    write_run(sweep, "nominal", 1, costs=(2.5, 3.5, 4.5, 5.5), gains=NOMINAL, evaluations=())
    assert row(table(sweep), "Nominal")[1:3] == ["2", "4.00"]


def test_csv_keeps_ten_digits(sweep):
    comparison = compare(load(sweep), "pid_acc")
    frame = pd.read_csv(io.StringIO(csv(comparison)))
    for summary, (_, line) in zip(comparison.summaries[:3], frame.iterrows(), strict=False):
        cost = summary.intervals["cost"]
        expected = cost.estimate, cost.low
        assert (line["cost"], line["cost_low"]) == pytest.approx(expected, rel=1e-9)


def test_latex_has_a_cell_for_every_column(tmp_path):
    text = latex(compare(load(mpc(tmp_path)), "mpc_tracking", expected=TABLE2))
    columns = text.split(r"\begin{tabular}{")[1].split("}")[0]
    rows = [line for line in text.split("\n") if line.endswith(r"\\")]
    assert len(rows) == 6
    assert {line.count("&") for line in rows} == {len(columns) - 1}
    assert "±" not in "".join(rows)


def test_at_a_smaller_budget_a_run_counts_as_it_stood_then(sweep):
    comparison = compare(load(sweep), "pid_acc", budget=499)
    zoac, nominal = comparison.summaries[0], comparison.summaries[-1]
    mean_std, cost = zoac.means["cost"], nominal.intervals["cost"]
    assert mean_std.mean == 50.0
    # Two episodes then; the nominal controller's first two are the same ones.
    assert comparison.episodes == 2
    assert cost.estimate == pytest.approx(3.0)


def test_times_of_different_machines_are_flagged(sweep):
    path = sweep / "pid_acc" / "bo" / "seed=1" / "run.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "machine": {"cores": 64}}))
    assert (
        "times come from 2 different machines and do not compare"
        in compare(load(sweep), "pid_acc").notes
    )


@pytest.mark.parametrize(
    ("mean_std", "shown"),
    [
        (MeanStd(41.72, 3.84), "41.7 ± 3.8"),
        (MeanStd(2.94e-4, 1.36e-4), "(2.9 ± 1.4)e-4"),
        (MeanStd(2.66e4, 1.2e3), "(2.7 ± 0.1)e4"),
        (MeanStd(9.96e-3, 1e-3), "(1.0 ± 0.1)e-2"),
        (MeanStd(1.976, 0.0213), "1.98 ± 0.02"),
        (MeanStd(37.16, float("nan")), "37.16"),
        (MeanStd(), "--"),
    ],
)
def test_numbers_read_as_the_paper_prints_them(mean_std, shown):
    assert plus_minus(mean_std) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.00996, "+1.0e-2"), (9.97e6, "+1.0e7"), (-2.34e-5, "-2.3e-5"), (999.4, "+999.4")],
)
def test_an_exponent_is_that_of_the_rounded_number(value, shown):
    assert number(value, sign=True) == shown


@pytest.mark.parametrize(
    ("interval", "shown"),
    [
        (Interval(-6.7, -24.58, -0.063), "-6.70 [-24.58, -0.06]"),
        (Interval(0.0213, 0.019, 0.0241), "+0.0213 [+0.0190, +0.0241]"),
        (Interval(2.0, float("nan"), float("nan")), "+2.00"),
        (Interval(3.05e-8, 3.01e-8, 3.09e-8), "+3.050e-8 [+3.010e-8, +3.090e-8]"),
        (Interval(-1e-8, -1.2e-8, 3e-9), "-1.0e-8 [-1.2e-8, +0.3e-8]"),
        (Interval(3e-8, 3e-8, 3e-8), "+3.0e-8 [+3.0e-8, +3.0e-8]"),
        (Interval(2.0, 1.99999997, 2.00000003), "+2.000000000 [+1.999999970, +2.000000030]"),
        (Interval(0.0, 0.0, 0.0), "+0.00 [+0.00, +0.00]"),
    ],
)
def test_bounds_can_be_told_apart(interval, shown):
    assert estimate(interval, sign=True) == shown


def test_violations_are_told_as_a_fraction_where_a_task_has_constraints(tmp_path):
    for seed, count in enumerate((0, 2, 4)):
        counted = {"violations": count, "violations_by_constraint": {}}
        write_run(tmp_path, "zoac", seed, result=counted)
    (header, row) = main_cells(compare(load(tmp_path), "pid_acc"))
    assert row[header.index("Share of episodes in violation")] == "0.50 ± 0.50"
    assert "violations_mean" in csv(compare(load(tmp_path), "pid_acc"))


def test_fractions_in_violation_compare_between_evaluations_of_different_length(tmp_path):
    metrics = write_run(tmp_path, "zoac", result={"violations": 4}) / "metrics.jsonl"
    metrics.write_text(
        metrics.read_text().replace('"final": false', '"final": false, "violations": 1')
    )
    write_run(tmp_path, "nominal", evaluations=(), result={"violations": 2})
    comparison = compare(load(tmp_path), "pid_acc", budget=500)
    shares = [v.mean for s in comparison.summaries if (v := s.means["violations"])]
    assert shares == [0.5, 0.5]  # one episode of two, two of four
    (note,) = [note for note in comparison.notes if "violation" in note]
    assert "all episodes of each evaluation, 2 to 4" in note


def test_the_only_task_needs_no_name(sweep, tmp_path, capsys):
    assert main([str(sweep), "--out", str(tmp_path / "out")]) == 0
    assert "comparison on PID-ACC" in capsys.readouterr().out
    write_run(sweep, task="lqr")
    assert main([str(sweep), "--out", str(tmp_path / "out")]) == 1
    told = "error: runs of several tasks; choose with --task: lqr, pid_acc\n"
    assert capsys.readouterr().err.endswith(told)
    write_run(sweep, task="mpc_tracking")
    assert main([str(sweep), "--out", str(tmp_path / "out")]) == 0
    assert "Table II" in capsys.readouterr().out
