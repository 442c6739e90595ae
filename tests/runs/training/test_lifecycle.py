"""A run folder belongs to one run, whatever happens to it."""

import json
import pathlib
import re
import shutil

import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.rollout.executors.test_unpicklable import stopped
from tests.rollout.executors.test_unpicklable import tune as tune_briefly
from tests.run.test_api import tune as tune_small
from zoac.baselines.random_search import RandomSearch
from zoac.core.errors import RunFolderError
from zoac.runs import checkpoint, lock, provenance, schema


def tune(folder, **options):
    return tune_small(folder=folder, **{"tuner": "random", **options})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run that is done, with a checkpoint still there."""
    tune(folder := tmp_path_factory.mktemp("run"))
    checkpoint.save(folder / schema.CHECKPOINTS, {})
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    """A copy of that."""
    return shutil.copytree(finished, tmp_path / "run")


def whose(folder):
    """Tell whether what is left of a run can be told to be its own."""
    left = {path.name for path in folder.iterdir()} & {
        schema.CHECKPOINTS, schema.RESULT, schema.METRICS, schema.TASK
    }  # fmt: skip
    return not left or (folder / schema.RUN).is_file()


@pytest.mark.parametrize("done", range(5))
def test_killed_while_overwriting_what_is_left_can_be_identified(folder, monkeypatch, done):
    steps = iter(range(100))
    remove, unlink = shutil.rmtree, pathlib.Path.unlink

    def die_or(act):
        def step(*arguments, **options):
            if next(steps) == done:
                raise KeyboardInterrupt
            act(*arguments, **options)

        return step

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", die_or(remove))
        patch.setattr(pathlib.Path, "unlink", die_or(unlink))
        with pytest.raises(KeyboardInterrupt):
            tune(folder, budget=600, resume="overwrite")
    assert whose(folder)


def test_a_run_that_is_done_is_returned_without_its_tuner(folder, monkeypatch):
    monkeypatch.delattr("zoac.config.factory.build_tuner")
    assert tune(folder).env_steps == zoac.load_result(folder).env_steps


def test_a_folder_that_another_process_holds_is_refused_by_name(folder):
    with (
        lock.locked(folder / ".lock"),
        pytest.raises(RunFolderError, match="run: another process is running this run$"),
    ):
        tune(folder)


def test_overwriting_leaves_nothing_of_the_run_before(folder):
    result = tune(folder, budget=600, resume="overwrite")
    assert result.env_steps >= 600
    assert result.history["env_steps"].is_monotonic_increasing


@pytest.mark.parametrize("left", [schema.RESULT, schema.CHECKPOINTS])
def test_files_without_a_run_json_are_refused(folder, left):
    for path in folder.iterdir():
        if path.name != left:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(RunFolderError, match="without its run.json: whose it is cannot be told"):
        tune(folder, budget=600)


@pytest.mark.parametrize(
    ("told", "model"),
    [
        ("vendor_id\t: A\nmodel name\t: A Chip: 9\n\nmodel name\t: A Chip: 9\n", "A Chip: 9"),
        ("model name\t:\n", "a word"),
        ("CPU part\t: 0xd0c\n", "a word"),
        (None, "a word"),
    ],
)
def test_the_processors_model_is_on_record_where_the_system_tells_it(told, model, monkeypatch):
    def read(path, *arguments, read=pathlib.Path.read_text, **options):
        if path != pathlib.Path("/proc/cpuinfo"):
            return read(path, *arguments, **options)
        if told is None:
            raise FileNotFoundError(path)
        return told

    monkeypatch.setattr(pathlib.Path, "read_text", read)
    monkeypatch.setattr("platform.processor", lambda: "a word")
    assert provenance.here_and_now()["machine"]["processor"] == model


def test_a_run_that_goes_on_elsewhere_is_told_so(tmp_path, stopping, capsys):
    stopped(stopping, tmp_path, Drift)
    record = json.loads((tmp_path / schema.RUN).read_text())
    record["machine"]["processor"] = "An Older Chip"
    record["versions"] |= {"torch": "0.1", "gonelib": "0.1"}
    (tmp_path / schema.RUN).write_text(json.dumps({**record, "commit": "an older one"}))
    capsys.readouterr()
    tune_briefly(tmp_path, Drift)
    said = capsys.readouterr().err
    for told in ("processor .*, at first An Older Chip", r"torch 2\..*, at first 0\.1",
                 "gonelib None, at first 0.1", "commit .*, at first an older one"):  # fmt: skip
        assert re.search(f"continues under other conditions.*: (.*; )?{told}(;|$)", said.strip())


def test_a_file_system_without_locks_is_not_taken_for_a_lock_that_is_held(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl", reason="locks are made otherwise here")

    def refuse(*arguments):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with (
        pytest.raises(RunFolderError, match="no locks .No locks available.; choose another"),
        lock.locked(tmp_path / ".lock", wait=True),
    ):
        pass


def test_the_tuners_display_name_is_on_record_inside_a_strategy_too(tmp_path):
    tune(tmp_path, tuner="zoac_plus", acceptance_test=0.3, baseline={"k": 0.1})
    assert schema.read_run(tmp_path)["tuner_name"] == "ZOAC+"


def test_a_tuner_without_a_display_name_goes_by_its_configurations(tmp_path, monkeypatch):
    monkeypatch.setattr(RandomSearch, "display_name", "")
    tune(tmp_path)
    assert schema.read_run(tmp_path)["tuner_name"] == "random"
