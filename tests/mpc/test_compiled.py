"""What is said while Numba compiles."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

TWO_OF_ZOAC_AND_ONE_OF_A_USER = """
import numba
import zoac.mpc.compiled

for module in ("mine", "zoac.a", "zoac.b"):
    def add(x):
        return x + 1
    add.__module__ = module
    print(module, flush=True)
    numba.njit(add)(1)
"""


def test_compiling_is_said_once_and_of_zoacs_functions_alone():
    done = subprocess.run(
        [sys.executable, "-c", TWO_OF_ZOAC_AND_ONE_OF_A_USER],
        cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=True,
    )  # fmt: skip
    first, second, told, last = done.stdout.splitlines()
    assert [first, second, last] == ["mine", "zoac.a", "zoac.b"]
    assert told.startswith("compiling")
