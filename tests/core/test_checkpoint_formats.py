"""Checkpoints of earlier versions are read, or refused by name; the files stay as they are."""

import shutil
from pathlib import Path

import pytest

from zoac import checkpoint
from zoac.errors import RunFolderError

FILES = Path(__file__).parent / "checkpoints"


def test_a_file_of_format_1_is_read(tmp_path):
    shutil.copy(FILES / "format-1.ckpt", tmp_path / checkpoint.CURRENT)
    state, complaints = checkpoint.load(tmp_path)
    assert state == {"progress": {"iteration": 3}, "tuner": b"\x00\x01", "lanes": {0: [1.5]}}
    assert complaints == []


@pytest.mark.parametrize("version", [b"0", b"2", b'"1"', b"null"])
def test_any_other_format_is_refused_by_name_even_with_a_readable_previous_one(tmp_path, version):
    whole = (FILES / "format-1.ckpt").read_bytes()
    (tmp_path / checkpoint.PREVIOUS).write_bytes(whole)
    other = whole.replace(b'"format": 1', b'"format": ' + version, 1)
    (tmp_path / checkpoint.CURRENT).write_bytes(other)
    with pytest.raises(RunFolderError, match="checkpoint format .*reads format 1.*resume=over"):
        checkpoint.load(tmp_path)
