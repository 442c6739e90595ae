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


def test_what_the_bits_depend_on_is_compared():
    here = provenance.here_and_now()
    assert provenance.differences(here, here) == []
    older = {**here, "versions": {**here["versions"], "numpy": "1.0"}, "started": "long ago"}
    assert provenance.differences(older, here) == [
        f"numpy {here['versions']['numpy']}, at first 1.0"
    ]
