"""A user's code that follows a run: what it is told, and when it stops one."""

import json

import numpy as np
import pytest

import zoac
from tests.run.test_api import tune as tune_briefly
from tests.runs.training.test_trainer import numbers, same_rows
from zoac.core.errors import CallbackError, ConfigError
from zoac.runs import checkpoint


def tune(**options):
    """Iterations of 40 steps."""
    return tune_briefly(**{"tuner": "random", "budget": 600, **options})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that nobody follows."""
    return tune(folder=tmp_path_factory.mktemp("whole"))


class Told(zoac.Callback):
    """Keeps everything that it is told."""

    def __init__(self):
        self.calls = []

    def on_start(self, run):
        self.calls = [("start", run)]

    def on_iteration(self, row):
        self.calls.append(("train", row))

    def on_evaluation(self, row):
        self.calls.append(("eval", row))

    def on_end(self, result):
        self.calls.append(("end", result))


class After(zoac.Callback):
    """Returns False at the k-th call of a method, counted from the start of the run."""

    def __init__(self, count, method="on_iteration"):
        setattr(self, method, self._count)
        self._limit = count

    def on_start(self, run):
        self._left = self._limit

    def _count(self, row):
        self._left -= 1
        return self._left > 0


def test_it_is_told_what_the_folder_holds_in_that_order(tmp_path):
    told = Told()
    result = tune(callbacks=[told], folder=tmp_path)
    (_, run), *rows, (end, written) = told.calls
    assert run["task"] == "Drift"
    # NaN is equal to nothing, so the texts are compared.
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert repr([row for _, row in rows]) == repr(lines)
    assert [kind for kind, _ in rows] == [row["kind"] for row in lines]
    assert rows[-1][1]["final"]
    assert (end, written) == ("end", result.record)


def test_it_changes_no_number_and_no_other_callbacks_row(tmp_path, whole):
    class Vandal(Told):
        def on_iteration(self, row):
            row.clear()
            np.random.seed(0)  # noqa: NPY002

        def on_start(self, run):
            run["config"].clear()

        def on_evaluation(self, row):
            row["parameters"].clear()

        def on_end(self, result):
            result["parameters"].clear()

    followed = tune(folder=tmp_path, callbacks=[Vandal(), told := Told()])
    (_, run), *rows, (_, written) = told.calls
    assert run["config"]
    assert all(row and row.get("parameters", True) for _, row in rows)
    assert written["parameters"] == followed.record["parameters"] == whole.record["parameters"]
    assert followed.parameters == whole.parameters
    assert same_rows(tmp_path, whole.folder)


def test_false_of_numpy_ends_the_run_and_other_answers_do_not():
    def stopped(*answers):
        left = iter(answers)
        follower = type("Follower", (zoac.Callback,), {"on_iteration": lambda *_: next(left)})
        return "stopped_by" in tune(callbacks=[follower()], budget=40 * len(answers)).record

    assert stopped(np.False_, None)
    assert not stopped(None, 0, 0.0, "", [])


@pytest.mark.parametrize("method", ["on_iteration", "on_evaluation"])
def test_false_ends_the_run_with_a_whole_result(method, tmp_path, whole):
    result = tune(folder=tmp_path, callbacks=[After(3, method)])
    assert result.env_steps < whole.env_steps
    assert result.record["stopped_by"] == "After"
    assert "stopped_by" not in whole.record
    assert result.finished
    assert len(result.cost_per_episode) == len(whole.cost_per_episode)
    cut = numbers(tmp_path, "train")
    assert cut == numbers(whole.folder, "train")[: len(cut)]
    if method == "on_iteration":
        assert len(cut) == 3
    else:
        assert [row["final"] for row in numbers(tmp_path, "eval")] == [False] * 3 + [True]


@pytest.mark.parametrize(
    ("iterations", "options"),
    [(4, {}), *((i, {"acceptance_test": 0.3, "baseline": {"k": 0.1}}) for i in (1, 7))],
)
def test_an_interrupted_run_stops_at_the_same_bits(iterations, options, tmp_path, stopping):
    """Interrupted before the callback stops it, or after that, in the acceptance test."""
    whole = tune(folder=tmp_path / "whole", callbacks=[After(5)], **options)
    stopping(iterations)
    parts = {"folder": tmp_path / "parts", **options}
    with pytest.raises(zoac.Interrupted):
        tune(callbacks=[After(5)], **parts)
    stopping(None)
    resumed = tune(callbacks=[told := Told(), After(5)], **parts)
    assert resumed.parameters == whole.parameters
    assert resumed.cost_per_episode == whole.cost_per_episode
    assert same_rows(tmp_path / "parts", tmp_path / "whole")
    # What was there before the interruption is told again.
    again = [kind for kind, _ in told.calls if kind == "train"]
    assert len(again) == len(numbers(tmp_path / "whole", "train"))


def test_an_early_stop_leaves_the_acceptance_test_its_steps(tmp_path):
    """The answer is tested before it is given, with the steps that were reserved and no more."""
    result = tune(
        folder=tmp_path, callbacks=[After(3)], budget=4000,
        acceptance_test=0.25, baseline={"k": 0.1}, select="best_evaluated",
    )  # fmt: skip
    test = result.record["acceptance_test"]
    searched = numbers(tmp_path, "train")[2]["env_steps"]
    assert test["pairs"] == 1000 // (2 * 20)
    assert test["p_value"] is not None
    assert result.env_steps <= searched + 1000 + 600 + 40
    assert result.record["select"]["episodes"] > 0
    assert result.parameters["k"] == 0.1 or test["accepted"]


@pytest.mark.parametrize(("iterations", "selected"), [(2, False), (9, True)])
def test_zoac_plus_stops_in_successive_halving_or_with_its_final_selection(iterations, selected):
    result = tune(callbacks=[After(iterations)], tuner="zoac_plus", budget=2000)
    assert result.env_steps < 1900
    assert (result.record.get("select", {}).get("episodes", 0) > 0) == selected


def test_what_raises_is_named_and_once_mended_the_run_continues_bit_for_bit(tmp_path, whole):
    class Typo(zoac.Callback):
        def on_iteration(self, row):
            if row["iteration"] == 3:
                raise KeyError("cost")

    told = "Typo raised in on_iteration: KeyError: 'cost'; once that is mended, the same call goes"
    with pytest.raises(CallbackError, match=f"{told} on from {tmp_path}") as raised:
        tune(folder=tmp_path, callbacks=[Typo()])
    assert isinstance(raised.value.__cause__, KeyError)
    kept = numbers(tmp_path, "train")
    assert len(kept) == 3
    assert checkpoint.load(tmp_path / "checkpoint")[0]["progress"]["iteration"] == 3
    resumed = tune(folder=tmp_path, callbacks=[])
    assert resumed.parameters == whole.parameters
    assert numbers(tmp_path, "train") == numbers(whole.folder, "train")


def test_what_raises_at_the_end_leaves_the_result(tmp_path):
    class Late(zoac.Callback):
        def on_end(self, result):
            raise OSError("no network")

    with pytest.raises(CallbackError, match="Late raised in on_end: OSError.*result is written"):
        tune(folder=tmp_path, callbacks=[Late()])
    assert zoac.load_result(tmp_path).finished


@pytest.mark.parametrize(
    ("callbacks", "told"),
    [
        ([print], r"callbacks\[0\]=<built-in function print>: expected an instance"),
        ([Told(), Told], r"callbacks\[1\]=.*; give an instance: Told\(\)"),
        (Told(), "expected a list of callbacks"),
    ],
)
def test_what_is_no_callback_is_refused_before_anything_is_written(callbacks, told, tmp_path):
    with pytest.raises(ConfigError, match=told):
        tune(callbacks=callbacks, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_experiments_have_no_callbacks():
    with pytest.raises(ConfigError, match="no option 'callbacks'"):
        zoac.tune(cost=lambda p: p["k"], space={"k": (0, 1)}, callbacks=[Told()])
