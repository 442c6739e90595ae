"""Model predictive control: your own model, weights and bounds, as a controller to tune."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zoac.mpc.controller.mpc import Mpc as Mpc
    from zoac.mpc.models.casadi_model import CasadiModel as CasadiModel
    from zoac.mpc.models.function_model import FunctionModel as FunctionModel

_HOMES = {
    "CasadiModel": "models.casadi_model",
    "FunctionModel": "models.function_model",
    "Mpc": "controller.mpc",
}
__all__ = ["CasadiModel", "FunctionModel", "Mpc"]


def __getattr__(name: str) -> Any:
    # Imported on first use: solvers load CVXPY and numba.
    if name in __all__:
        return getattr(import_module(f"zoac.mpc.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'zoac.mpc' has no attribute {name!r}")
