import numpy as np
import pytest

from tests.analysis.folders import NOMINAL, write_run
from zoac.analysis.figures import style


@pytest.fixture(autouse=True)
def a_folder_to_write_into(tmp_path_factory, monkeypatch):
    """Commands without --out write where they are called."""
    monkeypatch.chdir(tmp_path_factory.mktemp("called_here"))


@pytest.fixture
def undrawn(monkeypatch):
    """Have figures made and written, but not drawn: where nobody looks at them."""
    monkeypatch.setattr(style, "image", lambda *figure, **options: b"<svg></svg>")


@pytest.fixture
def sweep(tmp_path):
    """Three tuners with five seeds each, and the nominal controller."""
    root = tmp_path / "runs"
    shape = np.array([0.0, 1.0, 2.0, 3.0])
    for seed in range(5):
        write_run(root, "zoac", seed, costs=(3.0 + 0.02 * seed + shape).tolist())
        write_run(root, "bo", seed, costs=(6.0 + 0.1 * seed + shape).tolist())
        write_run(root, "cmaes", seed, costs=(6.0 + 9.0 * (seed == 4) + shape).tolist())
    write_run(root, "nominal", 0, costs=(2.5 + shape).tolist(), gains=NOMINAL, evaluations=())
    return root
