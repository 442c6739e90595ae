"""A user's controller: which forms are understood, and one object in each environment."""

import functools
import math
import threading

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Batched, Drift, Integrator
from tests.support import same_segment
from zoac.check.controller import hidden_state
from zoac.controllers.user_controller import ScalarController
from zoac.core.errors import ConfigError, ControllerError
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.user_task import user_task


def group(controller, env_indices=(0, 1), penalty=None, **options):
    task = user_task(env=Drift, controller=controller, space={"k": (0.0, 1.0)},
                     max_episode_steps=9, **options)  # fmt: skip
    task.failure_penalty = penalty
    return RolloutEngine(task, list(env_indices), [100 + env_index for env_index in env_indices])


def plan(*env_indices, **kind):
    return [Proposal(np.array([0.1 * env_index]), env_index, **kind) for env_index in env_indices]


EVERYTHING = [
    *plan(0, 1, horizon=4), *plan(0, 1, horizon=3, restore=True), *plan(1, 0, seed=5),
    *plan(0, horizon=2), *plan(0, 1),
]  # fmt: skip


class Recipe:
    """What `Integrator` does, as a function of (parameters, observation, memory)."""

    def init(self, n):
        return {"total": np.zeros(n)}

    def act(self, params, obs, memory):
        total = memory["total"] + obs[:, 0]
        return (-params["k"] * total)[:, None], {"total": total}, {}


class Locked(Integrator):
    """Cannot be copied."""

    def __init__(self):
        self.solver = threading.Lock()


class Protocol(Locked):
    """Cannot be copied either, but says what lasts."""

    def get_state(self):
        return [self.total]

    def set_state(self, state):
        (self.total,) = state


class Forgetful:
    """Has no `reset`: every episode has an object of its own."""

    total = 0.0
    act = Integrator.act


def closure():
    """Make a function for all environments."""
    return lambda params, obs: -params["k"] * obs[0]


@pytest.mark.parametrize(
    "form",
    [
        Integrator(), Integrator, Forgetful(), Forgetful, Protocol, functools.partial(Integrator),
        lambda: Integrator(), Recipe, lambda: Recipe(),
    ],
)  # fmt: skip
def test_every_form_of_one_controller_gives_the_same_bits(form):
    expected = group(Recipe()).rollout(EVERYTHING)
    for one, other in zip(group(form).rollout(EVERYTHING), expected, strict=True):
        assert same_segment(one, other)


@pytest.mark.parametrize("form", [Integrator(), Forgetful, Protocol])
def test_saved_controllers_continue_bit_for_bit(form):
    group_, twin, twice = group(form), group(form), group(form)
    group_.rollout(plan(0, 1, horizon=4))
    state = group_.state()
    twin.restore(state)
    twin.rollout(plan(0, 1, horizon=3))
    twice.restore(state)
    for one, two in zip(twice.rollout(plan(0, 1)), group_.rollout(plan(0, 1)), strict=True):
        assert same_segment(one, two)


class Counting(Integrator):
    """Counts its copies."""

    copies = 0

    def __deepcopy__(self, memo):
        type(self).copies += 1
        twin = type(self)()
        twin.__dict__.update(self.__dict__)
        return twin


def test_an_object_is_copied_once_an_environment_and_at_snapshots_in_mid_episode_only():
    Counting.copies = 0
    engine = group(Counting())
    assert Counting.copies == 2
    assert engine._task.restore_fault is None  # the trial makes and saves one of its own
    Counting.copies = 2
    engine.rollout(plan(0, 1) * 3)
    engine.rollout(plan(0, 1, seed=3))
    assert Counting.copies == 2  # an environment that begins an episode has nothing to save
    engine.rollout(plan(0, horizon=2))
    engine.rollout(plan(0, horizon=2, restore=True))
    assert Counting.copies == 3


class Saved(Protocol):
    """Counts how often it is saved."""

    saved = 0

    def get_state(self):
        type(self).saved += 1
        return super().get_state()


def test_the_protocol_is_used_instead_of_copies():
    engine = group(Saved)
    assert engine._task.restore_fault is None
    Saved.saved = 0
    engine.rollout(plan(0, 1, horizon=2))
    engine.rollout(plan(0, 1, horizon=2, restore=True))
    assert Saved.saved == 2


def test_an_object_that_cannot_be_copied_gets_the_remedy():
    with pytest.raises(ConfigError, match=r"Locked, cannot be copied \(Type.* give its class"):
        group(Locked())
    assert len(group(Locked).rollout(plan(0, 1))) == 2


def tune(controller, **options):
    return zoac.tune(**{
        "env": Drift, "controller": controller, "space": {"k": (0, 1), "other": (0, 1)},
        "budget": 400, "num_envs": 2, "eval_every": 400, "episodes": 1,
        "final_episodes": 2, "max_episode_steps": 10, "quiet": True, **options,
    })  # fmt: skip


def test_a_controller_that_cannot_be_saved_is_tuned():
    assert tune(Locked, tuner="zoac").env_steps >= 400


@pytest.mark.parametrize("form", [Forgetful, Protocol])
def test_processes_give_the_bits_of_serial(form, forked_workers):
    serial = tune(form, tuner="zoac_plus")
    assert tune(form, tuner="zoac_plus", executor="process").parameters == serial.parameters


class Picky(Integrator):
    """Fails at its third step where its gain is above 0.62."""

    def reset(self):
        super().reset()
        self.count = 0

    def act(self, params, obs):
        self.count += 1
        if self.count == 3 and params["k"] > 0.62:
            raise ValueError("too far")
        return super().act(params, obs)


def test_a_failing_neighbour_is_not_felt_by_a_controller_that_remembers():
    for env_index in (0, 1, 2, 3):
        (alone,) = group(Picky(), [env_index], penalty=9.0).rollout(plan(env_index))
        together = group(Picky(), (0, 1, 2, 3), penalty=9.0).rollout(plan(0, 1, 2, 3))
        assert same_segment(alone, together[env_index])
    assert [s.failure is None for s in together] == [True, True, True, False]


class Bounded(Integrator):
    """Fails where its gain is above 0.52."""

    def act(self, params, obs):
        return math.sqrt(0.52 - params["k"])


@pytest.mark.parametrize("form", [Bounded(), lambda params, obs: Bounded().act(params, obs)])
def test_a_failure_is_told_with_the_parameters_of_its_own_environment(form):
    with pytest.raises(ControllerError, match=r"ValueError: .* Environment 1, step 0 .* k=0.55"):
        group(form, (0, 1, 2)).rollout(plan(0, 1, 2))


class Stubborn(Integrator):
    """Its second episode cannot begin."""

    begun = 0

    def reset(self):
        super().reset()
        self.begun += 1
        if self.begun == 2:
            raise OSError("no licence")


def test_a_reset_that_raises_is_a_failure_of_the_controller():
    first, second, third = group(Stubborn(), [0], penalty=9.0).rollout(plan(0) * 3)
    assert (first.failure, third.failure, second.costs.tolist()) == (None, None, [9.0])
    assert "OSError: no licence" in second.failure


class Starts(Integrator):
    """Happens to have a method `init`."""

    def init(self, n=None):
        raise AssertionError("called")


class Kept:
    """Returns the same array at every call, as a function or as a batched controller."""

    def __init__(self):
        self.action, self.calls = np.zeros((4, 1)), 0

    def init(self, n):
        return {}

    def alone(self, params, obs):
        self.action[0] = -params["k"] * obs[0]
        return self.action[0]

    def act(self, params, obs, memory):
        if params["k"].max() > 0.58:
            raise ValueError("too far")
        self.action[: len(obs), 0] = -params["k"] * obs[:, 0]
        return self.action[: len(obs)], memory, {}


def test_an_array_that_a_controller_returns_again_and_again_is_copied():
    def fresh(params, obs):
        if params["k"] > 0.58:
            raise ValueError("too far")
        return -params["k"] * obs[0]

    expected = group(fresh, (0, 1, 2), penalty=9.0).rollout(plan(0, 1, 2))
    alone = group(Kept().alone, (0, 1)).rollout(plan(0, 1))
    batched = group(Kept(), (0, 1, 2), penalty=9.0).rollout(plan(0, 1, 2))
    assert expected[2].failure is not None
    for found, same in zip([*alone, *batched], [*expected[:2], *expected], strict=True):
        assert np.array_equal(found.commands, same.commands)


class Counts(Kept):
    """Acts by how often it was called, which no memory holds."""

    def act(self, params, obs, memory):
        self.calls += 1
        self.action[:] = params["k"] * self.calls
        return self.action[: len(obs)], memory, {}


@pytest.mark.parametrize(
    ("form", "text"), [(Kept, "nothing lasts but its memory"), (Counts, "it has hidden state")]
)
def test_the_check_is_not_misled_by_an_array_that_is_returned_again(form, text):
    task = user_task(env=Drift, controller=form, space={"k": (0.0, 0.5)}, max_episode_steps=9)
    assert text in hidden_state(task)[1]


def test_a_method_called_init_makes_no_batched_controller():
    expected = group(Integrator()).rollout(plan(0, 1))
    for one, other in zip(group(Starts()).rollout(plan(0, 1)), expected, strict=True):
        assert same_segment(one, other)


def test_a_batched_controller_is_known_by_its_three_arguments():
    task = user_task(env=Drift, controller=Batched, space={"k": (0, 1), "bias": 0.25})
    assert not isinstance(task.make_controller(), ScalarController)


class NoInit:
    def act(self, params, obs, memory):
        return obs, memory, {}


class Needs:
    def __init__(self, gain):
        self.gain = gain

    def act(self, params, obs):
        return self.gain


class Attribute:
    act = 3.0


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (NoInit(), r"act\(params, obs, memory\) cannot be called as act\(params, obs\); a batched"),
        (lambda params: 0.0, r"\(params\) cannot be called as act\(params, obs\)"),
        (lambda a, b, c: 0.0, r"\(a, b, c\) cannot be called as act\(params, obs\)"),
        (Needs, r"calling Needs without arguments raised TypeError: .*'gain'; give an object, or"),
        (lambda: None, r"expected a function act\(params, obs\), .* got None from it"),
        (Attribute(), "expected a function act"),
        (3.0, "controller=3.0: expected a function act"),
    ],
)
def test_what_is_no_controller_is_refused_by_what_is_expected(controller, message):
    with pytest.raises(ConfigError, match=message):
        group(controller)


def test_a_maker_of_a_function_and_functions_of_any_signature_are_understood():
    expected = group(lambda params, obs: -params["k"] * obs[0]).rollout(plan(0, 1))
    for form in (closure, lambda *a: -a[0]["k"] * a[1][0], lambda p, o, t=0.0: -p["k"] * o[0]):
        for one, other in zip(group(form).rollout(plan(0, 1)), expected, strict=True):
            assert same_segment(one, other)


class Shared(Integrator):
    """Its copies share what lasts."""

    def __init__(self):
        self.box = []

    def __deepcopy__(self, memo):
        twin = type(self)()
        twin.box = self.box
        return twin

    def reset(self):
        self.box[:] = [0.0]

    def act(self, params, obs):
        self.box[0] += obs[0]
        return -params["k"] * self.box[0]


class Lazy(Integrator):
    """Cannot be copied once it has acted."""

    def act(self, params, obs):
        self.lock = threading.Lock()
        return super().act(params, obs)


class Partly(Integrator):
    """Says less than what lasts."""

    def get_state(self):
        return None

    def set_state(self, state):
        pass


@pytest.mark.parametrize(
    ("form", "fault"),
    [
        (Integrator(), None), (Forgetful, None), (Protocol, None), (Recipe, None),
        (lambda params, obs: 0.0, None), (Shared, "goes on otherwise"),
        (Partly, "goes on otherwise"), (Locked, "saving the controller raised TypeError"),
        (Lazy, "saving the controller raised TypeError"),
    ],
)  # fmt: skip
def test_a_controller_is_relied_on_only_after_a_trial(form, fault, capsys):
    task = user_task(env=Drift, controller=form, space={"k": (0.0, 1.0)}, max_episode_steps=9)
    found = task.restore_fault
    assert found is None if fault is None else fault in found and "get_state() and set_" in found
    assert (task.save_fault is None) == (fault is None)
    if fault is not None:
        assert tune(form, tuner="zoac_plus").env_steps >= 400
        assert fault in " ".join(capsys.readouterr().err.split())


class Leaky(Integrator):
    """Its reset forgets to forget."""

    total = 0.0

    def reset(self):
        pass


@pytest.mark.parametrize(
    ("form", "text"),
    [
        (Integrator, "nothing lasts but its memory"), (Protocol, "nothing lasts but its memory"),
        (Forgetful(), "nothing lasts but its memory"), (Locked, "nothing lasts but its memory"),
        (Leaky, "an earlier episode shows in its actions; begin anew in reset"),
    ],
)  # fmt: skip
def test_the_check_sees_what_an_episode_leaves_to_the_next(form, text):
    task = user_task(env=Drift, controller=form, space={"k": (0.0, 1.0)}, max_episode_steps=9)
    assert hidden_state(task)[1] == text


@pytest.mark.parametrize(("form", "executor"), [(Forgetful, "serial"), (Protocol, "process")])
def test_a_run_that_is_stopped_and_resumed_ends_with_the_same_numbers(
    form, executor, tmp_path, stopping, forked_workers
):
    options = {"tuner": "zoac", "executor": executor}
    whole = tune(form, **options)
    stopping(2)
    with pytest.raises(KeyboardInterrupt):
        tune(form, folder=tmp_path, **options)
    stopping(None)
    resumed = tune(form, folder=tmp_path, **options)
    assert resumed.record["env_restarts"] == 0
    assert resumed.parameters == whole.parameters
    assert resumed.cost_per_episode == whole.cost_per_episode


def test_a_function_that_makes_the_same_object_again_is_refused():
    one = Integrator()
    with pytest.raises(ConfigError, match="the same object again, and each environment needs"):
        group(lambda: one)


class Called(Integrator):
    """Is called itself."""

    def __call__(self, params, obs):
        return self.act(params, obs)


@pytest.mark.parametrize("form", [Integrator().act, functools.partial(Called)().__call__])
def test_a_method_of_an_object_that_must_be_reset_is_refused(form):
    with pytest.raises(ConfigError, match=r"an object with reset\(\).*give the object itself"):
        group(form)


class Whole(Recipe):
    """Begins with a memory of another kind than it goes on with."""

    def init(self, n):
        return {"total": np.zeros(n, int)}


class Short(Recipe):
    """Forgets its memory."""

    def act(self, params, obs, memory):
        return *super().act(params, obs, memory)[:1], {}, {}


@pytest.mark.parametrize(
    ("form", "text"),
    [
        (Whole, r"'total' is float64 of shape \('n',\), and began as int64 of shape \('n',\)"),
        (Short, "'total' is nothing, and began as float64"),
    ],
)
@pytest.mark.parametrize("env_indices", [(0,), (0, 1)])
def test_a_memory_must_begin_as_it_goes_on(form, text, env_indices):
    with pytest.raises(ControllerError, match=text):
        group(form()).rollout(plan(*env_indices))


class KeptMemory(Recipe):
    """Returns the same memory at every call, filled anew."""

    def __init__(self):
        self.total = np.zeros(3)

    def act(self, params, obs, memory):
        if params["k"].max() > 0.58:
            raise ValueError("too far")
        n = len(obs)
        self.total[:n] = memory["total"] + obs[:, 0]
        return (-params["k"] * self.total[:n])[:, None], {"total": self.total[:n]}, {}


def test_a_memory_that_is_returned_again_is_copied_where_environments_are_asked_one_by_one():
    together = group(KeptMemory(), (0, 1, 2), penalty=9.0).rollout(plan(0, 1, 2))
    expected = group(Recipe(), (0, 1)).rollout(plan(0, 1))
    for found, same in zip(together, expected, strict=False):
        assert np.array_equal(found.commands, same.commands)
