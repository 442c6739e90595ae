"""The command line: compose the configuration, check it, tune.

python -m zoac.run task=mpc_tracking tuner=zoac -m seed=0,1,2,3,4
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from zoac.config import explain, know_own_conf, resolved, variant_of
from zoac.errors import ZoacError
from zoac.usage import usage

# Runs of this process that ended in an error: (overrides, message). A sweep goes on and says so
# at its end.
_failures: list[tuple[str, str]] = []


@hydra.main(config_path="pkg://zoac.conf", config_name="run", version_base="1.3")
def _job(config: DictConfig) -> None:
    """One run, or one job of a sweep."""
    job = HydraConfig.get()
    overrides = list(job.overrides.task)
    try:
        plain = resolved(config)
        plain["variant"] = variant_of(plain, overrides)
        choices = job.runtime.choices
        # Imported here: --help and config errors must not wait for torch.
        from zoac.session import run_session

        run_session(plain, task=choices["task"], tuner=choices["tuner"], command=sys.argv)
    except ZoacError as error:
        if job.mode is RunMode.MULTIRUN:
            print(f"error in {' '.join(overrides)}: {error}", file=sys.stderr)
        _failures.append((" ".join(overrides), str(error)))


def multirun_first(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with -m / --multirun in front, where Hydra takes it."""
    flags = [a for a in arguments if a in ("-m", "--multirun")]
    return flags[:1] + [a for a in arguments if a not in ("-m", "--multirun")]


def main() -> None:
    """Run the command line; exits with 1 and one message on a user's error."""
    arguments = multirun_first(sys.argv[1:])
    if arguments in (["--help"], ["-h"]):
        print(usage(), end="")
        return
    sys.argv = [sys.argv[0], *arguments]
    # Hydra then hands its exceptions on instead of printing them, and we say it in one message.
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    know_own_conf()
    if os.getcwd() not in sys.path:  # `zoac` instead of `python -m zoac.run`: a user's modules
        sys.path.insert(0, os.getcwd())
    try:
        _job()
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"error: {explain(error, arguments)}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    if _failures and "-m" not in arguments[:1] and "--multirun" not in arguments[:1]:
        sys.exit(f"error: {_failures[0][1]}")
    if _failures:
        reasons = "\n".join(f"  {overrides}: {reason}" for overrides, reason in _failures)
        sys.exit(f"{len(_failures)} job(s) of the sweep failed:\n{reasons}")


if __name__ == "__main__":
    main()
