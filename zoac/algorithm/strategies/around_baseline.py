"""Searching around the baseline: where a tuner begins, and how far it looks."""

from collections.abc import Mapping
from typing import Any

from zoac.core.errors import ConfigError
from zoac.core.types import is_number


def around_baseline(options: Mapping[str, Any], initial_sigma: float) -> dict[str, Any]:
    """Return a tuner's options for a search around the baseline.

    The tuner begins at the baseline. Its option `sigma` or `initial_sigma`, whichever it has,
    becomes `initial_sigma`; a step size of the parameters changes in proportion to sigma;
    successive halving, which searches the whole box, is left out.

    Args:
        options: Of the tuner, by name.
        initial_sigma: Standard deviation of the search in the mapped box [-1, 1]^d.

    Raises:
        ConfigError: If the tuner cannot be told where to begin and how far to search.
    """
    group = options.get("exploration", options)
    width = next((name for name in ("sigma", "initial_sigma") if name in group), None)
    if width is None or "start" not in options:
        raise ConfigError(
            f"initial_sigma={initial_sigma:g}: this tuner has no start and no sigma to set; use "
            "cmaes, cmaes_full, es or nevergrad, or zoac or zoac_plus where single steps are seen"
        )
    chosen = {**options, "start": "baseline"}
    if group is options:
        chosen[width] = initial_sigma
    else:
        chosen["exploration"] = {**group, width: initial_sigma}
    if width == "sigma" and "step_size" in options:
        chosen["step_size"] = _scaled(options["step_size"], initial_sigma / group["sigma"])
    if "halving_fraction" in options:
        chosen["halving_fraction"] = 0.0
    return chosen


def _scaled(step_size: Any, factor: float) -> Any:
    """Return a step size, or ZOAC's group of them, times a factor."""
    if not isinstance(step_size, Mapping):
        return step_size * factor
    return {k: v * factor if is_number(v) else v for k, v in step_size.items()}
