"""Tune controllers from their closed-loop performance.

    import zoac
    result = zoac.tune(env=..., controller=..., space={"kp": (0, 5)}, tuner="zoac", budget=50_000)

`conf`, `tasks`, `baselines` and `analysis` are folders at the root of the repository and
subpackages of `zoac`: an installed copy holds them inside the package, a clone finds them here.
Importing `zoac` makes Gymnasium know `zoac/PidAcc-v0` and `zoac/MpcTracking-v0`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"


class _Clone:
    """Finds the subpackages that lie beside this folder in a clone, and nothing else."""

    ROOT = Path(__file__).resolve().parent.parent
    NAMES = ("zoac.conf", "zoac.tasks", "zoac.baselines", "zoac.analysis")

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return where a subpackage lies; see `importlib.abc.MetaPathFinder`."""
        return PathFinder.find_spec(name, [str(cls.ROOT)]) if name in cls.NAMES else None


if not (Path(__file__).parent / "tasks").is_dir() and _Clone not in sys.meta_path:
    sys.meta_path.insert(0, _Clone)  # before an installed copy of another clone

from zoac.tasks import register  # noqa: E402 (found through the line above)

register()

if TYPE_CHECKING:
    from zoac import mpc as mpc
    from zoac import specs as specs
    from zoac.core.errors import Interrupted as Interrupted
    from zoac.pid.tuning import tune_pid as tune_pid
    from zoac.run.api import make_task as make_task
    from zoac.run.api import tune as tune
    from zoac.runs.loggers.callback import Callback as Callback
    from zoac.runs.result import Result as Result
    from zoac.runs.result import load_result as load_result
    from zoac.specs.signals import action as action
    from zoac.specs.signals import info as info
    from zoac.specs.signals import observation as observation
    from zoac.study.program import program as program
    from zoac.study.study import Study as Study

_HOMES = {
    "Callback": "runs.loggers.callback",
    "Interrupted": "core.errors",
    "Result": "runs.result",
    "action": "specs.signals",
    "info": "specs.signals",
    "load_result": "runs.result",
    "make_task": "run.api",
    "observation": "specs.signals",
    "program": "study.program",
    "Study": "study.study",
    "tune": "run.api",
    "tune_pid": "pid.tuning",
}
__all__ = ["mpc", "specs", *_HOMES]


def __getattr__(name: str) -> Any:
    # Imported on first use: the command line must answer --help without loading everything.
    if name in ("mpc", "specs"):
        return import_module(f"zoac.{name}")
    if name in _HOMES:
        return getattr(import_module(f"zoac.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'zoac' has no attribute {name!r}")
