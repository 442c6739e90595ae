"""What is written is JSON to every reader, whatever the numbers."""

import json
import math

import numpy as np
import pytest

import zoac
from zoac.core.errors import ConfigError, RunFolderError
from zoac.runs import schema
from zoac.runs.export import FORMATS, export

RUN = {name: {} for name in schema.OF_EVERY_RUN} | {
    "format": schema.FORMAT, "task": "t", "tuner": "u", "seed": 0, "variant": None,
    "config_hash": "c",
}  # fmt: skip
RESULT = {
    **{key: RUN[key] for key in ("format", *schema.IDENTITY)}, "env_steps": 5, "wall_seconds": 1.0,
    "cost_mean": 1.0, "cost_per_episode": [1.0], "parameters": {"k": 1.0}, "warnings": [],
}  # fmt: skip


def write(folder, result):
    schema.write_json(folder / schema.RUN, RUN)
    schema.write_json(folder / schema.RESULT, result)


BAD = [math.nan, math.inf, -math.inf]


def strict(text):
    """Parse JSON as the standard has it."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize("bad", BAD)
def test_what_is_not_finite_is_null(bad):
    content = {
        "number": bad,
        "numpy": np.float64(bad),
        "small": np.float32(bad),
        "array": np.array([[1.0, bad]]),
        "nested": {"pair": (bad, 2), "list": [{"x": bad}]},
    }
    written = strict(schema.json_line(content))
    assert written == {
        "number": None,
        "numpy": None,
        "small": None,
        "array": [[1.0, None]],
        "nested": {"pair": [None, 2], "list": [{"x": None}]},
    }


def test_all_else_is_written_as_it_is():
    content = {"a": 0.1, "b": [1, True, "x", None], "c": np.int64(3), "d": np.array([1.5])}
    assert strict(schema.json_line(content)) == {
        "a": 0.1, "b": [1, True, "x", None], "c": 3, "d": [1.5],
    }  # fmt: skip


@pytest.mark.parametrize("key", schema.OF_EVERY_RUN)
def test_a_run_json_without_one_of_its_keys_is_refused_by_that(tmp_path, key):
    run = {name: {} for name in schema.OF_EVERY_RUN if name != key}
    schema.write_json(tmp_path / schema.RUN, {"format": schema.FORMAT, **run})
    with pytest.raises(RunFolderError, match=rf"run\.json: a record without {key};"):
        schema.read_run(tmp_path)


def test_costs_that_are_null_are_read_as_nan(tmp_path):
    row = {"kind": "eval", "cost_mean": math.inf, "cost_per_episode": [1.0, math.inf]}
    (tmp_path / schema.METRICS).write_text(schema.json_line(row))
    result = {**RESULT, **row}
    write(tmp_path, result)
    strict((tmp_path / schema.RESULT).read_text())
    for read in (schema.read_metrics(tmp_path)[0], schema.read_result(tmp_path)):
        assert math.isnan(read["cost_mean"])
        np.testing.assert_array_equal(read["cost_per_episode"], [1.0, math.nan])
    assert schema.read_result(tmp_path)["variant"] is None


@pytest.mark.parametrize("key", schema.OF_EVERY_RESULT)
def test_a_result_without_one_of_its_keys_is_refused_by_that(tmp_path, key):
    write(tmp_path, RESULT)
    assert schema.read_result(tmp_path) == RESULT
    write(tmp_path, {name: value for name, value in RESULT.items() if name != key})
    with pytest.raises(RunFolderError, match=rf"result\.json: a record without {key};"):
        schema.read_result(tmp_path)


@pytest.mark.parametrize("key", schema.IDENTITY)
def test_a_result_of_another_run_is_refused_by_what_differs(tmp_path, key):
    write(tmp_path, {**RESULT, key: "other"})
    told = f"run.json and result.json disagree on {key}: {RUN[key]!r} and 'other'"
    with pytest.raises(RunFolderError, match=told):
        zoac.load_result(tmp_path)


@pytest.mark.parametrize("bad", [*BAD, np.float32(np.nan), np.float64(np.inf)])
@pytest.mark.parametrize("suffix", FORMATS)
def test_no_export_holds_what_is_not_finite(tmp_path, suffix, bad):
    path = tmp_path / f"gains{suffix}"
    with pytest.raises(ConfigError, match=r"parameter 'kd' is (nan|-?inf), expected a finite"):
        export({"kp": 1.0, "kd": bad}, path, {})
    assert not path.exists()
