import json
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import zoac
import zoac.tasks.user_task
from tests.analysis.folders import PID, write_run
from zoac.analysis import robustness
from zoac.analysis.data import plants, replay
from zoac.analysis.data.load import read
from zoac.core.errors import ConfigError, RunFolderError
from zoac.tasks.pid_acc import PidAcc

QUICK = ["--plants", "3", "--episodes", "2", "--format", "svg"]


class Gain(gymnasium.Env):
    """Cost (g u - 1)^2 + noise of the episode: u = 1 / g is best."""

    observation_space = Box(-1.0, 1.0, (1,), np.float64)
    action_space = Box(-10.0, 10.0, (1,), np.float64)

    def __init__(self):
        self.g = 1.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.noise = self.np_random.uniform()
        return np.zeros(1), {}

    def step(self, action):
        cost = (self.g * float(action[0]) - 1.0) ** 2 + self.noise
        return np.zeros(1), -cost, False, False, {"cost": cost}


def act(params, obs):
    return params["u"] + 0.0 * params["idle"]


@pytest.fixture
def run(tmp_path):
    """Tuned to u = 1 by starting there and staying."""
    space = {
        "u": {"low": -1, "high": 3, "baseline": 1.0},
        "idle": {"low": 0, "high": 1, "baseline": 0.5},
    }
    zoac.tune(
        env=Gain, controller=act, space=space, tuner="nominal", budget=0, episodes=1,
        final_episodes=4, max_episode_steps=3, quiet=True, folder=tmp_path / "run",
    )  # fmt: skip
    return replace(read(tmp_path / "run"), trusted=True)


def test_costs_on_varied_plants_are_those_of_the_plants(run):
    varied = plants.vary(run, {"plant.g": (0.5, 2.0)}, 4, 2)
    g = varied.plants["plant.g"]
    own = varied.costs["tuned"][0]
    expected = own + 3 * (g[1:, None] - 1.0) ** 2  # three steps, the same noise
    np.testing.assert_allclose(varied.costs["tuned"][1:], expected)
    assert ((g[1:] >= 0.5) & (g[1:] <= 2.0)).all()
    assert len(set(g[1:])) == 4
    np.testing.assert_array_equal(varied.costs["tuned"], varied.costs["baseline"])


def test_sensitivity_is_the_change_of_cost_in_the_same_episodes(run):
    u, idle = plants.sensitivity(run, 3)
    change = 3 * 0.2**2  # three steps, a tenth of the mapped box is 0.2
    assert (u.below, u.above) == (pytest.approx(change), pytest.approx(change))
    assert u.error == pytest.approx(0.0, abs=1e-12)
    assert (idle.below, idle.above) == (0.0, 0.0)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_change_that_is_not_finite_is_the_largest(order):
    around = [
        plants.Sensitivity(name, below, above, 0.1)
        for name, below, above in (("a", 5.0, 1.0), ("b", 1.0, np.nan), ("c", 2.0, 3.0))
    ]
    lines = robustness.changes([around[k] for k in order])[1:]
    assert [name for name, *_ in lines] == ["b", "a", "c"]


def test_tail_risk_is_the_mean_of_the_costliest_tenth():
    assert robustness.tail_risk(np.arange(1.0, 21.0).reshape(4, 5)) == 19.5
    assert robustness.tail_risk(np.array([3.0, 1.0])) == 3.0


def test_a_plant_that_varies_while_tuning_is_fixed_when_it_is_set():
    task = zoac.tasks.user_task.user_task(
        env=Gain, controller=act, space={"u": (0, 1), "idle": 0.0}, vary={"g": (0.5, 2.0)},
        max_episode_steps=2,
    )  # fmt: skip
    mean_std = np.ptp(replay.costs(task, np.array([[1.0]]), 20, 0))
    assert mean_std > 1.0 + 1e-3  # more than the noise alone
    fixed = task.with_plant({"g": 1.0})
    assert np.ptp(replay.costs(fixed, np.array([[1.0]]), 20, 0)) < 2.0


def test_the_options_of_a_built_in_task_can_vary(tmp_path):
    run = read(write_run(tmp_path))
    other = plants.on_plant(run, replay.rebuild(run), {"preceding_std": 0.4})
    assert isinstance(other, PidAcc)
    assert other._preceding_std == 0.4
    assert run.config["task"]["preceding_std"] == 0.05


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("preceding_sd", "did you mean 'preceding_std'"),
        ("jerk", "no number 'jerk'"),
    ],
)
def test_what_cannot_vary_is_named(tmp_path, name, message):
    run = read(write_run(tmp_path, config={"task": PID}))
    with pytest.raises(ConfigError, match=message):
        plants.on_plant(run, replay.rebuild(run), {name: 1.0})


def test_the_command_writes_table_and_figure(tmp_path, capsys):
    write_run(tmp_path / "runs")
    out = tmp_path / "out"
    arguments = [str(tmp_path / "runs"), "--out", str(out), "--vary", "preceding_std=0.02,0.2"]
    assert robustness.main([*arguments, *QUICK]) == 0
    printed = capsys.readouterr().out
    assert "| tuned |" in printed
    assert "| baseline |" in printed
    assert (out / "robustness.svg").read_text().startswith("<?xml")
    record = json.loads((out / "robustness.json").read_text())
    assert len(record["plants"]["costs"]["tuned"]) == 4
    assert record["plants"]["plants"]["preceding_std"][0] == 0.05
    assert {s["name"] for s in record["sensitivity"]} == {"k", "Kp", "Ki", "Kd"}


@pytest.mark.parametrize(
    "text",
    ["mass", "mass=1", "mass=2,1", "mass=a,b",
     "preceding_std=nan,1", "preceding_std=1,inf", "preceding_std=inf,inf",
     "preceding_std=-1e308,1e308"],
)  # fmt: skip
def test_a_range_that_is_none_is_refused(tmp_path, capsys, text):
    write_run(tmp_path)
    assert robustness.main([str(tmp_path), "--vary", text]) == 1
    assert capsys.readouterr().err.startswith("error: --vary")


class Steps(Gain):
    """The input counts in a whole number of halves."""

    def __init__(self):
        super().__init__()
        self.halves = 2

    def step(self, action):
        return super().step(0.5 * self.halves * action)


def test_attributes_that_are_whole_numbers_are_drawn_whole(tmp_path):
    zoac.tune(
        env=Steps, controller=act, space={"u": (0, 1), "idle": 0.0}, tuner="nominal", budget=0,
        baseline={"u": 1.0}, episodes=1, final_episodes=2, max_episode_steps=3, quiet=True,
        folder=tmp_path / "run",
    )  # fmt: skip
    run = replace(read(tmp_path / "run"), trusted=True)
    varied = plants.vary(run, {"halves": (1, 4), "g": (0.5, 2.0)}, 12, 2)
    halves, g = varied.plants["halves"][1:], varied.plants["g"][1:]
    assert set(halves) <= {1.0, 2.0, 3.0, 4.0}
    assert len(set(halves)) > 1
    assert not any(value.is_integer() for value in g)
    expected = ((0.5 * halves * g - 1.0) ** 2)[:, None] * 3
    noise = varied.costs["tuned"][1:] - expected
    np.testing.assert_allclose(noise, np.broadcast_to(noise[0], noise.shape), atol=1e-9)
    with pytest.raises(ConfigError, match="expected a whole number"):
        plants.vary(run, {"halves": (1.5, 4)}, 2, 1)


def test_options_of_a_task_that_are_whole_numbers_are_drawn_whole(tmp_path):
    run = read(write_run(tmp_path))
    varied = plants.vary(run, {"max_episode_steps": (5, 9)}, 6, 1)
    drawn = varied.plants["max_episode_steps"]
    assert drawn[0] == PID["max_episode_steps"]
    assert set(drawn[1:]) <= {5.0, 6.0, 7.0, 8.0, 9.0}
    assert len(set(drawn[1:])) > 1


def test_a_record_is_read_back_for_its_own_run_alone(tmp_path):
    run, other = read(write_run(tmp_path)), read(write_run(tmp_path, seed=1))
    varied = plants.vary(run, {"preceding_std": (0.02, 0.2)}, 2, 2)
    around = plants.sensitivity(run, 2)
    file = tmp_path / "robustness.json"
    file.write_text(plants.as_json(run, varied, around))
    found = plants.read(file, run)
    assert found is not None
    again, sensitivities = found
    assert sensitivities == around
    assert again.ranges == varied.ranges
    for name in ("tuned", "baseline"):
        np.testing.assert_array_equal(again.costs[name], varied.costs[name])
    assert plants.read(file, other) is None
    file.write_text("{}")
    with pytest.raises(RunFolderError, match=r"robustness\.json: cannot be read"):
        plants.read(file, run)
