"""Every YAML file composes, and what it names is built."""

import re
from itertools import zip_longest
from pathlib import Path

import pytest

from zoac.config import factory
from zoac.config.compose import (
    check_overrides,
    compose_config,
    resolved,
    variant_of,
)
from zoac.config.files import choices, configuration
from zoac.config.overrides import with_whole_steps
from zoac.config.settings import RUN_KEYS
from zoac.core.errors import RENAMED, ConfigError, option_names

CONF = Path(__file__).parents[2] / "conf"


def names(group):
    return sorted(p.stem for p in (CONF / group).glob("*.yaml"))


def build(config):
    factory.build_settings(config)
    if config["task"]["_target_"] != factory.PROGRAM:
        factory.build_task(config)
    factory.build_executor(config)


OF_A_RUN = ("task", "executor", "mpc_solver", "fidelity", "logger")
SETS = zip_longest(*([f"{group}={name}" for name in names(group)] for group in OF_A_RUN))


@pytest.mark.parametrize("chosen", list(SETS))
def test_every_choice_of_a_run_composes_and_builds(chosen):
    if "executor=ray" in chosen:
        pytest.importorskip("ray", reason="executor=ray needs zoac[ray]")
    build(resolved(compose_config([choice for choice in chosen if choice])))


@pytest.mark.parametrize("name", names("method"))
def test_a_method_is_a_task_and_a_tuner(name):
    config = compose_config([f"method={name}"])
    chosen = config.hydra.runtime.choices
    assert chosen.task.startswith("mpc_tracking")
    assert (chosen.tuner in name) or (name.startswith("zoac") and chosen.tuner == "zoac")
    plain = resolved(config)
    build(plain)
    if name.endswith("_code"):
        assert plain["task"]["weights"] == "aliased"
        assert plain["task"]["regularisation"] == (50.0 if "reg" in name else 0.0)
        assert plain["tuner"]["step_size"]["anneal"] is False
        assert plain["tuner"]["critic"]["minibatch_remainder"] == "joined"
        assert plain["variant"] == "authors_code"


@pytest.mark.parametrize("name", names("experiment"))
def test_an_experiment_sweeps_over_seeds(name):
    config = compose_config([f"experiment={name}"])
    assert "0,1" in config.hydra.sweeper.params.seed
    build(resolved(config))


def test_table_3_reaches_the_tuner():
    pid = resolved(compose_config(["task=pid_acc"]))["tuner"]
    mpc = resolved(compose_config(["task=mpc_tracking"]))["tuner"]
    exploration, steps = ("segment_length", "segments", "sigma"), ("first", "last", "slope")
    assert [pid["exploration"][k] for k in exploration] == [10, 4, 0.08]
    assert [mpc["exploration"][k] for k in exploration] == [20, 5, 0.1]
    assert [pid["step_size"][k] for k in steps] == [3e-2, 1e-2, 2e-4]
    assert [mpc["step_size"][k] for k in steps] == [5e-2, 1e-2, 1e-4]
    critic = ("hidden", "step_size", "epochs", "minibatch")
    assert [pid["critic"][k] for k in critic] == [[256, 256], 5e-4, 10, 128]
    assert (pid["gamma"], pid["lam"]) == (0.99, 0.95)


def test_fidelity_reaches_the_task():
    config = resolved(compose_config(["task=pid_acc", "fidelity=authors_code"]))
    assert config["task"]["jerk"] == "commanded_increment"
    assert config["tuner"]["step_size"]["anneal"] is False
    assert config["tuner"]["critic"]["minibatch_remainder"] == "joined"


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus"])
def test_the_authors_cost_is_a_task_of_its_own_with_the_same_presets(tuner):
    shared = [f"tuner={tuner}", "fidelity=authors_code"]
    one, other = (
        resolved(compose_config([f"task={task}", *shared])) for task in ("pid_acc", "pid_acc_code")
    )
    assert one == other


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("preset@tuner=pid_acc/zoca", "did you mean 'pid_acc/zoac'"),
        ("preset=pid_acc/zoac", "Did you mean to override preset@tuner"),
        ("preset@tuner=foo", "unknown preset 'foo'; known: .*pid_acc/zoac"),
        ("preset@tuner=pid_acc/zoac,foo", "unknown preset 'foo'"),
    ],
)
def test_a_bad_preset_is_refused_though_the_group_may_be_left_out(override, message):
    with pytest.raises(ConfigError, match=message):
        compose_config([override])


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["+tunr=bo"], "unknown key 'tunr'; did you mean 'tuner'"),
        (["logger=[]"], "logger: a value is needed; known: none, tensorboard, wandb"),
    ],
)
def test_what_no_run_has_and_what_each_needs_is_told(overrides, message):
    with pytest.raises(ConfigError, match=message):
        resolved(compose_config(["task=lqr", *overrides]))


def test_numbers_typed_as_text_are_numbers():
    """So an interpolation from the environment is one."""
    text = ["task=lqr", "seed='3'", "evaluation.episodes='4'", "variant=7"]
    config = resolved(compose_config(text))
    assert (config["seed"], config["evaluation"]["episodes"], config["variant"]) == (3, 4, "7")


@pytest.mark.parametrize(
    ("overrides", "meant"),
    [
        (["method=bo", "tuner.nose=3"], "tuner.noise"),
        (["task=mpc_tracking", "task.mpc.horizn=3"], "task.mpc.horizon"),
        (["executor.worker=3", "executor=process"], "executor.workers"),
    ],
)
def test_a_mistyped_key_is_measured_against_the_chosen_option(overrides, meant):
    misspelt = next(o for o in overrides if "." in o)
    with pytest.raises(ConfigError, match=f"unknown key .* in '{misspelt}'; did you mean '{meant}"):
        compose_config(overrides)


def test_an_argument_that_a_tasks_file_leaves_out_is_told_how_to_add():
    with pytest.raises(ConfigError, match=r"added: \+task.plant=\.\.\."):
        compose_config(["task.plant={m:3}"])


@pytest.mark.parametrize(
    "override", ["seed=glob(*)", "task=glob(nothing*)", "seed=range(0,0)", "num_envs=glob(1*)"]
)
def test_a_sweep_over_nothing_is_refused(override):
    with pytest.raises(ConfigError, match="nothing to go through"):
        check_overrides([override])


@pytest.mark.parametrize("override", ["task=glob(p*)", "seed=range(0,3)", "seed=1,2", "seed=5"])
def test_a_sweep_over_something_is_not(override):
    check_overrides([override])


@pytest.mark.parametrize(
    ("given", "read"),
    [
        ("budget=5e5", "budget=500000"),
        ("budget=2.5e4,1E5", "budget=25000,100000"),
        ("eval_every=1e+3", "eval_every=1000"),
        ("budget=1.5e0", "budget=1.5e0"),
        ("budget=1e99", "budget=1e99"),
        ("tuner.exploration.sigma=1e1", "tuner.exploration.sigma=1e1"),
        ("variant=budget=1e3", "variant=budget=1e3"),
    ],
)
def test_numbers_of_steps_may_be_written_with_an_exponent(given, read):
    assert with_whole_steps([given]) == [read]


def test_a_variant_is_what_the_overrides_change_beyond_identity():
    overrides = [
        "task=pid_acc",
        "seed=3",
        "tuner.exploration.sigma=0.2",
        "budget=100",
        "executor=process",
    ]
    assert variant_of({"variant": None}, overrides) == "budget=100,tuner.exploration.sigma=0.2"
    assert variant_of({"variant": None}, overrides[:2]) is None
    assert variant_of({"variant": "mine"}, overrides) == "mine"


def test_explanations_do_not_show_hydras_inner_names():
    with pytest.raises(ConfigError) as error:
        resolved(compose_config(["seed=${nope}"]))
    assert str(error.value) == "seed: Interpolation key 'nope' not found"


def test_numbers_from_the_shells_environment_are_numbers(monkeypatch):
    monkeypatch.setenv("NUMBER", "3")
    written = [
        "seed=${oc.env:NUMBER}",
        "failure_penalty=${oc.env:NUMBER}",
        "variant=3",
        "budget=1e3",
    ]
    config = resolved(compose_config(written))
    names = ("seed", "failure_penalty", "variant", "budget")
    assert repr([config[name] for name in names]) == "[3, 3.0, '3', 1000]"


def test_an_experiment_changes_the_keys_of_the_run():
    config = compose_config(["experiment=smoke"])
    assert (config.budget, config.variant, config.evaluation.final_episodes) == (1000, "smoke", 4)
    assert compose_config(["experiment=smoke", "budget=5"]).budget == 5


@pytest.mark.parametrize(
    ("overrides", "now"),
    [
        (["lanes=3"], "num_envs"),
        (["tuner=zoac_plus", "tuner.race_share=0.2"], "tuner.halving_fraction"),
        (["task=mpc_tracking", "task.mpc.linearise_about=zero"], "task.mpc.initial_guess"),
        (["method=ours"], "zoac"),
        (["tuner=zoac_plus", "tuner.hidden=[8]"], "tuner.critic.hidden"),
    ],
)
def test_a_former_name_is_refused_with_the_present_one(overrides, now):
    with pytest.raises(ConfigError, match=f"it is now called '{now}'"):
        compose_config(overrides)


def test_every_present_name_is_that_of_an_option():
    nodes = [configuration(task=None, tuner=tuner)["tuner"] for tuner in choices("tuner")]
    tasks = [configuration(task="mpc_tracking")["task"]["mpc"]]
    options = {name for node in nodes + tasks for name in option_names(node)}
    assert set(RENAMED.values()) <= {*options, *RUN_KEYS, *names("method"), "baseline"}


@pytest.mark.parametrize("override", ["runs_dir=mes résultats", "seed", "=3", "seed.=3", "a=b=c"])
def test_what_hydra_cannot_read_is_answered_with_how_to_write_it(override):
    with pytest.raises(
        ConfigError, match=f"^cannot read the override '{re.escape(override)}': expected key=value"
    ):
        compose_config([override])


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("search.ranges={num_envs:{low:2,high:3}}", "is added: +search.ranges.num_envs=..."),
        ("search.ranges.tuner.exploration.sigma.lov=1", "did you mean 'search.ranges.tuner.expl"),
        ("search.trails=3", "did you mean 'search.trials'"),
    ],
)
def test_a_mistyped_key_of_a_search_is_measured_against_its_file(override, says):
    with pytest.raises(ConfigError, match="unknown key") as refused:
        compose_config(["+search=zoac", override])
    assert says in str(refused.value)
