import json
import shutil
import time
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from tests.algorithm.support import grouped
from tests.algorithm.test_zoac import OPTIONS
from tests.support import CountingTask
from zoac.algorithm.zoac import Zoac
from zoac.config.settings import Evaluation, Settings
from zoac.core.errors import RunFolderError
from zoac.core.tuner import Problem
from zoac.rollout.executors.base import Serial
from zoac.rollout.executors.process import Process
from zoac.runs import checkpoint
from zoac.runs.log import RunLog
from zoac.runs.schema import read_metrics
from zoac.runs.training import progress
from zoac.runs.training.trainer import Interrupted, Trainer

RUN = {"format": 1, "task": "t", "tuner": "x", "seed": 0, "variant": None, "config_hash": "0"}


def train(
    folder, executor=None, stop=lambda: False, tuner=Zoac, ends_after=None, make_log=RunLog,
    **settings,
):  # fmt: skip
    settings = Settings(**{"budget": 200, "num_envs": 3, "eval_every": 50,
                           "evaluation": Evaluation(2, 3), **settings})  # fmt: skip
    task = CountingTask(7, ends_after)
    problem = Problem(task.space, 3, settings.num_envs, settings.budget, 7, settings.seed)
    executor = executor or Serial()
    executor.start(task, settings.num_envs, settings.seed)
    folder.mkdir(exist_ok=True)
    log = make_log(folder, RUN)
    try:
        return Trainer(
            task, tuner(problem, **grouped(**OPTIONS)), executor, settings, log, stop
        ).run()
    finally:
        executor.close()
        log.close()


def stopped(folder, after, **options):
    """Train, and stop at the end of the iteration of this number, counted from 0."""
    calls = iter(range(1000))
    with pytest.raises(Interrupted):
        train(folder, stop=lambda: next(calls) == after, **options)


def numbers(folder, kind):
    """The rows of one kind without what depends on the clock."""
    rows = [r for r in read_metrics(folder) if r["kind"] == kind]
    return [{k: v for k, v in row.items() if not k.endswith("_seconds")} for row in rows]


def same_rows(one, other):
    """Tell whether two folders have the same numbers."""
    return all(numbers(one, kind) == numbers(other, kind) for kind in ("train", "eval"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that nothing disturbs: its folder and its result."""
    folder = tmp_path_factory.mktemp("whole")
    return SimpleNamespace(folder=folder, result=train(folder))


def test_budget_is_exceeded_by_less_than_one_batch(whole):
    batch = 3 * 2 * 3  # environments, segments, steps
    assert 200 <= whole.result["env_steps"] < 200 + batch


def test_evaluation_happens_at_the_start_every_so_often_and_at_the_end(whole):
    rows = numbers(whole.folder, "eval")
    steps = [row["env_steps"] for row in rows]
    assert steps[0] == 0
    assert [s // 50 for s in steps] == [0, 1, 2, 3, 4]
    assert [row["final"] for row in rows] == [False] * 4 + [True]
    assert [len(row["cost_per_episode"]) for row in rows] == [2, 2, 2, 2, 3]


def test_evaluation_does_not_change_the_tuning(tmp_path, whole):
    assert train(tmp_path, eval_every=10)["x"] == whole.result["x"]


def test_evaluation_episodes_do_not_depend_on_the_runs_seed(tmp_path):
    """With the same action everywhere, costs differ by the episodes' random numbers alone."""
    spreads = []
    for seed in (0, 1):
        train(tmp_path / str(seed), seed=seed)
        costs = np.array(numbers(tmp_path / str(seed), "eval")[0]["cost_per_episode"])
        spreads.append(costs[0] - costs[1])
    assert spreads[0] == pytest.approx(spreads[1])


def test_seed_twins_are_equal_to_the_last_bit(tmp_path, whole):
    assert train(tmp_path / "twin")["x"] == whole.result["x"]
    assert same_rows(tmp_path / "twin", whole.folder)
    assert train(tmp_path / "other", seed=1)["x"] != whole.result["x"]


@pytest.mark.parametrize("stop_after", [1, 4])
def test_a_stopped_run_continues_bit_for_bit(tmp_path, stop_after, whole):
    stopped(tmp_path, stop_after)
    assert train(tmp_path)["x"] == whole.result["x"]
    assert same_rows(tmp_path, whole.folder)


class _Renamed(Zoac):
    def restore(self, state):
        raise KeyError("what an older version called otherwise")


@pytest.fixture(scope="module")
def after_three(tmp_path_factory):
    """The folder of a run that was stopped after three iterations."""
    stopped(folder := tmp_path_factory.mktemp("stopped"), 2)
    return folder


@pytest.fixture
def folder(after_three, tmp_path):
    """A copy of that."""
    return shutil.copytree(after_three, tmp_path / "run")


def test_a_tuners_state_that_does_not_fit_is_refused(folder):
    with pytest.raises(RunFolderError, match="tuner's state.*KeyError.*resume=overwrite"):
        train(folder, tuner=_Renamed)


FOREIGN = [
    (lambda s: s["progress"].update(rounds=3), "the progress in the checkpoint.*unknown: 'rounds'"),
    (lambda s: s["progress"].pop("env_steps"), "the progress in the .*missing: 'env_steps'"),
    (lambda s: s.update(progress=3), "the progress in the checkpoint.*missing: 'checkpoint_sec"),
    (lambda s: s["tuner"].update(momentum=0.9), "the tuner's state.*unknown: 'momentum'"),
    (lambda s: s["tuner"].pop("_adam"), "the tuner's state.*missing: '_adam'"),
    (lambda s: s["tuner"]["_critic"].pop("adam"), "the tuner's state.*KeyError: 'adam'"),
    (lambda s: s.pop("constraints"), "the checkpoint: .*missing: 'constraints'"),
    (lambda s: s.update(sequel=1), "the checkpoint: .*unknown: 'sequel'"),
    (lambda s: s.update(constraints={}), "the constraints' state.*missing: .*'totals'"),
    (lambda s: s["num_envs"].pop(1), "the environments' state.*KeyError: 1"),
    (lambda s: s["num_envs"][0]["memory"].update(x=0.0), "the environments' state.*KeyError: 'x'"),
]


@pytest.mark.parametrize(("change", "told"), FOREIGN)
def test_a_checkpoint_with_other_keys_is_refused_and_the_keys_are_named(folder, change, told):
    state, _ = checkpoint.load(folder / "checkpoint")
    change(state)
    checkpoint.save(folder / "checkpoint", state)
    with pytest.raises(RunFolderError, match=f"{told}.*resume=overwrite"):
        train(folder)


def test_rows_after_the_last_checkpoint_are_not_doubled(folder, whole):
    with open(folder / "metrics.jsonl", "a") as file:
        file.write('{"kind": "train", "env_steps": 9')  # what a kill leaves behind
    train(folder)
    assert numbers(folder, "train") == numbers(whole.folder, "train")


def test_a_logger_that_fails_does_not_end_the_run(tmp_path, capsys):
    class Broken:
        def start(self, run):
            raise RuntimeError("no network")

    log = RunLog(tmp_path, RUN, [Broken()])
    log.row("train", {}, {"x": np.float64(1.5)})
    log.close()
    assert "Broken failed and is switched off: no network" in capsys.readouterr().err
    assert json.loads((tmp_path / "metrics.jsonl").read_text()) == {"kind": "train", "x": 1.5}


def test_processes_give_the_bits_of_serial(tmp_path, whole, forked_workers):
    spread = train(tmp_path, executor=Process(workers=2))
    assert spread["x"] == whole.result["x"]
    assert same_rows(tmp_path, whole.folder)


def test_a_run_begun_in_processes_goes_on_in_serial(tmp_path, whole, forked_workers):
    stopped(tmp_path, 3, executor=Process(workers=2))
    assert train(tmp_path)["x"] == whole.result["x"]


class _Busy(Zoac):
    """Takes an hour of the trainer's clock between `ask` and `tell`."""

    hours = 0

    def background_update(self):
        _Busy.hours += 1
        super().background_update()


def test_what_the_tuner_does_beside_an_evaluation_is_the_tuners_time(
    tmp_path, monkeypatch, forked_workers
):
    _Busy.hours = 0
    clock = SimpleNamespace(
        perf_counter=lambda: time.perf_counter() + 3600 * _Busy.hours,
        process_time=time.process_time,
    )
    monkeypatch.setattr(progress, "time", clock)
    result = train(tmp_path, Process(workers=1), tuner=_Busy, eval_every=10)
    assert result["tuner_seconds"] >= 3600 * len(numbers(tmp_path, "eval"))
    assert result["evaluation_seconds"] < 3600


def test_terminations_while_tuning_are_counted(tmp_path):
    result = train(tmp_path, ends_after=5)
    # Every environment's episodes of 5 steps; segments of 3 end with them.
    assert result["tuning_terminations"] == result["env_steps"] // 5 > 0


class _Lost(Zoac):
    """Recommends what is no number, from its third recommendation on."""

    count = 0

    def recommend(self):
        _Lost.count += 1
        return super().recommend() if _Lost.count < 3 else np.array([np.nan, 0.0])


def test_a_recommendation_that_is_not_finite_is_not_taken(tmp_path, capsys):
    """Nor after a resume: the last finite one is part of the checkpoint."""
    _Lost.count = 0
    stopped(tmp_path, 8, tuner=_Lost)
    result = train(tmp_path, tuner=_Lost)
    rows = numbers(tmp_path, "eval")
    assert rows[0]["x"] != rows[1]["x"]
    assert all(row["x"] == rows[1]["x"] for row in rows[1:])
    assert result["x"] == rows[1]["x"]
    assert "recommends [nan, 0.0], which is not finite; its last" in capsys.readouterr().err


def test_libraries_compute_on_one_thread_and_the_caller_has_his_own_back(tmp_path):
    """As in worker processes: sums in another order would have other bits."""
    seen = []

    class Watching(Zoac):
        def tell(self, segments):
            seen.append(threads())
            return super().tell(segments)

    before = threads()
    train(tmp_path, tuner=Watching)
    assert set(seen) == {frozenset({1})}
    assert threads() == before


def threads():
    return frozenset(library["num_threads"] for library in threadpool_info())
