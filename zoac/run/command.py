"""The command line: compose the configuration, check it, tune.

python -m zoac.run task=mpc_tracking tuner=zoac -m seed=0,1,2,3,4
"""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, read_write
from omegaconf.errors import OmegaConfBaseException

from zoac.config.compose import check_overrides, explain, know_own_conf, resolved, variant_of
from zoac.config.overrides import refuse_flags, with_whole_steps
from zoac.core.errors import ConfigError, ZoacError, as_text
from zoac.run import sweep_report
from zoac.run.help import usage
from zoac.run.pipes import leave, reader_may_leave
from zoac.runs.schema import is_done
from zoac.runs.training import lifeline, run_folder

WITH_VALUE = (
    "--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn",
    "--config-dir", "-cd", "--experimental-rerun",
)  # fmt: skip
"""Hydra's flags that are followed by a value."""

LOCAL_LAUNCHERS = ("joblib", "submitit_local")
"""Launchers whose jobs are processes of this machine, which end with the sweep."""

ON_THIS_TERMINAL = ("basic", "joblib", "ray")
"""Launchers whose jobs print where the sweep does; those of others print into files."""

# Not empty once a configuration has been composed: what is raised before is about the overrides.
_composed: list[bool] = []


class SweepStart(Callback):
    """Settles what all jobs of a sweep share, before the launcher starts."""

    def on_multirun_start(self, config: DictConfig, **more: Any) -> None:
        """Fix the sweep's folder, and the environment that jobs' processes inherit."""
        folder = str(Path(config.hydra.sweep.dir).expanduser().absolute())
        os.environ[lifeline.SWEEP] = folder
        launcher = config.hydra.runtime.choices["hydra/launcher"]
        if launcher in ON_THIS_TERMINAL:
            os.environ[lifeline.TERMINAL] = str(os.getpid())
            print("a sweep: a line for each job at its end, a table at the end of all", flush=True)
        sweep_report.keep_given(Path(folder), _as_typed(config.hydra.overrides.task))
        # Composed anew for each job, where runs_dir may differ and another folder be the current.
        kept = folder.replace("${", "\\${")
        quoted = folder.replace("\\", "\\\\").replace("'", "\\'").replace("${", "\\${")
        with read_write(config.hydra):
            config.hydra.sweep.dir = kept
            config.hydra.overrides.hydra.append(f"hydra.sweep.dir='{quoted}'")
        # Numeric libraries read their number of threads when loaded, before Hydra would set it.
        for name, value in config.hydra.job.env_set.items():
            os.environ.setdefault(name, value)
        if launcher in LOCAL_LAUNCHERS:
            _end_jobs_with_this_process(Path(folder))


def _as_typed(overrides: Any) -> list[str]:
    """Return overrides with their ${...}, which cannot be resolved before a sweep has jobs."""
    return list(OmegaConf.to_container(overrides))  # type: ignore[arg-type]


def _end_jobs_with_this_process(folder: Path) -> None:
    """Have a sweep's jobs stop when this process is told to, or ends in any other way."""
    let_go = lifeline.hold(folder)

    def stop(number: int, frame: Any) -> None:
        for one in (signal.SIGINT, signal.SIGTERM):
            signal.signal(one, signal.default_int_handler)  # a second one stops at once
        print("\nstopping all jobs; once more stops at once", file=sys.stderr)
        sweep_report.end(folder, let_go)
        raise KeyboardInterrupt

    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, stop)


@hydra.main(config_path="pkg://zoac.conf", config_name="run", version_base="1.3")
def _job(config: DictConfig) -> None:
    """One run, or one job of a sweep."""
    _composed.append(True)
    job = HydraConfig.get()
    if job.mode is not RunMode.MULTIRUN:
        try:
            _refuse_half_a_sweep(job)
            _run(config)
        except ZoacError as error:
            # Not handed to Hydra, which would print more than the message.
            sys.exit(f"error: {error}")
        return
    lifeline.follow(Path(job.sweep.dir))
    if lifeline.is_cut():
        raise KeyboardInterrupt
    choices = job.runtime.choices
    identity = {"task": choices["task"], "tuner": choices["tuner"], "seed": config.seed}
    typed = _as_typed(job.overrides.task)
    with sweep_report.noted(Path(job.sweep.dir), job.job.num, typed, identity) as noted:
        noted.outcome = _run(config, noted.again)


def _refuse_half_a_sweep(job: Any) -> None:
    """Raise if an experiment lists runs that would be left out for want of `-m`."""
    swept = list(job.sweeper.params or {})
    if swept:
        name = job.runtime.choices.get("experiment")
        raise ConfigError(f"experiment={name} is a sweep over {', '.join(swept)}: add -m")


def _run(config: DictConfig, again: bool = False) -> dict[str, Any]:
    """Tune; `again`: go on with what an earlier start of the same job began."""
    job = HydraConfig.get()
    plain = resolved(config)
    plain["variant"] = variant_of(plain, list(job.overrides.task))
    if again:
        plain["resume"] = "auto"
    choices = job.runtime.choices
    # Imported here: --help and config errors must not wait for torch.
    from zoac.study.experiments import is_program, run_experiments

    names = {"task": choices["task"], "tuner": choices["tuner"]}
    folder = run_folder.of(plain, **names)
    done = is_done(folder) and plain["resume"] != "overwrite"
    if is_program(plain):
        return sweep_report.outcome(run_experiments(plain, **names), folder, done)
    from zoac.runs.training.lifecycle import run_session

    names["fidelity"] = choices["fidelity"]
    result = run_session(plain, command=sys.argv, **names)
    return sweep_report.outcome(result, folder, done)


def multirun_first(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with -m / --multirun in front, where Hydra takes it."""
    flags = [a for a in arguments if a in ("-m", "--multirun")]
    return flags[:1] + [a for a in arguments if a not in ("-m", "--multirun")]


def overrides_of(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are overrides: no flags of Hydra, nor the values of flags."""
    before = ["", *arguments]
    return [
        a
        for flag, a in zip(before, arguments, strict=False)
        if not a.startswith("-") and flag not in WITH_VALUE
    ]


@reader_may_leave()
def main() -> None:
    """Run the command line; exits with 1 and one message on a user's error, with 130 on Ctrl-C."""
    arguments = with_whole_steps(multirun_first(sys.argv[1:]))
    if arguments in (["--help"], ["-h"]):
        print(usage(), end="")
        return
    sys.argv = [sys.argv[0], *arguments]
    # Hydra then hands its exceptions on instead of printing them, and we say it in one message.
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    for name in (lifeline.SWEEP, lifeline.TERMINAL):
        os.environ.pop(name, None)
    gave_up = ""
    _composed.clear()
    if signal.getsignal(signal.SIGINT) is leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        know_own_conf()
        refuse_flags(arguments)
        overrides = overrides_of(arguments)
        check_overrides(overrides)
        for text in overrides:
            if text.lstrip("+~").partition("=")[0].partition(".")[0] == "search":
                raise ConfigError(f"{text}: this belongs to python -m zoac.search")
        _job()
    except ZoacError as error:
        sys.exit(f"error: {error}")
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"error: {explain(error)}")
    except KeyboardInterrupt as stop:
        if (sweep := lifeline.sweep()) is not None:
            print(sweep_report.report(sweep)[0], file=sys.stderr)
        print(str(stop) or "interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        raise
    except Exception as error:
        sweep = lifeline.sweep()
        sweeping = sweep is not None and sweep_report.has_begun(sweep)
        if not _composed and not sweeping:  # Hydra answers some odd overrides with a ValueError
            sys.exit(f"error: {explain(error)}")
        if not sweeping:
            raise
        # Jobs do not raise: it is the launcher, whose job has died.
        gave_up = f"\nthe launcher gave up: {as_text(error)}"
    if (sweep := lifeline.sweep()) is not None:
        told, all_done = sweep_report.report(sweep)
        if gave_up or not all_done:
            sys.exit(f"{told}{gave_up}\nThe same command again does only what is not done.")
        print(told)
