"""The list of packages, by which the wheel is made, is the folders that there are."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_package_folder_is_in_the_list():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = set()
    for package, folder in setuptools["package-dir"].items():
        for init in (ROOT / folder).rglob("__init__.py"):
            parts = init.parent.relative_to(ROOT / folder).parts
            found.add(".".join([package, *parts]))
    assert sorted(setuptools["packages"]) == sorted(found)


def test_what_the_wheel_has_no_place_for_is_no_part_of_the_package():
    """A new top-level folder is either mapped into the wheel or one of these."""
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {init.parent.name for init in ROOT.glob("*/__init__.py")}
    left_out = {"tests", "benchmarks", "stress"}
    assert folders - left_out == set(setuptools["package-dir"].values())
