import json

import pytest

from tests.analysis.folders import write_run
from zoac.analysis.data.load import load, read
from zoac.core.errors import RunFolderError


def skipped(root):
    return [str(item).replace(f"{root}/", "") for item in load(root).left_out]


def test_identity_comes_from_the_file_not_from_the_folders_name(tmp_path):
    write_run(tmp_path, "zoac", 3).rename(tmp_path / "copied from the cluster")
    (run,) = load(tmp_path).runs
    assert (run.method.task, run.method.tuner, run.seed) == ("pid_acc", "zoac", 3)


def test_a_run_folder_is_itself_a_collection(tmp_path):
    assert len(load(write_run(tmp_path)).runs) == 1


def test_a_variant_below_a_run_is_found_beside_it(tmp_path):
    write_run(tmp_path)
    write_run(tmp_path, variant="wide")
    assert [run.method.variant for run in load(tmp_path).runs] == [None, "wide"]


def test_folders_that_begin_with_a_dot_are_not_looked_into(tmp_path):
    write_run(tmp_path)
    write_run(tmp_path / ".sweeps", "zoac", 7)
    assert [run.seed for run in load(tmp_path).runs] == [0]


def test_an_empty_folder_is_skipped_and_named(tmp_path):
    write_run(tmp_path)
    (tmp_path / "pid_acc" / "zoac" / "seed=1").mkdir()
    assert skipped(tmp_path) == [
        "pid_acc/zoac/seed=1: there is no run.json; not a run folder",
    ]


def test_an_unfinished_run_is_left_out_and_says_how_far_it_got(tmp_path):
    write_run(tmp_path)
    write_run(tmp_path, seed=1, finished=False)
    assert skipped(tmp_path) == [
        "pid_acc/zoac/seed=1: unfinished, 500 of 1000 environment steps; relaunch resumes it"
    ]


def test_a_result_whose_last_metrics_line_was_cut_is_skipped(tmp_path):
    write_run(tmp_path)
    metrics = write_run(tmp_path, seed=1) / "metrics.jsonl"
    metrics.write_text(metrics.read_text()[:-10])
    assert skipped(tmp_path) == [
        "pid_acc/zoac/seed=1: the run is finished, but metrics.jsonl does not end with its "
        "final evaluation; the end of the file is lost"
    ]


def test_a_cut_last_line_of_an_unfinished_run_costs_only_that_line(tmp_path):
    folder = write_run(tmp_path, finished=False)
    metrics = folder / "metrics.jsonl"
    metrics.write_text(metrics.read_text()[:-10])
    assert [row["env_steps"] for row in read(folder).metrics] == [0, 250]


@pytest.mark.parametrize("damaged", ['{"kind": "eva', "5", "{}", "null"])
def test_a_damaged_line_in_the_middle_is_skipped_by_its_number(damaged, tmp_path):
    write_run(tmp_path)
    metrics = write_run(tmp_path, seed=1) / "metrics.jsonl"
    lines = metrics.read_text().split("\n")
    metrics.write_text("\n".join([lines[0], damaged, *lines[2:]]))
    assert skipped(tmp_path) == ["pid_acc/zoac/seed=1: metrics.jsonl: line 2 is damaged"]


def test_a_result_of_another_run_is_not_believed(tmp_path):
    write_run(tmp_path)
    path = write_run(tmp_path, seed=1) / "result.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "seed": 2}))
    assert skipped(tmp_path) == [
        "pid_acc/zoac/seed=1: run.json and result.json disagree on seed: 1 and 2"
    ]


def test_a_record_that_says_too_little_names_what_it_lacks(tmp_path):
    write_run(tmp_path)
    path = write_run(tmp_path, seed=1) / "result.json"
    content = json.loads(path.read_text())
    del content["cost_per_episode"]
    path.write_text(json.dumps(content))
    assert skipped(tmp_path) == [
        "pid_acc/zoac/seed=1: result.json: a record without cost_per_episode; zoac writes all"
    ]


def test_rows_of_another_run_are_left_out(tmp_path):
    write_run(tmp_path)
    folder, other = write_run(tmp_path, seed=1), write_run(tmp_path / "o", costs=(1.0, 2.0))
    (other / "metrics.jsonl").replace(folder / "metrics.jsonl")
    (told,) = [line for line in skipped(tmp_path) if "seed=1" in line]
    assert told == (
        "pid_acc/zoac/seed=1: the final evaluation in metrics.jsonl and result.json disagree on "
        "cost_mean: 1.5 and 4.5"
    )


@pytest.mark.parametrize(
    ("finished", "after"), [(True, "the final evaluation"), (False, "step 500")]
)
def test_rows_of_two_runs_in_one_file_are_left_out(finished, after, tmp_path):
    folder = write_run(tmp_path, finished=finished)
    rows = (folder / "metrics.jsonl").read_text()
    (folder / "metrics.jsonl").write_text(2 * rows)
    line = rows.count("\n") + 1
    with pytest.raises(RunFolderError, match=f"several runs: line {line} .* 0 and follows {after}"):
        read(folder)


def test_runs_of_one_name_on_two_plants_are_refused_by_what_differs(tmp_path):
    write_run(tmp_path / "a", config={"code": {"env": "here.P@1"}})
    write_run(tmp_path / "b", config={"code": {"env": "here.P@2"}})
    with pytest.raises(RunFolderError, match=r"not the same run.*\n  code.env: 'here.P@1' and 'he"):
        load(tmp_path)


def test_the_same_run_twice_is_refused(tmp_path):
    write_run(tmp_path / "a")
    write_run(tmp_path / "b")
    with pytest.raises(RunFolderError, match=r"two folders hold the same run, zoac on pid_acc"):
        load(tmp_path)


def test_no_folder_and_no_run_are_told_apart(tmp_path):
    with pytest.raises(RunFolderError, match=r"no folder '.*nowhere'"):
        load(tmp_path / "nowhere")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "readme.txt").write_text("nothing here")
    with pytest.raises(RunFolderError, match="no readable run below"):
        load(tmp_path)


def test_an_unknown_task_is_answered_with_those_there_are(sweep):
    with pytest.raises(RunFolderError, match=r"no run of task 'pid_ac'; did you mean 'pid_acc'"):
        load(sweep).of_task("pid_ac")


def test_a_file_instead_of_a_folder_is_told(tmp_path):
    file = write_run(tmp_path) / "run.json"
    with pytest.raises(RunFolderError, match=r"run\.json' is a file; expected a run folder"):
        load(file)
