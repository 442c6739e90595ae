"""Whatever is typed: a run, or one message.

For long: `ZOAC_FUZZ=2000 python -m pytest tests/run/test_fuzz.py`.
"""

import contextlib
import os

from hypothesis import example, given, settings
from hypothesis import strategies as st

from zoac.config import factory
from zoac.config.compose import compose_config, resolved, variant_of
from zoac.core.errors import ZoacError
from zoac.runs.training import run_folder

KEYS = [
    "seed", "budget", "num_envs", "eval_every", "evaluation", "evaluation.episodes",
    "evaluation.seed",
    "checkpoint_seconds", "runs_dir", "variant", "resume", "task", "tuner", "executor",
    "mpc_solver", "fidelity", "logger", "method", "experiment",
    "tuner.exploration.sigma", "tuner.exploration", "tuner.critic.hidden", "tuner.step_size",
    "tuner.recommend", "tuner.exploration.segments", "tuner.population", "tuner._target_",
    "task.jerk", "executor.workers",
    "task.mpc.horizon", "task.solver", "task._target_", "preset", "preset@tuner",
    "mpc_solver.tolerance", "fidelity.source", "logger.wandb.mode", "hydra", "hydra/launcher",
    "hydra.run.dir", "", ".", "a.b", "é",
]  # fmt: skip
VALUES = [
    "", "null", "nan", "inf", "-inf", "-1", "0", "1", "1.5", "1e400", "9" * 40, "true", "x", "[]",
    "[1,x]", "[nan]", "{}", "{a:1}", "{_target_:os.getcwd}", "'", '"', "${seed}", "${nope}", "${",
    "${oc.env:NOPE}", "???", "1,2", "../x", "a/b", "pid_acc", "mpc_tracking", "zoac", "bo",
    "cmaes", "es", "process", "riccati", "authors_code", "zoac", "smoke", "\\", "a=b", "zoac.run",
    "zoac.tasks.pid_acc.PidAcc",
]  # fmt: skip
OVERRIDES = st.lists(
    st.one_of(
        st.builds(
            "{}{}={}".format,
            st.sampled_from(["", "", "", "", "+", "++", "~"]),
            st.sampled_from(KEYS),
            st.one_of(st.sampled_from(VALUES), st.text(max_size=5)),
        ),
        st.builds("~{}".format, st.sampled_from(KEYS)),
        st.text(max_size=8),
    ),
    min_size=1,
    max_size=3,
)


def prepare(overrides):
    """All that happens before the first environment step."""
    config = resolved(compose_config(overrides))
    config["variant"] = variant_of(config, overrides)
    run_settings = factory.build_settings(config)
    task = factory.build_task(config)
    factory.build_tuner(config["tuner"], task, run_settings)
    factory.build_executor(config)
    run_folder.of(config, "task", "tuner")


@given(OVERRIDES)
@settings(derandomize=True, max_examples=int(os.environ.get("ZOAC_FUZZ", 12)))
@example(["task._target_=os.getcwd"])
@example(["tuner._target_=zoac.tasks.pid_acc.PidAcc"])
@example(["hydra=3"])
@example(["task.tuned_for=3"])
def test_overrides_are_used_or_refused_with_a_message(overrides):
    with contextlib.suppress(ZoacError):
        prepare(overrides)
