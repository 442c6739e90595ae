"""The package stands by itself: alone, from plain arrays, with nothing but NumPy and numba."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.riccati.oracle import solve_condensed
from tests.riccati.problems import quadrotors
from zoac.mpc import problem, riccati

FOLDER = Path(riccati.__file__).parent
EXAMPLE = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(), re.S)[0]
ALLOWED = {"numpy", "numba", "llvmlite", *sys.stdlib_module_names}  # numba brings llvmlite


def test_its_files_import_numpy_numba_and_one_another() -> None:
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [str(node.module)]
            elif isinstance(node, ast.ImportFrom):
                names = []
                assert node.level == 1, path
            else:
                continue
            assert {name.partition(".")[0] for name in names} <= ALLOWED, path


def test_an_edit_to_any_of_its_files_compiles_anew() -> None:
    kernel = sys.modules[f"{riccati.__name__}.kernel"]
    assert {path.name for path in kernel.SOURCE_FILES} == {p.name for p in FOLDER.glob("*.py")}


def test_its_status_numbers_are_those_of_every_solver() -> None:
    """Its own constraints can always be kept, so that it never says that no plan exists."""
    of_all = {s.name: s.value for s in problem.Status if s.name != "INFEASIBLE"}
    assert {s.name: s.value for s in riccati.Status} == of_all


def test_plain_arrays_give_the_plans_of_an_independent_solver() -> None:
    about = quadrotors(25, 8, 2)
    moved = np.einsum("nkij,nkj->nki", about.a, about.states[:, :-1])
    moved += np.einsum("nkij,nkj->nki", about.b, about.inputs)
    plans, status, _ = riccati.solve(
        about.states[:, 0],
        about.a,
        about.b,
        about.states[:, 1:] - moved,
        about.state_weights,
        about.input_weights,
        about.input_low,
        about.input_high,
        reference=about.reference,
    )
    np.testing.assert_array_equal(status, riccati.Status.SOLVED)
    for lane, plan in enumerate(plans):
        np.testing.assert_allclose(plan, solve_condensed(about, lane), rtol=0, atol=1e-7)


# Packages of these names, without zoac's own modules: what is compiled on disk is of this name.
ALONE = """
import sys, types

for name in ("zoac", "zoac.mpc"):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = ["."]
"""
NOTHING_ELSE = """
loaded = {name for name in sys.modules if name.partition(".")[0] == "zoac"}
own = {name for name in loaded if name.startswith("zoac.mpc.riccati")}
assert own and loaded - own == {"zoac", "zoac.mpc"}
"""
KEEP = "\nplans.tofile('plans')\n"
OTHER_NAME = "import sys\nsys.modules['zoac'] = None\nimport riccati\nassert riccati.solve"


def test_alone_in_a_folder_it_runs_the_example_without_zoac_to_the_same_bits(
    tmp_path: Path,
) -> None:
    """The test above has compiled this size; under another name it would be compiled again."""
    (tmp_path / "riccati").symlink_to(FOLDER)
    script = ALONE + EXAMPLE + KEEP + NOTHING_ELSE + OTHER_NAME
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=300)
    exec(EXAMPLE, here := {})
    np.testing.assert_array_equal(np.fromfile(tmp_path / "plans"), here["plans"].ravel())


def arrays(**changes: object) -> dict[str, object]:
    n, horizon, nx, nu = 2, 3, 6, 2
    sound = {
        "initial_states": np.ones((n, nx)),
        "a": np.zeros((n, horizon, nx, nx)),
        "b": np.ones((n, horizon, nx, nu)),
        "c": np.zeros((n, horizon, nx)),
        "state_weights": np.ones((n, horizon, nx)),
        "input_weights": np.ones((n, horizon, nu)),
        "input_low": [-1.0, -1.0],
        "input_high": [1.0, 1.0],
    }
    return {**sound, **changes}


@pytest.mark.parametrize("name", arrays())
def test_arrays_that_do_not_fit_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=rf"expected .*{name}.*got"):
        riccati.solve(**arrays(**{name: np.ones((2, 2))}))


def test_bounds_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="input bounds must be numbers in order"):
        riccati.solve(**arrays(input_low=[-1.0, 2.0]))


def test_data_that_are_not_finite_have_a_status() -> None:
    starts = np.ones((2, 6))
    starts[1, 2] = np.inf
    status = riccati.solve(**arrays(initial_states=starts)).status
    assert status.tolist() == [riccati.Status.SOLVED, riccati.Status.NOT_FINITE]
