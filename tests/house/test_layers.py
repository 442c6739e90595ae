"""Who may import whom, read from the source of every module."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SUBPACKAGES = ("tasks", "baselines", "analysis")
"""Folders at the root that are imported as zoac.<name>."""

LAYERS = (
    ("core",),
    ("specs",),
    ("envs", "mpc"),
    ("controllers",),
    ("rollout",),
    ("rollout.executors",),
    ("algorithm.strategies", "runs.loggers"),
    ("algorithm",),
    ("baselines",),
    ("config",),
    ("tasks", "runs"),
    ("runs.training",),
    ("run.help", "run.pipes", "run.sweep_table"),
    ("run.sweep_report",),
    ("check", "search", "study"),
    ("run",),
    ("pid",),
)
"""From the lowest to the highest; a module imports from its own row's name and from lower layers.

A package or module inside another has a layer of its own where it is named.
"""

HEAVY = ("torch", "zoac.algorithm", "zoac.baselines", "zoac.envs", "zoac.rollout")


def sources():
    """Return {dotted module: path} of everything below zoac."""
    found = {}
    for folder in ("zoac", *SUBPACKAGES):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            parts = parts if parts[0] == "zoac" else ("zoac", *parts)
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = sources()


@cache
def parsed(module):
    """Return the syntax tree of a module, for all tests to read."""
    return ast.parse(MODULES[module].read_text())


def of_type_checkers(tree):
    """Return the ids of the nodes that only type checkers see."""
    return {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }


def in_functions(tree):
    """Return the ids of the nodes that stand in functions."""
    return {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        for inner in ast.walk(node)
    }


@cache
def imports(module, at_load=False, for_types=True):
    """Return the dotted names that a module imports.

    With `at_load` those in functions are left out, without `for_types` those of type checkers.
    """
    tree = parsed(module)
    hidden = in_functions(tree) if at_load else set()
    hidden |= set() if for_types else of_type_checkers(tree)
    names = set()
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            own = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
            source = f"{own}.{node.module or ''}".rstrip(".") if node.level else node.module
            names.add(source)
            names |= {f"{source}.{alias.name}" for alias in node.names}
    return frozenset(names)


def reached(module):
    """Return every name that loading a module imports, directly or through others of zoac."""
    seen, ahead = set(), [module]
    while ahead:
        for name in imports(ahead.pop(), at_load=True, for_types=False):
            if name not in seen:
                seen.add(name)
                ahead += [name] if name in MODULES else []
    return seen


def package_of(module):
    """Return the longest name of `LAYERS` that holds a module, else its package at the top."""
    parts = module.split(".")[1:]
    names = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
    return next((name for name in names if layer_of(name) is not None), "".join(parts[:1]))


def layer_of(package):
    return next((i for i, layer in enumerate(LAYERS) if package in layer), None)


def offenders(modules, *forbidden):
    return [
        f"{module}: {name}"
        for module in modules
        for name in sorted(imports(module))
        if any(name == f or name.startswith(f + ".") for f in forbidden)
    ]


def test_every_module_stands_in_a_layer():
    packages = {package_of(m) for m in MODULES} - {"", "analysis"}
    assert {p for p in packages if layer_of(p) is None} == set()


def test_imports_run_downwards():
    upwards = [
        f"{module}: {name}"
        for module in MODULES
        if (own := package_of(module)) not in ("", "analysis")
        for name in imports(module)
        if name in MODULES
        and not module.startswith(f"{name}.")  # a package that holds it
        and (package := package_of(name))
        and package != own
        and not (layer_of(package) is not None and layer_of(package) < layer_of(own))
    ]
    assert upwards == []


def test_no_module_needs_itself():
    """Neither while it is loaded nor for its types; a package's face may name what it holds."""
    needs = {
        module: [
            name
            for name in imports(module, at_load=True)
            if name in MODULES and not f"{module}.".startswith(f"{name}.")
        ]
        for module in MODULES
    }
    TopologicalSorter(needs).prepare()  # raises with the circle, if there is one


def test_nothing_below_the_analysis_imports_it():
    others = [m for m in MODULES if package_of(m) != "analysis"]
    assert offenders(others, "zoac.analysis") == []


@pytest.mark.parametrize("command", ["table2", "beyond", "compact"])
def test_a_table_needs_neither_torch_nor_an_environment(command):
    loaded = reached(f"zoac.analysis.{command}")
    heavy = [n for n in loaded if any(n == h or n.startswith(h + ".") for h in HEAVY)]
    assert heavy == []


def test_hydra_is_known_to_the_configuration_and_its_command_line():
    allowed = [m for m in MODULES if package_of(m) == "config" or m == "zoac.run.command"]
    assert offenders([m for m in MODULES if m not in allowed], "hydra") == []


def test_torch_is_known_to_the_algorithm_and_botorch_alone():
    others = [m for m in MODULES if package_of(m) not in ("algorithm", "runs.loggers")]
    others.remove("zoac.baselines.extras.botorch")
    assert offenders(others, "torch") == []


def test_solver_libraries_are_known_to_the_solvers_alone():
    outside = [m for m in MODULES if not m.startswith("zoac.mpc.")]
    assert offenders(outside, "cvxpy", "clarabel") == []


def test_riccati_needs_numpy_and_numba_alone():
    own = [m for m in MODULES if m.startswith("zoac.mpc.riccati")]
    assert own
    allowed = ("numpy", "numba", "llvmlite", "zoac.mpc.riccati", "__future__")
    standard = set(__import__("sys").stdlib_module_names)
    outside = [
        f"{module}: {name}"
        for module in own
        for name in imports(module)
        if name.split(".")[0] not in standard
        and not any(name == a or name.startswith(a + ".") for a in allowed)
    ]
    assert outside == []


def test_the_top_has_few_names_and_packages_are_small():
    top = {m.split(".")[1] for m in MODULES if "." in m}
    assert len(top - {*SUBPACKAGES}) <= 14
    packages = {path.parent for path in MODULES.values()} - {ROOT / "zoac"}
    sizes = {p: len([f for f in p.glob("*.py") if f.name != "__init__.py"]) for p in packages}
    # A task is as large as its plant; a package of packages holds what they share.
    own = {p: n for p, n in sizes.items() if ROOT / "tasks" not in (p, *p.parents)}
    assert {str(p): n for p, n in own.items() if n > 9 or n < 2} == {}


def test_no_file_has_more_than_300_lines():
    lengths = {name: len(path.read_text().splitlines()) for name, path in MODULES.items()}
    assert {name: n for name, n in lengths.items() if n > 300} == {}
