"""SMAC3's random forest and expected improvement, by ask and tell."""

import logging
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from zoac.baselines.extras.model_tuner import ModelTuner, params_of, point_of
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter
from zoac.core.seeding import global_random_kept

try:
    import ConfigSpace as cs
    import smac
    from smac import HyperparameterOptimizationFacade as Facade
    from smac import Scenario
    from smac.main.exceptions import ConfigurationSpaceExhaustedException
    from smac.runhistory.dataclasses import TrialInfo, TrialValue
except ImportError as error:
    raise ConfigError("this tuner needs SMAC3: pip install 'zoac[smac]'") from error

logging.getLogger("smac").setLevel(logging.ERROR)  # it warns of few points that are left


class Smac(ModelTuner):
    """SMAC3 for hyperparameters. Its races, which repeat evaluations of good points, are off."""

    display_name = "SMAC3"
    library = f"smac {smac.version}"

    def _suggest(self, points: np.ndarray, costs: np.ndarray, count: int, seed: int) -> np.ndarray:
        space = self._problem.space
        asked: list[np.ndarray] = []
        kinds = cs.ConfigurationSpace(space=[_hyperparameter(p) for p in space.parameters])
        known = [cs.Configuration(kinds, values=params_of(x, space)) for x in points]
        with global_random_kept(), TemporaryDirectory() as folder:
            scenario = Scenario(kinds, output_directory=Path(folder), deterministic=True, seed=seed)
            design = Facade.get_initial_design(scenario, n_configs=0, additional_configs=known[:1])
            library = Facade(scenario, initial_design=design, logging_level=False)
            for config, cost in zip(known, costs, strict=True):
                library.tell(TrialInfo(config, seed=0), TrialValue(float(cost)), save=False)
            with suppress(StopIteration, ConfigurationSpaceExhaustedException):
                while len(asked) < count:
                    asked.append(point_of(dict(library.ask().config), space))
        return np.array(asked).reshape(-1, space.dimension)


def _hyperparameter(p: Parameter) -> Any:
    """Return ConfigSpace's kind: normalised for real parameters, physical for whole numbers."""
    if p.kind == "choice":
        return cs.Categorical(p.name, list(range(len(p.options))))
    bounds = (int(p.low), int(p.high)) if p.kind == "integer" else (-1.0, 1.0)
    return (cs.Integer if p.kind == "integer" else cs.Float)(p.name, bounds)
