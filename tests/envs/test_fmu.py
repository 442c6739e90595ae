"""An FMU built here against its Python original."""

import sys
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from pythonfmu import builder  # of the extra `dev`

import zoac
from zoac.config import factory
from zoac.config.fingerprint import described
from zoac.core.errors import ConfigError, EnvironmentFailure, UnsavableError
from zoac.core.segments import Proposal
from zoac.envs.fmu import FmuEnv
from zoac.envs.fmu_instance import FmuInstance
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.user_fmu import FmuFile
from zoac.tasks.user_task import user_task

MODEL = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Mass(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mass, self.force, self.position, self.speed = 1.0, 0.0, 1.0, 0.0
        tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("mass", **tunable))
        self.register_variable(Real("force", causality=Fmi2Causality.input))
        self.register_variable(Real("position", causality=Fmi2Causality.output))
        self.register_variable(Real("speed", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        if self.mass > 50.0:
            return False
        self.speed += step_size * (self.force / self.mass - 0.1 * self.speed)
        self.position += step_size * self.speed
        return True
"""
STEPS, STEP = 40, 0.05


class Mass(gymnasium.Env):
    """The same in Python."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-5.0, 5.0, (1,), np.float64)

    def __init__(self):
        self.mass = 1.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position, self.speed, self.steps = 1.0, 0.0, 0
        return np.array([self.position, self.speed]), {}

    def step(self, action):
        force = float(action[0])
        self.speed += STEP * (force / self.mass - 0.1 * self.speed)
        self.position += STEP * self.speed
        self.steps += 1
        cost = quadratic({"position": self.position, "force": force})
        seen = np.array([self.position, self.speed])
        return seen, -cost, False, self.steps >= STEPS, {}


def quadratic(values):
    return values["position"] ** 2 + 0.01 * values["force"] ** 2


def pd(parameters, seen):
    return -parameters["kp"] * seen[0] - parameters["kd"] * seen[1]


@pytest.fixture(scope="session")
def build(tmp_path_factory):
    """Return a function that makes an FMU from the model's source."""

    def make(source=MODEL, **options):
        folder = tmp_path_factory.mktemp("fmu")
        (folder / "mass.py").write_text(source)
        return builder.FmuBuilder.build_FMU(folder / "mass.py", dest=folder, **options)

    return make


@pytest.fixture(scope="session")
def path(build):
    return build(canGetAndSetFMUstate=True, canSerializeFMUstate=True)


def fmu(path, **options):
    given = {
        "observations": ["position", "speed"],
        "actions": {"force": (-5.0, 5.0)},
        "cost": quadratic,
        "step_size": STEP,
        "stop_time": STEPS * STEP,
        **options,
    }
    return FmuEnv(path, **given)


def tuned(env, **options):
    given = {"space": {"kp": (0.0, 10.0), "kd": (0.0, 10.0)}, "num_envs": 2, "quiet": True,
             "budget": 6 * STEPS, "eval_every": 6 * STEPS, "episodes": 1, "final_episodes": 2,
             **options}  # fmt: skip
    return zoac.tune(env=env, controller=pd, **given)


@pytest.mark.parametrize("tuner", ["cmaes_full", "zoac_plus"])
def test_it_tunes_to_the_gains_and_costs_of_the_original(tuner, path):
    original = tuned(Mass, tuner=tuner, max_episode_steps=STEPS)
    found = tuned(lambda: fmu(path), tuner=tuner)
    assert found.parameters == pytest.approx(original.parameters, abs=1e-9)
    assert found.cost_per_episode == pytest.approx(original.cost_per_episode, abs=1e-9)
    assert found.record["env_restarts"] == 0


def test_parameters_are_set_and_varied(path):
    original = tuned(Mass, tuner="random", vary={"mass": (0.5, 4.0)}, max_episode_steps=STEPS)
    found = tuned(lambda: fmu(path), tuner="random", vary={"mass": (0.5, 4.0)})
    assert found.cost_per_episode == pytest.approx(original.cost_per_episode, abs=1e-9)
    heavy = tuned(lambda: fmu(path), tuner="random", plant={"mass": 4.0})
    assert heavy.cost_mean > tuned(lambda: fmu(path), tuner="random").cost_mean + 1e-3


def test_its_state_is_saved_and_restored_also_into_another_instance(path):
    task = user_task(env=lambda: fmu(path), controller=pd, space={"kp": (0, 9), "kd": (0, 9)})
    assert task.restore_fault is None
    one, other = fmu(path), fmu(path)
    one.reset(seed=0)
    for _ in range(7):
        one.step([1.0])
    state = one.get_state()
    expected = [(o.tolist(), *rest) for o, *rest in (one.step([0.3]) for _ in range(33))]
    assert expected[-1][3]  # the end of the episode
    other.reset(seed=0)
    other.set_state(state)
    assert [(o.tolist(), *rest) for o, *rest in (other.step([0.3]) for _ in range(33))] == expected


def test_one_that_cannot_be_saved_serves_tuners_of_whole_episodes(build):
    plain = build()
    with pytest.raises(UnsavableError, match=r"Mass\.fmu cannot save its state"):
        fmu(plain).get_state()
    task = user_task(env=lambda: fmu(plain), controller=pd, space={"kp": (0, 9), "kd": (0, 9)})
    assert "cannot save its state" in task.restore_fault
    assert np.isfinite(tuned(lambda: fmu(plain), tuner="cmaes_full").cost_mean)


def test_one_instance_serves_every_episode(path, monkeypatch):
    made = []
    init = FmuInstance.__init__
    monkeypatch.setattr(FmuInstance, "__init__", lambda *a: made.append(a) or init(*a))
    task = user_task(env=lambda: fmu(path), controller=pd, space={"kp": (0, 9), "kd": (0, 9)})
    group = RolloutEngine(task, [0], [0])
    x = task.space.normalise({"kp": 2.0, "kd": 2.0})
    for _ in range(3):
        (segment,) = group.rollout([Proposal(x, 0)])
        assert segment.truncated
    assert len(made) == 1


def test_a_step_that_fails_is_an_episode_that_fails(path):
    env = fmu(path)
    env.mass = 60.0
    env.reset(seed=0)
    with pytest.raises(EnvironmentFailure, match="the FMU's step failed"):
        env.step([0.0])
    env.mass = 1.0
    env.reset(seed=0)
    assert env.step([0.0])[0].tolist() == [1.0, 0.0]
    result = tuned(lambda: fmu(path), tuner="random", vary={"mass": (1.0, 100.0)},
                   failure_penalty=100.0)  # fmt: skip
    assert result.record["failures"] > 0
    assert "the FMU's step failed" in result.record["first_failure"]


def test_the_cost_may_be_a_variable(path):
    env = fmu(path, cost="position")
    env.reset(seed=0)
    observation, reward, *_ = env.step([1.0])
    assert -reward == observation[0]
    assert env.action_space == Box(-5.0, 5.0, (1,), np.float64)
    assert fmu(path, actions=["force"]).action_space.high.tolist() == [np.inf]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"observations": ["positoin"]}, "no real variable 'positoin'; did you mean 'position'"),
        ({"actions": {"force": 5.0}}, "actions: 'force': 5.0, expected"),
        ({"actions": ["speed"]}, "no real input or parameter 'speed'"),
        ({"cost": "costs"}, "no real variable 'costs'"),
        ({"step_size": 0.0}, "step_size=0.0: expected seconds"),
        ({"stop_time": "10"}, "stop_time='10': expected seconds"),
    ],
)
def test_what_it_does_not_have_is_named(options, says, path):
    with pytest.raises(ConfigError, match=says):
        fmu(path, **options)


def test_files_that_cannot_be_used_are_named(path, tmp_path):
    with pytest.raises(ConfigError, match="there is no file"):
        fmu(tmp_path / "absent.fmu")
    (tmp_path / "text.fmu").write_text("text")
    with pytest.raises(ConfigError, match="cannot be read as an FMU"):
        fmu(tmp_path / "text.fmu")
    elsewhere, newer = tmp_path / "elsewhere.fmu", tmp_path / "newer.fmu"
    with zipfile.ZipFile(path) as given:
        with zipfile.ZipFile(elsewhere, "w") as made:
            for name in given.namelist():
                if not name.startswith("binaries/") or "win" in name:
                    made.writestr(name, given.read(name))
        with zipfile.ZipFile(newer, "w") as made:
            text = given.read("modelDescription.xml").decode()
            made.writestr("modelDescription.xml", text.replace("CoSimulation", "ModelExchange"))
    if sys.platform == "linux":
        with pytest.raises(ConfigError, match="has no binary for linux64; it has those for: win64"):
            fmu(elsewhere)
    with pytest.raises(ConfigError, match="without co-simulation|cannot be read"):
        fmu(newer)


NAMED = {"observations": ["position", "speed"], "actions": {"force": [-5.0, 5.0]},
         "cost": "tests.envs.test_fmu.quadratic", "step_size": STEP,
         "stop_time": STEPS * STEP}  # fmt: skip


def test_a_configuration_names_an_fmu(path, forked_workers):
    def named(**options):
        node = {"_target_": "zoac.tasks.user_task.user_task", "env": str(path),
                "controller": "tests.envs.test_fmu.pd", "space": {"kp": [0, 10], "kd": [0, 10]},
                **NAMED, **options}  # fmt: skip
        return factory.build_task({"task": node})

    options = {"tuner": "cmaes_full", "budget": 6 * STEPS, "eval_every": 6 * STEPS, "num_envs": 2,
               "episodes": 1, "final_episodes": 2, "quiet": True}  # fmt: skip
    found = zoac.tune(task=named(), executor="process", **options)
    assert found.parameters == tuned(lambda: fmu(path), tuner="cmaes_full").parameters
    by_variable = zoac.tune(task=named(cost="position"), **options)
    assert by_variable.cost_mean < found.cost_mean
    for changed, says in (
        ({"step_size": None}, "an FMU needs step_size too"),
        ({"cost": "tests.envs.test_fmu.nothing"}, "cost: no 'nothing' in tests.envs.test_fmu"),
        ({"cost": "posiiton"}, "no real variable 'posiiton'; did you mean 'position'"),
        ({"env": "Pendulum-v1"}, "observations, actions, cost, step_size, stop_time: only for an"),
        ({"env": "absent.fmu"}, "there is no file 'absent.fmu'"),
    ):
        with pytest.raises(ConfigError, match=says):
            named(**changed)


def test_another_fmu_under_the_same_name_is_another_environment(path, build, tmp_path):
    used = tmp_path / "used.fmu"
    texts = []
    for source in (path, build(MODEL.replace("0.1 * self.speed", "0.2 * self.speed"))):
        used.write_bytes(Path(source).read_bytes())
        texts.append(described(FmuFile(str(used), **NAMED)))
    assert texts[0] != texts[1]
    assert described(FmuFile(str(used), **NAMED)) == texts[1]


def test_without_the_library_the_extra_is_named(path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ConfigError, match=r"pip install 'zoac\[fmu\]'"):
        fmu(path)
