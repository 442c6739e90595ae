"""Specs in a task's YAML file: the same run as from Python, and what the check says."""

import math
from textwrap import dedent

import pytest

import zoac
from stress.bad_inputs import answer
from tests.specs.loops_to_tune import tuned
from zoac.check.__main__ import main
from zoac.config.compose import compose_config, resolved
from zoac.config.factory import build_task
from zoac.core.errors import ConfigError
from zoac.runs.training.lifecycle import run_session
from zoac.tasks.user_task import user_task

TASK = """
    _target_: zoac.tasks.user_task.user_task
    env: tests.specs.loops_to_tune.FirstOrder
    controller: tests.specs.loops_to_tune.proportional
    space:
      k: {low: 0.5, high: 12.0, baseline: 1.0}
    max_episode_steps: 40
    signals:
      y: {observation: 0, unit: m}
      r: 1.0
      u: {action: 0}
    specs:
      - steady_state_error: {y: y, r: r, max: 0.2}
    objective:
      peak: {y: u}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "conf/task").mkdir(parents=True)
    (tmp_path / "conf/task/lag.yaml").write_text(dedent(TASK))
    monkeypatch.chdir(tmp_path)
    return tmp_path


OPTIONS = (
    "task=lag", "tuner=random", "budget=1200", "num_envs=2", "eval_every=1200",
    "evaluation.episodes=3", "evaluation.final_episodes=4", "variant=mine",
)  # fmt: skip


def test_the_command_line_and_python_give_the_same_answer_and_table(folder):
    code, out, errors = answer(*OPTIONS)
    assert code == 0, errors
    assert "steady_state_error(y, r) <= 0.2" in out
    result = zoac.load_result(folder / "runs/lag/random/seed=0/variant=mine")
    other = tuned()
    assert result.parameters == other.parameters
    assert result.specs.equals(other.specs)
    assert result.cost_per_episode == other.cost_per_episode
    assert result.responses.columns.tolist() == ["parameters", "time", "y", "r", "u"]


def test_a_tuner_of_parts_of_episodes_is_refused_with_those_that_can(folder):
    config = resolved(compose_config([*OPTIONS, "tuner=zoac_plus"]))
    with pytest.raises(ConfigError, match="cmaes_full, bo, optuna, es, nevergrad or random"):
        run_session(config, task="lag", tuner="zoac_plus", command=[])
    assert not (folder / "runs").exists()


def test_the_check_tells_what_the_baseline_comes_to(folder, capsys):
    assert main(["task=lag"]) == 0
    said = "ok   specs: with the baseline values, over 5 episodes: steady_state_error(y, r) <= 0.2:"
    out = capsys.readouterr().out
    assert said in out
    assert "not met; peak(u): 1" in out


def test_the_check_fails_where_no_episode_lasts(folder, capsys):
    text = dedent(TASK).replace("FirstOrder", "Short")
    (folder / "conf/task/lag.yaml").write_text(text)
    assert main(["task=lag"]) == 1
    assert "FAIL specs: every episode terminates with the baseline" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("steady_state_error:", "steady_state:", r"specs\[0\]: no spec 'steady_state'; did you"),
        (
            "max: 0.2",
            "maximum: 0.2",
            r"specs\[0\]\.steady_state_error: no argument 'maximum'; did you mean 'max'",
        ),
        ("r: r, max", "r: ref, max", r"steady_state_error\(y, ref\): no signal 'ref'"),
        ("{action: 0}", "{command: 0}", r"signals.u=.*expected one of observation, action"),
        ("{action: 0}", "tests.specs.nowhere.u", "signals.u"),
        ("max: 0.2", "max: 0.2, over: {cvar: 2}", r"cvar\(2\): expected a part"),
        ("peak: {y: u}", "peaks: {y: u}", r"objective\[0\]: no spec 'peaks'"),
    ],
)
def test_a_slip_is_named(folder, old, new, said):
    assert old in TASK
    (folder / "conf/task/lag.yaml").write_text(dedent(TASK).replace(old, new))
    with pytest.raises(ConfigError, match=said):
        build_task(resolved(compose_config(["task=lag"])))


def test_functions_are_dotted_paths():
    pytest.importorskip("control")
    task = user_task(
        env="tests.specs.loops_to_tune.FirstOrder",
        controller="tests.specs.loops_to_tune.proportional",
        space={"k": (0.5, 12.0)},
        max_episode_steps=40,
        signals={"e": "tests.specs.test_yaml.error"},
        specs=[
            {"gain_margin": {"loop": "tests.specs.test_yaml.open_loop", "min": 2.0}},
            {"rms": {"y": "e", "max": 1.0, "window": [0.5, 1.0], "over": {"cvar": 0.5}}},
        ],
    )
    margin, size = task.specs
    assert margin.of_parameters({"k": 2.0}) == pytest.approx(4.0, rel=1e-5)
    assert (size.window, size.over) == ((0.5, 1.0), ("cvar", 0.5))
    assert math.isfinite(size.max)


def error(segment):
    return 1.0 - segment.observations[:, 0]


def open_loop(parameters):
    import control

    return control.tf([parameters["k"]], [1.0, 3.0, 3.0, 1.0])
