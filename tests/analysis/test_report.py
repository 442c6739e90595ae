from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.analysis.folders import write_run
from zoac.analysis import compact
from zoac.analysis.report import main

VOID = {"meta", "br", "link", "img"}


def page(root: Path, out: Path, *options: str) -> str:
    assert main([str(root), "--out", str(out), *options]) == 0
    return (out / "report.html").read_text()


class Tags(HTMLParser):
    """Counts ids and checks that tags close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: Counter[str] = Counter()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids.update(value for name, value in attrs if name == "id" and value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids.update(value for name, value in attrs if name == "id" and value)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    root = tmp_path_factory.mktemp("runs")
    for seed in range(2):
        write_run(root, "zoac", seed, gains={"k": 2.0, "Kp": 1.0, "Ki": 0.0, "Kd": 3.0})
    write_run(root, "nominal", evaluations=())
    write_run(root, "bo", finished=False)
    return page(root, tmp_path_factory.mktemp("out"))


def test_the_page_fetches_nothing(text: str) -> None:
    assert not re.search(r"<(script|link|iframe|img)\b", text)
    assert not re.search(r"""(src|href)=["'](?!#)|url\((?!#)|@import""", text)


def test_the_page_is_well_formed_and_its_ids_are_unique(text: str) -> None:
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert [name for name, times in tags.ids.items() if times > 1] == []


def test_references_within_pictures_lead_somewhere(text: str) -> None:
    wanted = set(re.findall(r"url\(#([^)]*)\)", text)) | set(re.findall(r'href="#([^"]*)"', text))
    assert wanted
    assert wanted <= set(re.findall(r' id="([^"]*)"', text))


def test_gains_stand_before_and_after_within_their_bounds(text: str) -> None:
    (line,) = [line for line in text.split("\n") if line.startswith("<tr><td>Kp")]
    cells = re.findall(r"<td>(.*?)</td>", line)
    assert cells[:5] == ["Kp", "1.05", "0.8307", "1", "0"]
    assert 'class="after" style="left:10.0%"' in line


def test_a_gain_at_its_bound_is_pointed_out(text: str) -> None:
    assert "At a bound: Ki (low)." in text


def test_what_the_user_wrote_is_escaped(text: str) -> None:
    assert "uniform &lt;from the seed&gt;" in text


def test_an_unfinished_run_is_named(text: str) -> None:
    assert "unfinished, 500 of 1000 environment steps" in text


def test_how_to_reproduce_is_a_command(text: str) -> None:
    assert "<pre>python -m zoac.run task=pid_acc tuner=zoac seed=0</pre>" in text


def test_one_run_is_enough(tmp_path: Path) -> None:
    text = page(write_run(tmp_path), tmp_path / "out")
    assert "Comparison" not in text
    assert "ZOAC, seed 0" in text


def test_a_task_that_cannot_be_rebuilt_costs_only_the_closed_loop(tmp_path: Path) -> None:
    folder = write_run(tmp_path, config={"task": {"_target_": "nowhere.Task"}})
    assert "its task cannot be built again" in page(folder, tmp_path / "out", "--trust-code")


def test_the_same_runs_give_the_same_page(tmp_path: Path) -> None:
    write_run(tmp_path / "runs")
    pages = [page(tmp_path / "runs", tmp_path / out) for out in ("a", "b")]
    assert pages[0] == pages[1]


def test_no_finished_run_is_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path, finished=False)
    assert main([str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.endswith(
        "error: no finished run among 1; relaunching an unfinished one resumes it\n"
    )


def test_commands_start_without_torch() -> None:
    modules = ("table2", "curves", "landscape", "trajectories", "report")
    imports = "; ".join(f"import zoac.analysis.{name}" for name in modules)
    code = f"import sys; {imports}; print('torch' in sys.modules, 'hydra' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"


def test_terminations_while_tuning_are_those_of_the_result(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "runs", result={"tuning_terminations": 224})
    small = tmp_path / "small"
    assert compact.main([str(folder), "--out", str(small)]) == 0
    for root in (folder, small):
        text = page(root, tmp_path / "out", "--no-replay")
        assert "episodes that ended early while tuning: 224<" in text
