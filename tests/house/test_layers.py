"""Who may import whom, read from the source."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORE = {
    "errors", "seeding", "parameters", "environment", "recording", "segments", "rollout", "task",
    "tuner", "constraints", "acceptance_test", "initial_samples", "executor", "worker", "process", "evaluation",
    "lifeline",
    "checkpoint", "records", "runlog", "trainer",
}  # fmt: skip


def imports(path):
    """Return the dotted modules that a file imports at any level, type-checking blocks excepted."""
    tree = ast.parse(path.read_text())
    hidden = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def offenders(files, *forbidden):
    return [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files
        for name in imports(path)
        if any(name == f or name.startswith(f + ".") for f in forbidden)
    ]


def package(name):
    return sorted((ROOT / name).rglob("*.py"))


def core():
    return [ROOT / "zoac" / f"{name}.py" for name in sorted(CORE)]


OUTER = ("zoac.tasks", "zoac.baselines", "zoac.analysis")


@pytest.mark.parametrize(
    ("files", "forbidden"),
    [
        (core(), (*OUTER, "zoac.algorithm", "zoac.mpc", "zoac.api", "zoac.run", "torch", "pandas")),
        (package("zoac/algorithm"), (*OUTER, "zoac.mpc", "zoac.training.trainer")),
        (package("zoac/mpc"), (*OUTER, "zoac.algorithm", "torch")),
        (package("tasks"), ("zoac.baselines", "zoac.analysis", "zoac.algorithm", "torch")),
        (package("baselines"), ("zoac.tasks", "zoac.analysis", "zoac.mpc")),
        (
            package("analysis"),
            ("torch", "zoac.algorithm", "zoac.baselines", "zoac.training.trainer"),
        ),
    ],
    ids=["core", "algorithm", "mpc", "tasks", "baselines", "analysis"],
)
def test_import_rules(files, forbidden):
    assert files
    assert offenders(files, *forbidden) == []


def test_hydra_is_known_in_two_places():
    everything = [
        p for folder in ("zoac", "tasks", "baselines", "analysis") for p in package(folder)
    ]
    allowed = {ROOT / "zoac" / "run.py", ROOT / "zoac" / "config.py"}
    assert offenders([p for p in everything if p not in allowed], "hydra") == []


def test_solver_libraries_stay_inside_solvers():
    outside = [p for p in package("zoac") + package("tasks") if "solvers" not in p.parts]
    assert offenders(outside, "cvxpy", "clarabel") == []
