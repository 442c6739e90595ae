"""What all tests share."""

import tempfile

import pytest
from hypothesis import settings

# A busy machine is no reason to fail, nor is the first call of what is compiled.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(autouse=True)
def temporary_folders_end_with_the_test(tmp_path, monkeypatch):
    """`zoac.tune` without a folder makes one of its own, which is the user's to keep."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
