"""Checkpoints: atomic, and protected against modification."""

import errno
import json
import os
import shutil

import numpy as np
import pytest

from baselines.learned import checkpoints
from baselines.learned.checkpoints import CheckpointError
from train.learn import checkpoint

TABLES = {
    "network": {"weight": np.arange(6, dtype=np.float32).reshape(2, 3)},
    "state": {
        "a/b": np.array([True, False]),
        "seed": np.array([2**63], dtype=np.uint64),
        "scalar": np.array(0.25),
    },
}


@pytest.fixture
def place(tmp_path):
    return checkpoint.write(tmp_path, 12, {"step": 12}, TABLES)


def test_checkpoint_round_trips(place, tmp_path):
    about, tables = checkpoints.read(place, TABLES)
    assert about["step"] == 12 and about["format_version"] == checkpoints.FORMAT_VERSION
    for name, arrays in TABLES.items():
        assert tables[name].keys() == arrays.keys()
        for key, array in arrays.items():
            np.testing.assert_array_equal(tables[name][key], array)
            assert tables[name][key].dtype == array.dtype
    assert checkpoints.find(tmp_path) == checkpoints.find(place) == place
    written = {path.name for path in place.iterdir()}
    assert written == {"checkpoint.json", "network.safetensors", "state.safetensors"}


def test_two_checkpoints_are_kept_and_pointer_is_newest(tmp_path):
    for step in (5, 40, 300):
        checkpoint.write(tmp_path, step, {"step": step}, TABLES)
    names = [path.name for path in checkpoints.candidates(tmp_path)]
    assert names == ["step-000000000300", "step-000000000040"]
    pointer = tmp_path / "checkpoints" / "latest.json"
    pointer.write_text(json.dumps({"checkpoint": names[1]}))
    assert checkpoints.find(tmp_path).name == names[1]
    pointer.write_text("{")
    assert checkpoints.find(tmp_path).name == names[0]


@pytest.mark.parametrize("when", ["fsync", "replace"])
def test_full_disk_keeps_last_checkpoint(place, tmp_path, monkeypatch, when):
    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, when, full)
    with pytest.raises(OSError, match="No space left"):
        checkpoint.write(tmp_path, 99, {"step": 99}, TABLES)
    monkeypatch.undo()
    assert checkpoints.find(tmp_path) == place
    assert checkpoints.read(place, TABLES)[0]["step"] == 12
    assert [path.name for path in place.parent.glob(".*.part")] == []


def test_leftovers_of_killed_write_are_removed(place, tmp_path):
    left = place.with_name(".step-000000000099.part")
    shutil.copytree(place, left)
    assert checkpoints.candidates(tmp_path) == [place]
    checkpoint.write(tmp_path, 100, {"step": 100}, TABLES)
    assert not left.exists()


NETWORK, DESCRIPTION = "network.safetensors", "checkpoint.json"


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (NETWORK, lambda c: c[:-3], r"network\.safetensors: has .* must have .* truncated"),
        (NETWORK, lambda c: c[:-1] + bytes([c[-1] ^ 1]), r"network\.safetensors: .* sha256 di"),
        (NETWORK, None, r"network\.safetensors: .* No such file"),
        (DESCRIPTION, lambda c: c.replace(b'"step": 12', b'"step": 13'),
         r"checkpoint\.json: its content was changed"),
        (DESCRIPTION, lambda c: json.dumps(json.loads(c) | {"format_version": 99}).encode(),
         "format_version is 99; this version reads 1"),
        *((DESCRIPTION, lambda _, said=said: said, r"checkpoint\.json: ")
          for said in (b"", b"{", b"[]", b"{}", b'"text"')),
    ],
)  # fmt: skip
def test_modified_checkpoint_is_rejected(place, file, change, message):
    if change is None:
        (place / file).unlink()
    else:
        (place / file).write_bytes(change((place / file).read_bytes()))
    with pytest.raises(CheckpointError, match=message):
        checkpoints.read(place, ["network"])


def test_missing_checkpoint_is_rejected(place, tmp_path, without_rights):
    with pytest.raises(CheckpointError, match="is not part of this checkpoint"):
        checkpoints.read(place, ["optimizer"])
    with pytest.raises(CheckpointError, match="no checkpoint in it"):
        checkpoints.find(place.parent)
    with pytest.raises(CheckpointError, match="no such"):
        checkpoints.find(tmp_path / "nothing")
    with without_rights(tmp_path), pytest.raises(CheckpointError, match="Permission denied"):
        checkpoints.find(tmp_path)
    with without_rights(place), pytest.raises(CheckpointError, match="Permission denied"):
        checkpoints.read(place, ["network"])
