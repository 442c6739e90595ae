"""Every script in examples/ runs, at a tiny budget."""

import runpy
import sys
from pathlib import Path

import pytest

import zoac

FOLDER = Path(__file__).parents[2] / "examples"
MORE = {
    "pendulum_pd": ["--episodes", "2"],
    "memory_controller": ["--out", "gains.h"],
}


# `tests/run/test_readme.py` runs these and checks what they print.
OF_THE_README = {"first", "cart"}
OTHERS = sorted(path for path in FOLDER.glob("*.py") if path.stem not in OF_THE_README)


@pytest.mark.parametrize("path", OTHERS, ids=lambda path: path.stem)
def test_it_runs_and_prints_what_it_found(path, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [path.name, "--budget", "240", *MORE.get(path.stem, [])])
    quick = {"episodes": 1, "final_episodes": 1, "eval_every": 240, "num_envs": 2}
    tune = zoac.tune

    def short(**options):
        options["budget"] = min(options.get("budget", 240), 480)
        options["max_episode_steps"] = min(options.get("max_episode_steps") or 20, 20)
        return tune(**{**options, **quick})

    monkeypatch.setattr(zoac, "tune", short)
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()
