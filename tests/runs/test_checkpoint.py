import json
import pickle
from hashlib import sha256
from pathlib import Path

import pytest

from zoac.core.errors import RunFolderError, UnsavableError
from zoac.core.state import OwnObject
from zoac.runs import checkpoint


def test_what_is_saved_is_loaded(tmp_path):
    checkpoint.save(tmp_path, {"a": 1})
    assert checkpoint.load(tmp_path) == ({"a": 1}, [])


def test_nothing_saved_is_none(tmp_path):
    assert checkpoint.load(tmp_path) is None


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-3], lambda b: b[:-1] + b"x", lambda b: b"", lambda b: b"{}\n"]
)
@pytest.mark.parametrize("newer", ["newer", OwnObject("newer")])
def test_a_damaged_checkpoint_falls_back_to_the_previous_one_and_says_so(tmp_path, damage, newer):
    checkpoint.save(tmp_path, "older")
    checkpoint.save(tmp_path, newer)
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


def written(folder, body, **header):
    """Write a whole checkpoint with this body."""
    told = {"format": checkpoint.FORMAT, "sha256": sha256(body).hexdigest(), **header}
    (folder / checkpoint.CURRENT).write_bytes(json.dumps(told).encode() + b"\n" + body)


@pytest.mark.parametrize("version", [0, 1, "2", None, 99])
def test_another_format_is_refused_and_named_even_with_a_readable_previous_one(tmp_path, version):
    checkpoint.save(tmp_path, "older")
    checkpoint.save(tmp_path, "newer")
    written(tmp_path, pickle.dumps(1), format=version)
    with pytest.raises(RunFolderError, match="checkpoint format .*reads format 4.*resume=over"):
        checkpoint.load(tmp_path)


@pytest.mark.parametrize("header", [{}, {"plain": 3}, {"plain": None}])
def test_a_whole_one_that_says_something_else_is_refused_and_nothing_is_guessed(tmp_path, header):
    checkpoint.save(tmp_path, "older")
    checkpoint.save(tmp_path, "newer")
    written(tmp_path, pickle.dumps(1), **header)
    with pytest.raises(RunFolderError, match="not of these versions.*resume=overwrite"):
        checkpoint.load(tmp_path)


def test_a_save_that_fails_leaves_the_earlier_ones(tmp_path):
    checkpoint.save(tmp_path, "good")
    with pytest.raises(UnsavableError, match="the state is a builtins.generator"):
        checkpoint.save(tmp_path, (x for x in ()))
    with pytest.raises(TypeError, match="pickle"):
        checkpoint.save(tmp_path, OwnObject(x for x in ()))
    assert checkpoint.load(tmp_path) == ("good", [])


def touch(path):
    """Return an object whose pickle leaves a file when it is opened."""

    class Trap:
        def __reduce__(self):
            return Path.touch, (path,)

    return Trap()


def test_the_pickle_is_opened_when_an_object_is_used_and_not_before(tmp_path):
    checkpoint.save(tmp_path, {"number": 1, "own": OwnObject(touch(tmp_path / "trace"))})
    state, _ = checkpoint.load(tmp_path)
    assert state["number"] == 1
    assert not (tmp_path / "trace").exists()
    assert state["own"].value is None
    assert (tmp_path / "trace").exists()
