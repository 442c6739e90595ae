"""The exported C computes what the controller does."""

import ctypes
import shutil
import subprocess

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import zoac
from tests.mpc.systems import SOLVER, SYSTEMS, cart_pole
from zoac.core.errors import ConfigError, ControllerError
from zoac.mpc import CasadiModel, FunctionModel, Mpc
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler (gcc) here")

TOLERANCE = 1e-6
"""Of an input's range."""


class Compiled:
    """An exported controller, compiled."""

    def __init__(self, source, inputs):
        flags = ["-std=c99", "-pedantic", "-Wall", "-O0", "-shared", "-fPIC", "-lm"]
        library = source.with_suffix(".so")
        subprocess.run(["gcc", str(source), *flags, "-o", str(library)], check=True)
        undefined = subprocess.run(["nm", "-uD", str(library)], capture_output=True, text=True)
        assert "casadi" not in undefined.stdout
        self._library = ctypes.CDLL(str(library))
        self._state = (ctypes.c_double * 10_000)()
        self._action = (ctypes.c_double * inputs)()
        self.reset()

    def reset(self):
        self._library.mpc_init(self._state)

    def __call__(self, observation):
        array = (ctypes.c_double * len(observation))(*observation)
        failed = self._library.mpc_step(self._state, array, self._action)
        return np.array(self._action), failed


def exported(mpc, folder, parameters=None, observation=None):
    path = mpc.export(parameters or {}, folder / "controller.c", observation)
    return Compiled(path, len(mpc.model.inputs))


def logged(mpc, starts, steps, params):
    """Yield observation, action and failure of closed loops in which the model is the plant."""
    for start in starts:
        memory, obs = mpc.init(1), start.copy()
        for step in range(steps):
            action, memory, told = mpc.act(params, obs[None], memory)
            yield step == 0, obs.copy(), action[0], bool(told["solver_failed"][0])
            obs[: len(mpc.model.states)] = told["prediction"][0]


def width(mpc):
    values = mpc.numbers.values
    return np.array([values[f"high_{j}"] - values[f"low_{j}"] for j in mpc.model.inputs])


@needs_gcc
@pytest.mark.parametrize(
    ("system", "changes", "tuned"),
    [
        ("cart-pole", {"linearisations": 2, "initial_guess": "shifted"},
         {"weight_angle": 30.0, "pole": 0.15, "discount": 0.9}),
        ("cart-pole", {"linearisations": 1, "terminal": None, "hard": ["position"],
                       "penalty": {"angle": 50.0}}, {"high_force": 7.0, "max_rate_force": 4.0}),
        ("vehicle", {"linearisations": 2}, {"m": 1300.0, "high_v": 0.1, "weight_delta": 0.5}),
        # At the default tolerance Clarabel itself is off by up to 1e-5 here.
        ("reactor", {"linearisations": 1, "initial_guess": "shifted",
                     "solver": ClarabelSolver(1e-13)}, {"terminal_b": 300.0}),
    ],
)  # fmt: skip
def test_the_c_replays_a_logged_closed_loop(system, changes, tuned, tmp_path):
    of_system = SYSTEMS[system](2, 5, **changes)
    mpc = of_system.mpc
    starts = of_system.observations
    compiled = exported(mpc, tmp_path, tuned, starts.shape[1])
    params = {name: np.full(1, value) for name, value in tuned.items()}
    for begins, obs, action, failed in logged(mpc, starts, 6, params):
        if begins:
            compiled.reset()
        found, told = compiled(obs)
        assert np.abs((found - action) / width(mpc)).max() < TOLERANCE
        assert told == failed


@needs_gcc
def test_where_no_plan_is_found_the_inputs_rest_is_applied(tmp_path):
    changes = {"hard": ("position", "angle"), "penalty": None, "terminal": None}
    changes |= {"reference": {"force": 0.7}, "initial_guess": "shifted"}
    mpc = cart_pole(1, 0, linearisations=2, **changes).mpc
    compiled = exported(mpc, tmp_path)
    inside = np.array([0.1, 0.0, 0.01, 0.0])
    wanted = mpc.act({}, inside[None], mpc.init(1))[0][0]
    for obs in ([5.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 0.0], [0.0, np.inf, 0.0, 0.0]):
        compiled.reset()
        action, failed = compiled(inside)
        assert failed == 0
        assert abs(action[0] - wanted[0]) < 20.0 * TOLERANCE
        action, failed = compiled(obs)
        assert (action[0], failed) == (0.7, 1)


@needs_gcc
@pytest.mark.parametrize("torque", [2.0, -20.0], ids=lambda torque: f"{torque} N m")
def test_references_of_inputs_need_no_rates_and_may_be_out_of_reach(torque, tmp_path):
    mpc = rod_mpc(reference={"torque": torque}, linearisations=1)
    compiled = exported(mpc, tmp_path)
    for obs in np.random.default_rng(0).uniform(-0.6, 0.6, (40, 2)):
        wanted = mpc.act({}, obs[None], mpc.init(1))[0][0]
        found, failed = compiled(obs)
        assert failed == 0
        assert np.abs(found - wanted).max() < 10.0 * TOLERANCE


@needs_gcc
def test_plans_are_averaged_after_ten_linearisations(tmp_path):
    def slow(x, u, p):
        return x.angle + 0.3 * x.rate, x.rate + 0.3 * (9.81 * np.sin(x.angle) + u.torque)

    mpc = Mpc(CasadiModel(*NAMES[:2], step=slow), 12, weights=WEIGHTS, linearisations=12,
              bounds={"torque": (-4.0, 4.0)}, solver=ClarabelSolver(1e-13))  # fmt: skip
    obs = np.array([-1.611, 1.743])  # where twelve programmes are not enough
    wanted = mpc.act({}, obs[None], mpc.init(1))[0][0]
    assert np.abs(exported(mpc, tmp_path)(obs)[0] - wanted).max() < 8.0 * TOLERANCE


@needs_gcc
def test_columns_of_the_state_count_from_the_end(tmp_path):
    mpc = rod_mpc(state=[-1, 0])
    compiled = exported(mpc, tmp_path, observation=3)
    obs = np.array([0.1, 7.0, -0.2])
    wanted = mpc.act({}, obs[None], mpc.init(1))[0][0]
    assert np.abs(compiled(obs)[0] - wanted).max() < 10.0 * TOLERANCE


@pytest.mark.parametrize("state", [[0, 3], [-4, 0]])
def test_columns_outside_the_observation_are_named(state, tmp_path):
    mpc = rod_mpc(state=state)
    with pytest.raises(ConfigError, match="is not in an observation of 3 numbers"):
        mpc.export({}, tmp_path / "controller.c", observation=3)
    with pytest.raises(ControllerError, match="the model has 2 states, the observation 3 numbers"):
        mpc.act({}, np.zeros((1, 3)), mpc.init(1))


@needs_gcc
def test_the_papers_controller_is_exported_from_its_run_folder(tmp_path):
    zoac.tune(task="mpc_tracking", tuner="nominal", budget=0, episodes=1, final_episodes=1,
              quiet=True, folder=tmp_path / "run")  # fmt: skip
    result = zoac.load_result(tmp_path / "run")
    compiled = Compiled(result.export(tmp_path / "controller.c"), 2)
    controller, env = result.controller(), zoac.make_task("mpc_tracking").make_env(1)
    obs, _ = env.reset(seed=3)
    for _ in range(8):
        action = controller(obs[0])
        found, failed = compiled(obs[0])
        assert failed == 0
        assert np.abs((found - action) / np.array([0.8378, 6.0])).max() < TOLERANCE
        obs = env.step(action[None])[0]


class Rod(gymnasium.Env):
    """A rod with a motor, whose observation has more than the state."""

    observation_space = Box(-np.inf, np.inf, (5,), np.float64)
    action_space = Box(-5.0, 5.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-0.4, 0.4, 2)
        return self._observed(), {}

    def _observed(self):
        return np.array([*self.x, 0.1, 0.2, 0.3])

    def step(self, action):
        self.x = self.x + 0.05 * np.array([self.x[1], 9.0 * np.sin(self.x[0]) + action[0]])
        return self._observed(), -float(self.x[0] ** 2), False, False, {}


def rod(x, u, p):
    return x.angle + 0.05 * x.rate, x.rate + 0.05 * (p.gravity * np.sin(x.angle) + u.torque)


NAMES = ["angle", "rate"], ["torque"], {"gravity": 9.81}
WEIGHTS = {"angle": 10.0, "rate": 1.0, "torque": 0.1}


def rod_mpc(model=None, **options):
    model = CasadiModel(*NAMES, step=rod) if model is None else model
    bounds = {"torque": (-5.0, 5.0), "rate": (-1.0, 1.0)}
    return Mpc(model, 5, **{"weights": WEIGHTS, "bounds": bounds, "solver": SOLVER, **options})


@needs_gcc
def test_a_tuned_mpc_is_exported_from_its_run_folder(tmp_path):
    mpc = rod_mpc(reference={"angle": slice(-1, None)})
    result = zoac.tune(
        env=Rod, controller=mpc, space={**mpc.space("weight", within=10.0), "gravity": 9.5},
        tuner="random", budget=60, max_episode_steps=10, episodes=1, final_episodes=1, quiet=True,
        folder=tmp_path / "run",
    )  # fmt: skip
    loaded = zoac.load_result(tmp_path / "run", trust_code=True)
    compiled = Compiled(loaded.export(tmp_path / "controller.c"), 1)
    again = result.export(tmp_path / "again.c").read_text()
    assert again == (tmp_path / "controller.c").read_text()
    env, controller = Rod(), mpc
    params = {name: np.full(1, value) for name, value in result.parameters.items()}
    obs, _ = env.reset(seed=1)
    for _ in range(10):
        action = controller.act(params, obs[None], controller.init(1))[0][0]
        found, _ = compiled(obs)
        assert abs(found[0] - action[0]) < 10.0 * TOLERANCE
        obs = env.step(action)[0]


REFUSED = {
    "give the same function to zoac.mpc.CasadiModel": {"model": FunctionModel(*NAMES, step=rod)},
    "state=... is a function of Python's; give columns": {"state": lambda obs: obs[:, :2]},
    "reference=... is a function of Python's; give numbers": {"reference": lambda obs: obs[:, :2]},
    "set linearisations=5": {"linearisations": "converged"},
    "terminal='riccati' changes with a reference that is observed": {
        "terminal": "riccati", "reference": {"angle": slice(2, 3)}},
    "slice.* needs export.*observation=its length": {"reference": {"angle": slice(-1, None)}},
    "state=.* needs export.*observation=its length": {"state": [0, -1]},
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_what_has_no_form_in_c_is_refused_by_name(message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        rod_mpc(**REFUSED[message]).export({}, tmp_path / "controller.c")
    assert not (tmp_path / "controller.c").exists()


def test_bounds_that_cross_and_other_suffixes_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="lower bound is above its upper bound"):
        rod_mpc().export({"low_rate": 2.0}, tmp_path / "controller.c")
    with pytest.raises(ConfigError, match=r"known: \.c"):
        rod_mpc().export({}, tmp_path / "controller.cpp")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"weight_angel": 20.0}, "no number 'weight_angel'; did you mean 'weight_angle'"),
        ({"weight_angle": -5.0}, "weight_angle=-5.0: expected a finite number from 0"),
        ({"gravity": np.nan}, "gravity=nan: expected a finite number"),
        ({"discount": 3.0}, "discount=3.0: expected a number above 0, at most 1"),
    ],
)
def test_parameters_that_are_no_numbers_of_the_mpc_are_refused(parameters, message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        rod_mpc().export(parameters, tmp_path / "controller.c")


@needs_gcc
def test_exported_bounds_only_narrow_those_of_the_actuator(tmp_path):
    compiled = exported(rod_mpc(), tmp_path, {"low_torque": -30.0, "high_torque": 30.0})
    for angle, limit in ((0.9, -5.0), (-0.9, 5.0)):
        action, failed = compiled([angle, 0.0])
        assert failed == 0
        assert abs(action[0] - limit) < 10.0 * TOLERANCE


def law(params, obs):
    return -params["k"] * obs[0]


def test_a_controller_without_a_form_in_c_is_named(tmp_path):
    result = zoac.tune(env=Rod, controller=law, space={"k": (0.1, 1.0)}, tuner="random", budget=20,
                       max_episode_steps=5, episodes=1, final_episodes=1, quiet=True,
                       folder=tmp_path / "run")  # fmt: skip
    with pytest.raises(ConfigError, match=r"cannot be written as C, zoac.mpc.Mpc can"):
        result.export(tmp_path / "controller.c")
