"""What `run.json` keeps of code and machine."""

import subprocess
from pathlib import Path

import pytest

from zoac.runs import provenance

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no clone")
def test_the_commit_is_that_of_the_clone():
    head = subprocess.run(["git", "-C", str(ROOT), "rev-parse", "HEAD"], check=True,
                          capture_output=True, text=True).stdout.strip()  # fmt: skip
    assert provenance.commit() in (head, f"{head}+")
