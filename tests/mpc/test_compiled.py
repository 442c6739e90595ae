"""What is said while Numba compiles."""

import numba

from zoac.mpc import compiled


def test_compiling_is_said_once_and_of_zoacs_functions_alone(monkeypatch, capsys):
    monkeypatch.setattr(compiled, "_said", set())
    said = []
    for module in ("mine", "zoac.a", "zoac.b"):

        def add(x):
            return x + 1

        add.__module__ = module
        numba.njit(add)(1)
        said.append(capsys.readouterr().err)
    assert (said[0], said[2]) == ("", "")
    assert said[1].startswith("compiling")
