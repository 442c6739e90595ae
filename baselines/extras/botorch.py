"""BoTorch's Gaussian process and noisy expected improvement, in batches."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from zoac.baselines.extras.model_tuner import ModelTuner
from zoac.core.errors import ConfigError

try:
    import botorch
    import torch
    from botorch.exceptions.warnings import BotorchWarning
    from gpytorch.mlls import ExactMarginalLogLikelihood
    from linear_operator.utils.warnings import NumericalWarning
except ImportError as error:
    raise ConfigError("this tuner needs BoTorch: pip install 'zoac[botorch]'") from error


class BoTorch(ModelTuner):
    """`SingleTaskGP`, with the library's priors, and `qLogNoisyExpectedImprovement`."""

    display_name = "BoTorch"
    library = f"botorch {botorch.__version__}"

    def _suggest(self, points: np.ndarray, costs: np.ndarray, count: int, seed: int) -> np.ndarray:
        with _own_settings(seed):
            x, values = torch.tensor((points + 1.0) / 2.0), torch.tensor(-costs[:, None])
            model = botorch.models.SingleTaskGP(x, values)
            botorch.fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            found, _ = botorch.optim.optimize_acqf(
                botorch.acquisition.qLogNoisyExpectedImprovement(model, x, prune_baseline=True),
                bounds=torch.stack([torch.zeros_like(x[0]), torch.ones_like(x[0])]),
                q=count, num_restarts=4, raw_samples=256, sequential=True,
                post_processing_func=lambda z: torch.tensor(self._rounded(z.numpy())),
            )  # fmt: skip
        return 2.0 * found.numpy() - 1.0

    def _rounded(self, z: np.ndarray) -> np.ndarray:
        return (self._problem.space.rounded(2.0 * z - 1.0) + 1.0) / 2.0


@contextmanager
def _own_settings(seed: int) -> Iterator[None]:
    """Compute on one thread, which fixes the bits, with random numbers and warnings of its own."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]), torch.enable_grad(), warnings.catch_warnings():
            torch.manual_seed(seed)
            warnings.simplefilter("ignore", BotorchWarning)
            warnings.simplefilter("ignore", NumericalWarning)  # of points that are the same
            yield
    finally:
        torch.set_num_threads(threads)
