"""Four ways to have the package: each answers --help and finds its configuration."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = (
    "zoac", "conf", "tasks", "baselines", "analysis", "pyproject.toml", "README.md", "LICENSE",
)  # fmt: skip


def run(*command, cwd, **environment):
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=cwd, env={**env, **environment}, capture_output=True, text=True, timeout=300
    )


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A copy of the sources, as a fresh clone would have them."""
    folder = tmp_path_factory.mktemp("ways") / "clone"
    folder.mkdir()
    skip = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=skip)
        else:
            shutil.copy(source, folder / name)
    return folder


@pytest.fixture
def empty_python(tmp_path_factory):
    """A Python with all dependencies and no zoac."""
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, with_pip=False)
    (packages,) = folder.glob("lib/*/site-packages")
    dependencies = packages / "dependencies"
    dependencies.mkdir()
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if "zoac" not in entry.name:
            (dependencies / entry.name).symlink_to(entry)
    (packages / "dependencies.pth").write_text(str(dependencies))
    return folder / "bin" / "python"


BUILD = """
from setuptools import build_meta
for kind in ("wheel", "editable"):
    getattr(build_meta, f"build_{kind}")(f"../{kind}")
"""


@pytest.fixture(scope="module")
def built(clone):
    """The wheels that setuptools makes for pip, without and with `--editable`."""
    done = run(sys.executable, "-c", BUILD, cwd=clone)
    assert done.returncode == 0, done.stderr
    kinds = ("wheel", "editable")
    return {kind: zipfile.ZipFile(*(clone.parent / kind).glob("*.whl")) for kind in kinds}


def install(wheel, python):
    """Do as pip does with a wheel."""
    wheel.extractall(*python.parents[1].glob("lib/*/site-packages"))


USE = """
import contextlib, runpy, sys
sys.argv[1:] = ["--help"]
with contextlib.suppress(SystemExit):
    runpy.run_module("zoac.run", run_name="__main__", alter_sys=True)
import gymnasium, zoac.baselines, zoac.analysis, zoac.tasks.pendulum.plant
gymnasium.spec('zoac/PidAcc-v0')
sys.argv[1:] = ["task=pidacc"]
runpy.run_module("zoac.run", run_name="__main__", alter_sys=True)
"""


def answers(python, cwd):
    """Check --help, and that config, subpackages and a user's error work."""
    done = run(str(python), "-c", USE, cwd=cwd)
    assert "pid_acc" in done.stdout
    assert done.stderr.startswith("error: unknown task 'pidacc'; did you mean 'pid_acc'")


def test_dependencies_only_in_a_clone(clone, empty_python):
    answers(empty_python, cwd=clone)


def test_editable_from_anywhere(built, empty_python, tmp_path):
    install(built["editable"], empty_python)
    answers(empty_python, cwd=tmp_path)


def test_wheel_outside_and_inside_a_clone(built, clone, empty_python, tmp_path):
    install(built["wheel"], empty_python)
    answers(empty_python, cwd=tmp_path)
    answers(empty_python, cwd=clone)


def test_the_wheel_holds_nothing_outside_zoac(built):
    names = built["wheel"].namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"zoac"}
    assert "zoac/conf/run.yaml" in names
    assert "zoac/conf/task/pid_acc.yaml" in names
