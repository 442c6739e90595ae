"""Every bad input of the table gets one clear message."""

import errno
import functools
from pathlib import Path

import pytest

from stress import bad_inputs

PAGE = Path(__file__).parents[2] / "docs" / "errors.md"


message = functools.cache(bad_inputs.message)


@pytest.mark.parametrize(
    "case", bad_inputs.CASES, ids=[f"{c.typed[:50]} {c.after}".strip() for c in bad_inputs.CASES]
)
def test_a_bad_input_gets_one_message_that_names_it_and_what_is_valid(case):
    code, text = message(case)
    assert code in (1, 2)
    assert "Traceback" not in text
    assert text.count("\n") < 24
    assert len(text) < 1900  # a screen of 24 lines of 80
    for part in case.says:
        assert part in text


def test_the_documented_messages_are_those_that_are_given():
    page = PAGE.read_text()
    told = [
        bad_inputs.without_lists(message(case)[1]) for case in bad_inputs.CASES if not case.varies
    ]
    missing = [text for text in told if text not in page]
    assert missing == [], "python -m stress.bad_inputs > docs/errors.md"


def test_a_folder_without_permission_is_named(tmp_path, monkeypatch):
    mkdir = Path.mkdir

    def refused(path, *arguments, **options):
        if path.is_relative_to(tmp_path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        mkdir(path, *arguments, **options)

    # Not by the folder's mode: root may write anywhere.
    monkeypatch.setattr(Path, "mkdir", refused)
    code, text = bad_inputs.message(bad_inputs.Case(f"runs_dir={tmp_path}", ()))
    assert code == 1
    assert "Permission denied; choose another runs_dir" in text
