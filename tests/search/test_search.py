"""The search for a tuner's options."""

import errno
import functools
import json
import pickle
import shutil
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests import commands
from tests.support import Traps, with_a_trap
from zoac.config.compose import compose_config
from zoac.core.errors import ConfigError, ControllerError
from zoac.runs import checkpoint
from zoac.runs.training import identity

optuna = pytest.importorskip("optuna", reason="pip install 'zoac[search]'")

from zoac.search import search as module  # noqa: E402
from zoac.search.__main__ import main, split  # noqa: E402
from zoac.search.ranges import distributions  # noqa: E402
from zoac.search.search import Search, origin  # noqa: E402

ROOT = Path(__file__).parents[2]
OPTIONS = {
    "ranges": {"tuner": {"exploration": {"sigma": {"low": 0.02, "high": 0.4, "log": True},
                                         "segments": {"low": 1, "high": 10}}}},
    "trials": 8, "seeds": [5, 6], "evaluation_seed": 7, "startup": 3, "prune": False, "seed": 0,
    "name": None, "storage": None,
}  # fmt: skip
RUNS = ["task=pid_acc", "tuner=zoac", "num_envs=2"]


@functools.cache
def composed(*overrides):
    return compose_config(overrides)


@pytest.fixture(autouse=True)
def each_configuration_is_composed_once(monkeypatch):
    """It takes a tenth of a second, and nearly all searches here are of the same one."""
    monkeypatch.setattr(module, "compose_config", lambda overrides: composed(*overrides))


class Cheap(Search):
    """A search whose runs cost a known function of the options, and of the seed."""

    def _cost(self, trial, seed):
        sigma, segments = (trial.params[f"tuner.exploration.{n}"] for n in ("sigma", "segments"))
        return abs(sigma - 0.3) + segments + seed


def cheap(folder, **changes):
    return Cheap(overrides=changes.pop("runs", RUNS), folder=str(folder), **{**OPTIONS, **changes})


def seen(search):
    return [(t.number, t.params, t.value) for t in search._study.get_trials()]


def test_a_trial_is_the_mean_over_seeds_and_the_first_one_today_s_options(tmp_path):
    search = cheap(tmp_path, trials=1)
    search.run()
    today = {"tuner.exploration.sigma": 0.08, "tuner.exploration.segments": 4}
    assert seen(search) == [(0, today, pytest.approx(0.22 + 4 + 5.5))]


def test_a_search_in_parts_asks_the_same_as_one_in_one_go(tmp_path):
    whole = cheap(tmp_path / "whole")
    whole.run()
    for trials in (2, 5, 8):
        part = cheap(tmp_path / "parts", trials=trials)
        part.run()
        assert len(seen(part)) == trials
    assert seen(part) == seen(whole)


def test_an_unfinished_trial_is_taken_up_unless_its_process_is_at_it(tmp_path):
    search, other = cheap(tmp_path, trials=2), cheap(tmp_path, trials=2)
    with ExitStack() as mine, ExitStack() as theirs:
        first = search._take(mine)
        assert other._take(theirs).number == 1
        assert other._take(theirs) is None
        mine.close()  # as when its process dies
        taken_up = other._take(theirs)
        assert (origin(taken_up), taken_up.params) == (first.number, first.params)
        assert other._take(theirs) is None
    third = cheap(tmp_path, trials=2)
    with ExitStack() as again:
        assert origin(third._take(again)) in (0, 1)  # left a second time, by the other process


def test_an_edit_of_their_own_code_makes_another_search(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples" / "own_task", tmp_path / "own")
    monkeypatch.chdir(tmp_path / "own")
    monkeypatch.syspath_prepend(str(tmp_path / "own"))
    runs = ["task=tank", "tuner=zoac"]
    cheap(tmp_path, runs=runs)
    cheap(tmp_path, runs=runs)
    code = tmp_path / "own" / "tank.py"
    code.write_text(code.read_text().replace("DT = 1.0", "DT = 20.0"))
    sys.modules.pop("tank")
    identity._seen.clear()  # as in another process
    with pytest.raises(ConfigError, match="another configuration, code or ranges"):
        cheap(tmp_path, runs=runs)
    sys.modules.pop("tank")


def test_a_search_of_somebody_else_opens_no_pickle(tmp_path, stopping):
    runs = [*RUNS, "budget=2000", "task.max_episode_steps=20", "evaluation.final_episodes=2"]
    options = {**OPTIONS, "trials": 1, "seeds": [5]}
    stopping(1)
    with pytest.raises(KeyboardInterrupt):
        Search(overrides=runs, folder=str(tmp_path), **options).run()
    stopping(None)
    (current,) = tmp_path.rglob(checkpoint.CURRENT)
    with_a_trap(current, tmp_path / "trace")
    (current.parents[1] / "task.pkl").write_bytes(pickle.dumps(Traps(tmp_path / "trace")))
    search = Search(overrides=runs, folder=str(tmp_path), **options)
    search.run()
    search.conclude()
    assert [value is None for _, _, value in seen(search)] == [True, False]  # it was gone on with
    assert not (tmp_path / "trace").exists()


def test_a_trial_that_begins_badly_is_dropped(tmp_path):
    class Late(Cheap):
        seeds_run = 0

        def _cost(self, trial, seed):
            self.seeds_run += 1
            return float(trial.number)  # each worse than all before it

    search = Late(overrides=RUNS, folder=str(tmp_path), **{**OPTIONS, "prune": True, "trials": 7})
    search.run()
    states = [t.state.name for t in search._study.get_trials()]
    assert states == ["COMPLETE"] * 5 + ["PRUNED"] * 2
    assert search.seeds_run == 5 * 2 + 2


def test_a_trial_that_cannot_run_counts_as_failed_and_is_not_taken_up(tmp_path):
    class Broken(Cheap):
        def _cost(self, trial, seed):
            raise ControllerError("no")

    with pytest.raises(ControllerError):
        Broken(overrides=RUNS, folder=str(tmp_path), **OPTIONS).run()
    again = cheap(tmp_path, trials=3)
    again.run()
    assert [t.state.name for t in again._study.get_trials()] == ["FAIL", "COMPLETE", "COMPLETE"]


def test_a_study_of_another_configuration_is_refused(tmp_path):
    cheap(tmp_path)
    for changes in (
        {"runs": [*RUNS, "budget=7"]},
        {"seeds": [5, 6, 7]},
        {"evaluation_seed": 8},
        {"ranges": {"tuner": {"exploration": {"sigma": {"low": 0.01, "high": 0.4}}}}},
    ):
        with pytest.raises(ConfigError, match="holds a search of another configuration"):
            cheap(tmp_path, **changes)


def test_the_best_trial_is_written_as_overrides(tmp_path, capsys):
    search = cheap(tmp_path)
    search.run()
    search.conclude()
    best = json.loads((tmp_path / "pid_acc-zoac" / "best.json").read_text())
    assert best["cost_mean"] == min(value for _, _, value in seen(search))
    assert best["cost_mean"] < best["first_cost_mean"]
    sigma = best["options"]["tuner.exploration.sigma"]
    assert f"tuner.exploration.sigma={sigma}" in capsys.readouterr().out


def test_ranges():
    found = distributions({"tuner": {"n": {"low": 1, "high": 8, "log": True},
                                     "x": {"low": 0.5, "high": 2},
                                     "deep": {"kind": ["a", None]}}})  # fmt: skip
    assert found == {
        "tuner.n": optuna.distributions.IntDistribution(1, 8, log=True),
        "tuner.x": optuna.distributions.FloatDistribution(0.5, 2),
        "tuner.deep.kind": optuna.distributions.CategoricalDistribution(["a", None]),
    }


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({}, "nothing to search"),
        ({"tuner": {"sigma": {"low": 0.1}}}, "tuner.sigma: low and high must be numbers"),
        ({"tuner": {"sigma": {"low": 2, "high": 1}}}, "tuner.sigma: .*low"),
        ({"tuner": {"sigma": {"low": 1, "high": 2, "logg": 1}}}, "did you mean 'log'"),
        ({"tuner": {"sigma": 0.1}}, "expected low and high"),
        ({"tuner": {"gama": {"low": 1, "high": 2}}}, "did you mean 'gamma'"),
    ],
)
def test_a_range_that_cannot_be_used_is_named(tmp_path, ranges, message):
    with pytest.raises(ConfigError, match=message):
        cheap(tmp_path, ranges=ranges)


@pytest.mark.parametrize(
    "storage", ["foo", "foo://x", "sqlite:////nowhere/at/all.db", "postgresql://u@localhost:1/x"]
)
def test_a_storage_that_cannot_be_used_is_named(tmp_path, storage):
    with pytest.raises(ConfigError, match=r"^search\.storage='.*; expected the URL .*$") as caught:
        cheap(tmp_path, storage=storage)
    assert "\n" not in str(caught.value)


def test_a_folder_that_cannot_be_made_or_written_to_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"search.folder='.*file': cannot make or use .*; choose"):
        cheap(tmp_path / "file")

    def refused(path, *arguments, **options):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "touch", refused)  # not by the mode: root may write anywhere
    with pytest.raises(ConfigError, match="Permission denied; choose another folder"):
        cheap(tmp_path)


def test_the_search_is_called_like_the_tuner_unless_told():
    assert split(["tuner=zoac_plus", "search.trials=3"]) == (
        ["tuner=zoac_plus"], ["+search=zoac_plus", "search.trials=3"],
    )  # fmt: skip
    assert split(["tuner=zoac_plus", "search=zoac"])[1] == ["+search=zoac"]
    with pytest.raises(ConfigError, match="seed is set for each run of a search"):
        split(["seed=3"])


COMMAND = [
    "task=lqr", "tuner=es", "search=zoac", "~search.ranges.tuner", "search.seeds=[5]",
    "+search.ranges.tuner.sigma.low=0.02", "+search.ranges.tuner.sigma.high=0.4",
    "search.trials=2", "eval_every=10000000", "evaluation.episodes=1", "checkpoint_seconds=0",
    "evaluation.final_episodes=2", "task.max_episode_steps=50", "num_envs=2",
]  # fmt: skip


def start(*arguments, cwd):
    return commands.Started(
        "-m", "zoac.search", *COMMAND, *arguments, cwd=cwd,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(cwd)},
    )  # fmt: skip


def outcome(folder):
    where = optuna.storages.journal.JournalFileBackend(
        str(folder / "searches" / "lqr-es" / "study.journal")
    )
    study = optuna.load_study(study_name="lqr-es", storage=optuna.storages.JournalStorage(where))
    done = [t for t in study.get_trials() if t.value is not None]
    return sorted((origin(t), t.params, t.value) for t in done)


def test_a_killed_process_loses_nothing_and_two_share_a_study(tmp_path, monkeypatch):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    victim = start("budget=4000", cwd=parts)
    while not list(parts.rglob("current.ckpt")) and victim.poll() is None:
        time.sleep(0.01)
    victim.send_signal(signal.SIGKILL)
    victim.communicate()
    assert not list(parts.rglob("result.json"))
    both = [start("budget=4000", cwd=parts) for _ in range(2)]
    monkeypatch.chdir(whole)
    monkeypatch.setattr(sys, "argv", ["", *COMMAND, "budget=4000", "search.trials=1"])
    main()
    for process in both:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    assert len(outcome(parts)) == 2
    assert outcome(parts)[0] == outcome(whole)[0]
    assert len(list(parts.rglob("result.json"))) == 2  # no run twice
    # The trial that was killed went on in its own folders, from its checkpoint.
    assert sorted(parts.rglob("variant=trial-*")) == sorted(
        path.parent for path in parts.rglob("result.json")
    )
