"""Hosts that lack what one takes for granted: a home, a console, an encoding, a cache."""

import json
import os
import subprocess
import sys
import textwrap

import numba
import numpy as np
import pytest

import zoac
from stress.bad_inputs import answer
from zoac.mpc.compiled import compiled

SMALL = (
    "task=pendulum", "tuner=random", "budget=400", "num_envs=2", "eval_every=400",
    "evaluation.episodes=1", "evaluation.final_episodes=2", "executor=serial",
)  # fmt: skip


def python(*arguments, cwd, **environment):
    """Run Python; a variable that is None is taken away."""
    env = {**os.environ, **{k: v for k, v in environment.items() if v is not None}}
    for name, value in environment.items():
        if value is None:
            env.pop(name, None)
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd, env=env, capture_output=True, text=True, timeout=200, errors="replace",
    )  # fmt: skip


def tune(**options):
    return zoac.tune(
        task="pendulum", tuner="random", budget=400, num_envs=2, episodes=1, final_episodes=2,
        executor="serial", **{"quiet": True, **options},
    )  # fmt: skip


def parameters(folder):
    return json.loads((folder / "result.json").read_text())["parameters"]


RUN = "runs/pendulum/random/seed=0/variant=v"


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """What a run on an ordinary host finds."""
    folder = tmp_path_factory.mktemp("plain")
    code, _, errors = answer(*SMALL, "variant=v", f"runs_dir={folder}/runs")
    assert code == 0, errors
    return parameters(folder / RUN)


def test_a_run_its_table_and_its_report_end_alike_without_a_home_a_cache_or_an_encoding(
    plain, tmp_path
):
    code = f"""
    import sys
    from zoac.analysis import report, table2
    from zoac.run import command
    sys.argv[1:] = ["variant=v", *{SMALL}]
    command.main()
    sys.argv[1:] = ["runs", "--task", "pendulum", "--out", "out"]
    sys.exit(table2.main() or report.main())
    """
    done = python(
        "-c", textwrap.dedent(code), cwd=tmp_path,
        HOME=None, XDG_CACHE_HOME=None, NUMBA_CACHE_DIR="/proc/no/such/place", TERM="dumb",
        COLUMNS="0", PYTHONIOENCODING="ascii", LC_ALL="C", PYTHONUTF8="0",
        MPLBACKEND="module://no.such",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert parameters(tmp_path / RUN) == plain
    assert list((tmp_path / "out").glob("*.html"))


def test_where_compiled_code_cannot_be_kept_one_line_says_so(monkeypatch, capsys):
    compile_now = numba.njit

    def njit(*function, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return compile_now(*function, **options)

    monkeypatch.setattr(numba, "njit", njit)
    monkeypatch.setattr(zoac.mpc.compiled, "_said", set())
    twice = compiled(error_model="numpy")(lambda x: 2 * x)
    thrice = compiled()(lambda x: 3 * x)
    assert (twice(2), thrice(2)) == (4, 6)
    assert capsys.readouterr().err.count("NUMBA_CACHE_DIR") == 1


def test_a_program_without_a_console_tunes(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    tune(folder=tmp_path / "run", quiet=False)
    assert (tmp_path / "run" / "result.json").is_file()


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert answer(*SMALL, "runs_dir=~/mine")[::2] == (0, "")
    assert list((tmp_path / "mine").rglob("result.json"))


def test_a_tilde_is_the_home_folder_in_python(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    result = tune(folder="~/mine")
    assert result.folder == tmp_path / "mine"
    result.export("~/gains.json")
    assert (tmp_path / "gains.json").is_file()
    assert zoac.load_result("~/mine").parameters == result.parameters
    assert not (tmp_path / "~").exists()


def test_a_callers_errors_of_numpy_are_not_zoacs(tmp_path):
    with np.errstate(all="raise"):
        result = zoac.tune(
            task="pid_acc", tuner="zoac", budget=800, episodes=1, final_episodes=2,
            executor="serial", folder=tmp_path / "run", quiet=True,
        )  # fmt: skip
    assert np.isfinite(result.cost_mean)
