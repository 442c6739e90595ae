"""Tune controllers from their closed-loop performance.

    import zoac
    result = zoac.tune(env=..., controller=..., space={"kp": (0, 5)}, tuner="zoac", budget=50_000)

`conf`, `tasks`, `baselines` and `analysis` are folders at the root of the repository and
subpackages of `zoac`: an installed copy holds them inside the package, a clone finds them here.
Importing `zoac` makes Gymnasium know `zoac/PidAcc-v0` and `zoac/MpcTracking-v0`.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_root = Path(__file__).resolve().parent.parent
if (_root / "pyproject.toml").is_file() and (_root / "conf" / "run.yaml").is_file():
    __path__.append(str(_root))

from zoac.tasks import register  # noqa: E402 (found through the line above)

register()

if TYPE_CHECKING:
    from zoac.api import make_task as make_task
    from zoac.api import tune as tune
    from zoac.results import Result as Result
    from zoac.results import load_result as load_result

__all__ = ["Result", "load_result", "make_task", "tune"]
_HOMES = {"Result": "results", "load_result": "results", "make_task": "api", "tune": "api"}


def __getattr__(name: str) -> Any:
    # Imported on first use: the command line must answer --help without loading everything.
    if name in __all__:
        return getattr(import_module(f"zoac.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'zoac' has no attribute {name!r}")
