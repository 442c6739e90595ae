"""What zoac leaves as it found it: the process that imports it, and the libraries that it uses."""

import json
import os
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent

import pytest

from tests import commands

ROOT = Path(__file__).parents[2]

IMPORTS = """
    import json
    from hydra.core.global_hydra import GlobalHydra
"""
STATE = (
    IMPORTS
    + """
    import gymnasium, hydra, locale, os, signal, sys, warnings
    import bayes_opt, cma, nevergrad, numpy as np, optuna, torch

    LIBRARIES = bayes_opt.BayesianOptimization, cma.CMAEvolutionStrategy, optuna.study.Study
    LIBRARIES += nevergrad.optimizers.CMA.__class__, torch.nn.Linear

    def state():
        return {
            "threads": torch.get_num_threads(),
            "dtype": str(torch.get_default_dtype()),
            "gradients": torch.is_grad_enabled(),
            "products": [torch.get_float32_matmul_precision(), torch.backends.mkldnn.enabled],
            "torch random": torch.random.get_rng_state().sum().item(),
            "random": str(np.random.get_state()[1][:5]) + str(np.random.get_state()[2]),
            "errors": np.geterr(),
            "path": list(sys.path),
            "hydra": repr(GlobalHydra.instance().hydra),
            "filters": len(warnings.filters),
            "signals": [str(signal.getsignal(s)) for s in (signal.SIGINT, signal.SIGTERM)],
            "locale": locale.setlocale(locale.LC_ALL),
            "environment": sorted(os.environ.items()),
            "folder": os.getcwd(),
            "classes": [sorted((k, id(v)) for k, v in vars(c).items()) for c in LIBRARIES],
        }

    torch.set_num_threads(2)
    np.random.seed(7)
    before = state()
"""
)


def run(code, before=STATE):
    """Run a script that begins with `before`; return what it prints as JSON."""
    script = dedent(before) + dedent(code)
    done = commands.run("-c", script, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


EXTRAS = {"botorch", "smac"}
MISSING = {name for name in EXTRAS if find_spec(name) is None}
LIKE_ANOTHER = {"nominal", "cmaes", "cmaes_plus"}  # no library but those of the others
TUNERS = sorted({p.stem for p in (ROOT / "conf" / "tuner").glob("*.yaml")} - MISSING - LIKE_ANOTHER)


def test_importing_zoac_and_tuning_change_nothing_whoever_tunes():
    code = f"""
    def changed():
        after = state()
        return sorted(key for key in after if after[key] != before[key])

    import zoac, zoac.algorithm.zoac
    by_import = changed()
    for tuner in {TUNERS}:
        options = {{"initial_design": 2}} if tuner in {EXTRAS | {"optuna"}} else {{}}
        zoac.tune(task="lqr", tuner=tuner, budget=600, num_envs=2, quiet=True, episodes=1,
                  final_episodes=1, eval_every=600, tuner_options=options)
    print(json.dumps([by_import, changed()]))
    """
    assert run(code) == [[], []]


@pytest.mark.parametrize("name", ["tests", "zoac", "benchmarks", "stress", "docs"])
def test_there_is_no_second_way_to_a_module(name):
    assert find_spec(f"zoac.{name}") is None


# Those of one set do not cover up for one another: a number that any of them changes is another.
# Under the first set zoac is imported, too.
BITS = """
    import json, torch, warnings, numpy as np
    from contextlib import ExitStack, contextmanager

    def bits():
        import zoac
        found, task = [], zoac.make_task("pid_acc", max_episode_steps=100)
        for tuner in ("zoac", "zoac_plus"):
            result = zoac.tune(task=task, tuner=tuner, budget=400, quiet=True, episodes=1,
                               final_episodes=1, num_envs=4, eval_every=400)
            assert result.parameters != task.baseline
            found.append(result.parameters)
        return found

    @contextmanager
    def double_precision_and_others():
        threads = torch.get_num_threads()
        torch.set_default_dtype(torch.float64)
        torch.set_num_threads(1)
        with torch.no_grad(), np.errstate(all="raise"), warnings.catch_warnings():
            warnings.simplefilter("error")
            np.random.seed(99)
            torch.manual_seed(99)
            yield
        torch.set_num_threads(threads)
        torch.set_default_dtype(torch.float32)

    @contextmanager
    def half_precision_and_coarse_products():
        torch.set_default_dtype(torch.bfloat16)
        torch.set_float32_matmul_precision("medium")
        with torch.autocast("cpu", dtype=torch.bfloat16):
            yield
        torch.set_float32_matmul_precision("highest")
        torch.set_default_dtype(torch.float32)

    @contextmanager
    def inference_on_a_device_that_computes_nothing():
        with torch.inference_mode(), torch.device("meta"):
            yield

    found = {}
    for defaults in (double_precision_and_others, half_precision_and_coarse_products,
                     inference_on_a_device_that_computes_nothing):
        with defaults():
            found[defaults.__name__] = bits()
    plain = bits()
    print(json.dumps([name for name, parameters in found.items() if parameters != plain]))
"""


def test_a_callers_defaults_change_no_bit():
    assert run(BITS, before="") == []


def test_a_caller_of_hydra_has_it_back():
    code = """
    import threading
    from hydra import compose, initialize_config_module
    import zoac

    costs = []

    def tune():
        result = zoac.tune(task="lqr", tuner="random", budget=400, quiet=True, episodes=1,
                           final_episodes=1)
        costs.append(result.cost_mean)

    with initialize_config_module("zoac.conf", version_base="1.3"):
        mine = GlobalHydra.instance().hydra
        tune()
        assert GlobalHydra.instance().hydra is mine
        compose("tuner/random")
    threads = [threading.Thread(target=tune) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(json.dumps([len(costs), len(set(costs))]))
    """
    assert run(code, before=IMPORTS) == [3, 1]


def test_an_application_of_hydra_may_tune_and_keeps_its_own_configuration(tmp_path):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "mine.yaml").write_text("x: 1")
    (tmp_path / "app.py").write_text(APPLICATION)
    done = commands.run("-m", "app", cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.stdout.splitlines()[-2:] == ["True True", "['hydra', 'main', 'schema']"], done


APPLICATION = """
import hydra, zoac
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

ConfigStore.instance().store("run_schema", {"theirs": True})

@hydra.main(config_path=None, version_base="1.3")
def main(config):
    job, mine = HydraConfig.get(), GlobalHydra.instance().hydra
    zoac.tune(task="lqr", tuner="random", budget=400, quiet=True, episodes=1, final_episodes=1)
    print(HydraConfig.get() == job, GlobalHydra.instance().hydra is mine)

main()
with hydra.initialize(config_path="elsewhere", version_base="1.3"):
    path = GlobalHydra.instance().config_loader().get_search_path().get_path()
    print([source.provider for source in path])
assert ConfigStore.instance().load("run_schema.yaml").node == {"theirs": True}
"""
