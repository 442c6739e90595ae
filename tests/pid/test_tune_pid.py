"""`zoac.tune_pid` and `python -m zoac.pid`: answers, baselines, refusals."""

import math
import runpy
import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import zoac
from benchmarks import loop_plants
from benchmarks.loop_plants import Experiment, figures, margins, simulate
from zoac import specs
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal
from zoac.pid import tuning
from zoac.pid.__main__ import from_file, main
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.pid_loop import Design, PidLoop, design, designed
from zoac.tasks.suite.loops import Plant

control = pytest.importorskip("control")

SAMPLE_TIME, NOISE = 0.05, 0.01
LOOP = {"dead_time": 0.1, "sample_time": SAMPLE_TIME, "input_limits": (-2.0, 2.0), "noise": NOISE}
SPECS = [
    specs.overshoot("y", "r", max=0.1),
    specs.settling_time("y", "r", max=3.0),
    specs.phase_margin(min=50),
]


def lags(gain=2.0):
    return control.tf([gain], [0.1, 0.7, 1])


def broken(result, system, draws=20):
    """Return which of `SPECS` an answer breaks in another simulation."""
    plant = Plant(0, "two lags", system, 0.1, SAMPLE_TIME, "PI", (-2.0, 2.0), NOISE, 0.8)
    experiment = Experiment(200, 200)
    noises = np.random.default_rng(5).normal(0, NOISE, (draws, 201))
    y = simulate(plant, result.parameters, experiment, noises)
    found = figures(y, plant, experiment, 0.02)
    kept = {
        "overshoot": found["overshoot"].max() <= 0.1,
        "settling_time": found["settling_time"].max() <= 3.0,
        "phase_margin": margins(plant, result.parameters)["phase_margin"] >= 49.9,
    }
    return [name for name, holds in kept.items() if not holds]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(tuning, "EPISODES", 120)
    monkeypatch.setattr(design, "MAX_STEPS", 120)
    monkeypatch.setattr(loop_plants, "FREQUENCIES", 1000)


@pytest.fixture
def very_few(few, monkeypatch):
    """Where it does not matter how good the answer is."""
    monkeypatch.setattr(tuning, "EPISODES", 40)


def test_the_answer_keeps_specs_that_ziegler_and_nichols_break():
    result = zoac.tune_pid(lags(), **LOOP, specs=SPECS, baseline="ziegler_nichols")
    assert result.feasible
    assert broken(result, lags()) == []
    table = result.specs.set_index("spec")
    met = table["met"][table["limit"] != ""].tolist()
    assert met == [True, True, True]
    assert zoac.load_result(result.folder).specs.equals(result.specs)
    assert {"Kp", "Ki", "0.1", "baseline", "tuned"} <= set(str(result).replace("=", " ").split())
    standard = result.standard()
    assert standard["K"] / standard["Ti"] == pytest.approx(result.parameters["Ki"])


def test_a_reversed_plant_gets_the_gains_with_the_other_sign():
    up, down = (
        designed(Design([lags(gain)], [0.1], SAMPLE_TIME, "PI", (-2.0, 2.0), NOISE), "simc", SPECS)[
            0
        ]
        for gain in (2.0, -2.0)
    )
    assert down.baseline["Kp"] < 0 > down.baseline["Ki"]
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2))
    for x in np.vstack([points, up.space.normalise(up.baseline)]):
        gains = up.space.named(x)
        reversed_gains = {name: -value for name, value in gains.items()}
        y = down.space.normalise(reversed_gains)
        assert abs(y).max() <= 1.0
        one, other = (
            RolloutEngine(task, [0], [0]).rollout([Proposal(at, 0)])[0]
            for task, at in ((up, x), (down, y))
        )
        assert one.costs.sum() == pytest.approx(other.costs.sum(), rel=1e-6)


def test_of_several_plants_each_keeps_the_specs():
    systems = [lags(1.6), lags(2.4)]
    limits = [SPECS[0], replace(SPECS[1], max=4.0), SPECS[2]]
    result = zoac.tune_pid(systems, **LOOP, specs=limits)
    assert result.feasible
    for system in systems:
        assert set(broken(result, system)) <= {"settling_time"}


def test_the_objective_of_several_plants_is_that_of_the_worst():
    both, _ = designed(Design([lags(1.6), lags(2.4)], [0.1, 0.1], SAMPLE_TIME), "simc")

    def cost(plants, loads):
        experiment = replace(both.experiment, loads=loads)
        task = PidLoop(plants, both.pid, both.space, experiment, both.baseline)
        (segment,) = RolloutEngine(task, [0], [0]).rollout(
            [Proposal(task.space.normalise(task.baseline), 0)]
        )
        return segment.costs.sum()

    loads = both.experiment.loads
    alone = [cost([p], (load,)) for p, load in zip(both.plants, loads, strict=True)]
    assert alone[0] != pytest.approx(alone[1], rel=0.01)
    assert cost(both.plants, loads) == pytest.approx(max(alone))


@pytest.mark.parametrize("baseline", [{"Kp": 40.0, "Ki": 200.0}, {"Kp": 0.0, "Ki": 0.0}])
def test_an_unstable_or_idle_baseline_is_a_start_too(baseline):
    result = zoac.tune_pid(lags(), **LOOP, specs=SPECS, baseline=baseline)
    assert result.baseline == baseline
    assert broken(result, lags()) == []


def test_a_baseline_of_the_other_sign_lies_in_the_box_beside_better_gains():
    baseline = {"Kp": -1.0, "Ki": 0.01}
    task, _ = designed(Design([lags()], [0.1], SAMPLE_TIME), baseline)
    assert abs(task.space.normalise(baseline)).max() < 1.0
    middle = task.space.named(np.zeros(2))
    assert task.is_stable(middle)
    assert middle["Kp"] > 0 < middle["Ki"]


@pytest.mark.usefixtures("very_few")
def test_the_answer_is_never_worse_than_the_baseline():
    good = {"Kp": 0.52, "Ki": 0.85}
    result = zoac.tune_pid(lags(), **LOOP, specs=SPECS, baseline=good)
    assert result.feasible
    assert result.run.cost_mean <= result.run.baseline_cost_mean * 1.001


@pytest.mark.usefixtures("very_few")
def test_a_rule_without_an_answer_gives_way_and_says_so():
    result = zoac.tune_pid(control.tf([1], [2, -1]), dead_time=0.2, sample_time=0.05,
                           structure="PID")  # fmt: skip
    assert "baseline is 'ziegler_nichols' instead of 'simc'" in result.warnings[0]
    assert math.isfinite(result.run.cost_mean)


@pytest.mark.parametrize(("limit", "told"), [(0.4, True), (0.6, False)])
def test_a_settling_time_within_the_dead_time_is_said_to_be_out_of_reach(limit, told):
    asked = Design([control.tf([1], [1, 1])], [0.5], 0.1)
    _, remarks = designed(asked, "simc", [specs.settling_time("y", "r", max=limit)])
    message = "nothing settles within the dead time, 0.5 s."
    assert any(message in remark for remark in remarks) == told


@pytest.mark.usefixtures("very_few")
@pytest.mark.parametrize("structure", ["P", "PD", "PID"])
def test_other_structures_have_their_parameters(structure, tmp_path):
    plant = control.tf([1], [1, 1, 0]) if structure != "PID" else lags()
    result = zoac.tune_pid(plant, dead_time=0.1, sample_time=0.05, structure=structure)
    assert list(result.parameters) == {
        "P": ["Kp"], "PD": ["Kp", "Kd", "Tf"], "PID": ["Kp", "Ki", "Kd", "Tf"],
    }[structure]  # fmt: skip
    assert result.run.cost_mean <= result.run.baseline_cost_mean
    assert "pid_step" in result.export(tmp_path / "pid.h").read_text()


class Lag(gym.Env):
    """y' = u - y from a random start; observation (y, r)."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(-3.0, 3.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.y, self.t = self.np_random.uniform(-0.1, 0.1), 0
        return np.array([self.y, 1.0]), {}

    def step(self, action):
        self.t += 1
        self.y += 0.1 * (float(action[0]) - self.y)
        return np.array([self.y, 1.0]), 0.0, False, self.t == 60, {}


def test_an_environment_is_tuned_from_the_gains_of_today(monkeypatch):
    monkeypatch.setattr(tuning, "EPISODES_IN_ENVIRONMENT", 150)
    limit = specs.overshoot("y", "r", max=0.02)
    result = zoac.tune_pid(
        Lag, sample_time=0.1, specs=[limit], baseline={"Kp": 0.5, "Ki": 3.0}, input_limits=(-3, 3)
    )
    assert result.feasible
    assert result.run.cost_mean < result.run.baseline_cost_mean


@pytest.mark.filterwarnings("error::RuntimeWarning")  # of what should not be computed at all
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"structure": "PIDD"}, "structure='PIDD': did you mean 'PID'"),
        ({"baseline": "simk"}, "unknown rule 'simk'; did you mean 'simc'"),
        ({"baseline": {"Kp": 1.0}}, "no value for Ki of a PI"),
        ({"baseline": {"Kp": 1.0, "Kj": 1.0}}, "unknown gain 'Kj'; did you mean"),
        ({"baseline": {"Kp": math.nan, "Ki": 1.0}}, "Kp=nan, expected a finite number"),
        (
            {"structure": "PD", "baseline": {"Kp": 1.0, "Kd": 0.1, "Tf": -1}},
            "Tf=-1, expected seconds, 0 or more",
        ),
        ({"objective": "iea"}, "objective='iea'"),
        ({"objective": specs.peak("y", max=1.0)}, "a spec without a limit"),
        ({"input_limits": (1.0, 2.0)}, "expected \\(low, high\\) around 0"),
        ({"input_limits": (2, -2)}, r"^input_limits=\(2, -2\): expected \(low, high\)"),
        ({"input_limits": 12}, "input_limits=12: expected \\(low, high\\)"),
        ({"noise": -1.0}, "noise=-1.0"),
        ({"sample_time": 0.0}, "sample_time=0.0"),
        ({"noise": "low"}, "noise='low': expected a standard deviation"),
        ({"sample_time": "0.05"}, "sample_time='0.05': expected seconds above 0"),
        ({"structure": ["PI"]}, "structure=\\['PI'\\]: .*known: P, PD, PI, PID"),
        ({"baseline": [1, 2]}, "baseline=\\[1, 2\\]: expected a rule such as 'simc', or gains"),
        ({"baseline": None}, "baseline=None: expected a rule"),
        ({"dead_time": (0.1, 0.2)}, "2 dead times for 1 plants"),
        ({"dead_time": "0.1s"}, "dead_time='0.1s': expected seconds, or a list"),
        ({"dead_time": None}, "dead_time=None: expected seconds, or a list"),
        ({"dead_time": -1.0}, "dead_time=-1.0: expected seconds, 0 or more"),
        ({"specs": [specs.overshoot("z", "r", max=0.1)]}, "no signal 'z'"),
    ],
)
def test_what_cannot_be_used_is_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        zoac.tune_pid(lags(), **{**LOOP, **options})


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        (control.tf([1], [1, 1], 0.1), "sampled every 0.1 s; expected a continuous system"),
        (control.tf([1, 2, 3], [1, 1]), "more zeros than poles"),
        (control.ss([[-1]], [[1, 1]], [[1]], [[0, 0]]), "2 inputs and 1 outputs"),
        (control.tf([0.0], [1, 1]), "a lasting input has no lasting effect"),
        (control.tf([1, 0], [1, 2, 1]), "a zero at 0"),
        (control.tf([1, 0], [1, 1, 0]), "give plant.minreal"),
        ([], "plant=\\[\\]: expected a system"),
        (control.tf([math.nan], [1, 1]), r"plant: num=\[nan\]: expected finite numbers"),
        (control.tf([1], [1, math.inf]), r"plant: den=\[1.0, inf\]: expected finite numbers"),
        (control.ss([[-1]], [[math.nan]], [[1]], [[0]]), r"plant: B=\[\[nan\]\]: expected finite"),
        ([lags(), control.frd([1, 2], [1, 2])], "expected a transfer function or a state-space"),
    ],
)
def test_a_plant_that_cannot_be_simulated_is_refused(plant, said):
    with pytest.raises(ConfigError, match=said):
        zoac.tune_pid(plant, sample_time=0.1)


@pytest.mark.parametrize("kind", [np.float32, np.float64, lambda value: np.array([value])])
def test_a_dead_time_of_numpy_is_one_of_python(kind):
    assert tuning._dead_times(kind(0.125), 1) == [0.125]


def test_an_environment_has_no_rules_and_its_own_dead_time():
    with pytest.raises(ConfigError, match="give the gains of today"):
        zoac.tune_pid(Lag, sample_time=0.1)
    with pytest.raises(ConfigError, match="an environment has its own"):
        zoac.tune_pid(Lag, sample_time=0.1, noise=0.1, baseline={"Kp": 1.0, "Ki": 1.0})


FILE = """
plant: {num: [2], den: [0.1, 0.7, 1]}
dead_time: 0.1
sample_time: 0.05
input_limits: [-2, 2]
noise: 0.01
specs:
  - overshoot: {max: 0.1}
  - settling_time: {max: 3.0}
  - phase_margin: {min: 50}
"""


@pytest.mark.usefixtures("very_few")
def test_a_file_gives_what_python_gives_with_the_same_seed(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "EPISODES", 24)
    path = tmp_path / "plant.yaml"
    path.write_text(FILE + f"seed: 3\nexport: {tmp_path / 'pid.h'}\n")
    result = from_file(path)
    assert result.parameters == zoac.tune_pid(lags(), **LOOP, specs=SPECS, seed=3).parameters
    assert "pid_step" in (tmp_path / "pid.h").read_text()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FILE.replace("dead_time", "deadtime"), "no key 'deadtime'; did you mean 'dead_time'"),
        (FILE.replace("sample_time", "seed"), "no value for sample_time"),
        (FILE.replace("num", "nom"), "no key 'nom'; did you mean 'num'"),
        (FILE.replace("num: [2], ", ""), "expected num and den"),
        (FILE.replace("num", "dead_time: 0.5, num"), "dead_time has a line of its own"),
        (FILE.replace("num", "gain: 2, num"), "plant: no key 'gain'"),
        (FILE.replace("overshoot", "overshot"), "did you mean 'overshoot'"),
        (FILE + "export: nowhere/pid.h\n", "No such folder; choose a folder that is there"),
        (FILE + "export: pid.txt\n", "export to 'pid.txt'"),
        (FILE + "export: 1\n", "export=1: expected a file"),
        (FILE.replace("0.1\n", "\n"), "dead_time=None"),
        ("- 1\n", "expected keys and values"),
        ("a: [\n", "cannot be read"),
    ],
)
def test_a_file_that_cannot_be_used_gets_one_message(tmp_path, capsys, monkeypatch, text, said):
    monkeypatch.setattr(tuning, "tune", None)  # told before any tuning
    path = tmp_path / "plant.yaml"
    path.write_text(text)
    assert main([str(path)]) == 1
    told = capsys.readouterr()
    assert (told.out, said in told.err) == ("", True)


def test_the_command_line_is_thin(tmp_path, monkeypatch, capsys):
    monkeypatch.delitem(sys.modules, "zoac.pid.__main__")
    monkeypatch.setattr(sys, "argv", ["zoac.pid", str(tmp_path / "none.yaml")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("zoac.pid", run_name="__main__", alter_sys=True)
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith("error: ")
    assert main(["--help"]) == 0
    assert main([]) == 1


def test_a_spec_is_met_outside_the_box_around_the_screened_gains(monkeypatch):
    """The larger Kp the smaller the error, so the box begins at 1.6 and more."""
    monkeypatch.setattr(tuning, "EPISODES", 200)
    limit = 1.02
    result = zoac.tune_pid(
        control.tf([1.0], [5.0, 1.0]), sample_time=0.1, specs=[specs.peak("u", max=limit)],
        baseline={"Kp": 2.0, "Ki": 1.0},
    )  # fmt: skip
    assert result.feasible
    assert 0.5 * limit < result.parameters["Kp"] <= limit
