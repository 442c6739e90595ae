"""What all tests share."""

import tempfile

import pytest


@pytest.fixture(autouse=True)
def temporary_folders_end_with_the_test(tmp_path, monkeypatch):
    """`zoac.tune` without a folder makes one of its own, which is the user's to keep."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
