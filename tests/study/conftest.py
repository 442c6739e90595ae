"""A study of a test need not outlast a power cut: it waits for no disk."""

import os

import pytest


@pytest.fixture(autouse=True)
def synchronised(monkeypatch):
    """Return the list of the files that were written to the disk, by descriptor."""
    files = []
    monkeypatch.setattr(os, "fsync", files.append)
    return files
