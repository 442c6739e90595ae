import json
import pickle
from hashlib import sha256
from pathlib import Path

import pytest

from zoac import checkpoint
from zoac.errors import RunFolderError


def test_what_is_saved_is_loaded(tmp_path):
    checkpoint.save(tmp_path, {"a": 1})
    assert checkpoint.load(tmp_path) == ({"a": 1}, [])


def test_nothing_saved_is_none(tmp_path):
    assert checkpoint.load(tmp_path) is None


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-3], lambda b: b[:-1] + b"x", lambda b: b"", lambda b: b"{}\n"]
)
def test_a_damaged_checkpoint_falls_back_to_the_previous_one_and_says_so(tmp_path, damage):
    checkpoint.save(tmp_path, "older")
    checkpoint.save(tmp_path, "newer")
    path = tmp_path / checkpoint.CURRENT
    path.write_bytes(damage(path.read_bytes()))
    state, complaints = checkpoint.load(tmp_path)
    assert state == "older"
    assert str(path) in complaints[0]


def test_one_that_the_system_does_not_give_out_counts_as_damaged(tmp_path):
    checkpoint.save(tmp_path, "older")
    checkpoint.save(tmp_path, "newer")
    (tmp_path / checkpoint.CURRENT).unlink()
    (tmp_path / checkpoint.CURRENT).mkdir()
    state, complaints = checkpoint.load(tmp_path)
    assert state == "older"
    assert "cannot be read" in complaints[0]


def test_when_none_can_be_read_the_user_is_told(tmp_path):
    checkpoint.save(tmp_path, 1)
    (tmp_path / checkpoint.CURRENT).write_bytes(b"rubbish")
    with pytest.raises(RunFolderError, match="no checkpoint can be read.*resume=overwrite"):
        checkpoint.load(tmp_path)


def test_another_format_is_refused_by_name(tmp_path):
    body = pickle.dumps(1)
    (tmp_path / checkpoint.CURRENT).write_bytes(b'{"format": 99, "sha256": ""}\n' + body)
    with pytest.raises(RunFolderError, match="checkpoint format 99; .* reads format 1"):
        checkpoint.load(tmp_path)


def test_a_whole_one_of_other_packages_is_refused_and_nothing_is_guessed(tmp_path):
    checkpoint.save(tmp_path, "older")
    body = pickle.dumps(Path()).replace(b"pathlib", b"gonelib")
    header = json.dumps({"format": checkpoint.FORMAT, "sha256": sha256(body).hexdigest()})
    checkpoint.save(tmp_path, "newer")
    (tmp_path / checkpoint.CURRENT).write_bytes(header.encode() + b"\n" + body)
    with pytest.raises(RunFolderError, match="not of these versions.*gonelib.*resume=overwrite"):
        checkpoint.load(tmp_path)


def test_a_save_that_fails_leaves_the_earlier_ones(tmp_path):
    checkpoint.save(tmp_path, "good")
    with pytest.raises(TypeError):
        checkpoint.save(tmp_path, (x for x in ()))
    assert checkpoint.load(tmp_path) == ("good", [])
