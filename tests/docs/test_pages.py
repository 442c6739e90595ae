"""Every Python block of every page runs, in the order of the page; the site builds strictly."""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mkdocs.commands.build import build
from mkdocs.config import load_config

import zoac
from tests.analysis.folders import write_run
from tests.docs import options
from zoac.pid import tuning

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = {
    path.name: BLOCK.findall(path.read_text()) for path in sorted((ROOT / "docs").glob("*.md"))
}
QUICK = {"budget": 200, "num_envs": 2, "episodes": 1, "final_episodes": 1, "eval_every": 200,
         "quiet": True}  # fmt: skip

STEPS = 20
"""Of an episode."""


def quick(options):
    if "cost" in options:
        return {**options, "experiments": min(options["experiments"], 4)}
    options = {k: v for k, v in options.items() if k != "experiments"} | QUICK
    if isinstance(options.get("task"), str):
        return {**options, "task": zoac.make_task(options["task"])}
    return {**options, "max_episode_steps": min(options.get("max_episode_steps", STEPS), STEPS)}


def blocks(page, language):
    return [text for kind, text in PAGES[page] if kind == language]


def test_the_first_page_has_the_example_of_the_readme():
    """`tests/run/test_readme.py` runs it."""
    readme = BLOCK.findall((ROOT / "README.md").read_text())
    for language in ("python", "text"):
        (block,) = blocks("index.md", language)
        assert block == next(text for kind, text in readme if kind == language)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page, "python") and page != "index.md"]
)
def test_its_python_runs(page, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    tune, make_task = zoac.tune, zoac.make_task
    monkeypatch.setattr(zoac, "tune", lambda **options: tune(**quick(options)))
    monkeypatch.setattr(zoac, "make_task", lambda name: make_task(name, max_episode_steps=STEPS))
    monkeypatch.setattr(tuning, "EPISODES", 24)
    monkeypatch.setattr(tuning, "EPISODES_IN_ENVIRONMENT", 24)
    for text in blocks(page, "py"):  # files, called as their first line says
        Path(text.partition("\n")[0].removeprefix("# ")).write_text(text)
    write_run(tmp_path / "runs")  # for pages that read what is there
    names = {"__name__": "__main__"}
    for number, text in enumerate(blocks(page, "python")):
        exec(compile(text, f"docs/{page}, Python block {number + 1}", "exec"), names)


@pytest.mark.parametrize("page", PAGES)
def test_the_modules_and_files_that_its_commands_name_exist(page):
    for text in blocks(page, "bash"):
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words[:2] == ["python", "-m"]:
                assert importlib.util.find_spec(words[2]), line
            elif words[:1] == ["python"]:
                assert (ROOT / words[1]).is_file(), line


def test_the_shell_script_at_the_rig_runs(tmp_path):
    (tmp_path / "space.yaml").write_text(*blocks("rig.md", "yaml"))
    experiment = tmp_path / "experiment"
    experiment.write_text("#!/bin/sh\ngrep -q '\"number\": 1' && exit 7\necho 3.5\n")
    experiment.chmod(0o755)
    python = f'python() {{ "{sys.executable}" "$@"; }}\n'
    (script,) = blocks("rig.md", "sh")
    assert len(script.splitlines()) < 40
    script = python + script.replace("60", "2")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, env=environment,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr
    *_, best, exported = map(json.loads, done.stdout.splitlines())
    assert (best["number"], best["cost"]) == (2, 3.5)
    assert exported == {"file": "gains.h"}
    assert "/* N/m */" in (tmp_path / "gains.h").read_text()
    states = [trial.reason for trial in zoac.Study(folder=tmp_path / "bench").trials]
    assert states == ["exit status 7", None]


def test_the_yaml_of_the_guide_is_the_examples():
    (block,) = blocks("tune_your_own.md", "yaml")
    example = yaml.safe_load((ROOT / "examples/own_task/conf/task/tank.yaml").read_text())
    assert yaml.safe_load(block) == example


def test_the_table_of_options_is_what_the_code_says():
    """Otherwise: python -m tests.docs.options > docs/options.md."""
    assert (ROOT / "docs" / "options.md").read_text() == options.main() + "\n"


GENERATED = ("errors.md", "options.md")
TEXTS = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *ROOT.glob("zoac/**/*.md")]


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_lines_fit_100_columns(path):
    lines = path.read_text().splitlines() if path.name not in GENERATED else []
    # A row of a table cannot be wrapped, and an address cannot be cut.
    free = [line for line in lines if not line.startswith("|") and "](http" not in line]
    assert [line for line in free if len(line) > 100] == []


def test_every_page_is_in_the_navigation():
    named = re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2])
    assert sorted(named) == sorted(PAGES)


def test_the_site_builds_strictly(tmp_path):
    """Without what takes half of the time and follows no link: search, and laying out calls."""
    _, docstrings = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["plugins"]
    docstrings["mkdocstrings"]["handlers"]["python"]["options"]["separate_signature"] = False
    build(load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(tmp_path),
                      plugins=[docstrings]))  # fmt: skip
    assert (tmp_path / "api" / "index.html").read_text().count("zoac.run.api.tune")
