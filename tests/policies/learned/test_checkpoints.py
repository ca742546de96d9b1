"""Checkpoints are whole or not there; nothing that was changed is read."""

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


def test_what_is_written_is_read(place, tmp_path):
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


def test_two_are_kept_and_the_pointer_names_the_newest(tmp_path):
    for step in (5, 40, 300):
        checkpoint.write(tmp_path, step, {"step": step}, TABLES)
    names = [path.name for path in checkpoints.candidates(tmp_path)]
    assert names == ["step-000000000300", "step-000000000040"]
    pointer = tmp_path / "checkpoints" / "latest.json"
    pointer.write_text(json.dumps({"checkpoint": names[1]}))
    assert checkpoints.find(tmp_path).name == names[1]
    pointer.write_text("{")
    assert checkpoints.find(tmp_path).name == names[0]


@pytest.mark.parametrize("when", ["fsync", "rename"])
def test_a_full_disk_leaves_the_last_one(place, tmp_path, monkeypatch, when):
    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, when, full)
    with pytest.raises(OSError, match="No space left"):
        checkpoint.write(tmp_path, 99, {"step": 99}, TABLES)
    monkeypatch.undo()
    assert checkpoints.find(tmp_path) == place
    assert checkpoints.read(place, TABLES)[0]["step"] == 12
    assert [path.name for path in place.parent.glob(".*.part")] == []


def test_what_a_kill_leaves_behind_goes_with_the_next(place, tmp_path):
    left = place.with_name(".step-000000000099.part")
    shutil.copytree(place, left)
    assert checkpoints.candidates(tmp_path) == [place]
    checkpoint.write(tmp_path, 100, {"step": 100}, TABLES)
    assert not left.exists()


class TestRefused:
    def refuses(self, place, *words):
        with pytest.raises(CheckpointError) as caught:
            checkpoints.read(place, ["network"])
        for word in words:
            assert word in str(caught.value)

    def test_truncated(self, place):
        file = place / "network.safetensors"
        file.write_bytes(file.read_bytes()[:-3])
        self.refuses(place, "network.safetensors", "truncated", "must have")

    def test_another_number(self, place):
        file = place / "network.safetensors"
        content = bytearray(file.read_bytes())
        content[-1] ^= 1
        file.write_bytes(content)
        self.refuses(place, "network.safetensors", "sha256 differs")

    def test_missing(self, place):
        (place / "network.safetensors").unlink()
        self.refuses(place, "network.safetensors", "No such file")

    def test_changed_description(self, place):
        path = place / "checkpoint.json"
        path.write_text(path.read_text().replace('"step": 12', '"step": 13'))
        self.refuses(place, "checkpoint.json", "its content was changed")

    @pytest.mark.parametrize("content", ["", "{", "[]", "{}", '"text"'])
    def test_no_description(self, place, content):
        (place / "checkpoint.json").write_text(content)
        self.refuses(place, "checkpoint.json")

    def test_another_version(self, place):
        path = place / "checkpoint.json"
        about = json.loads(path.read_text()) | {"format_version": 99}
        path.write_text(json.dumps(about))
        self.refuses(place, "format_version is 99", "reads 1")

    def test_no_such_table(self, place):
        with pytest.raises(CheckpointError, match="is not part of this checkpoint"):
            checkpoints.read(place, ["optimizer"])

    @pytest.mark.parametrize("there", [True, False])
    def test_no_checkpoint(self, tmp_path, there):
        folder = tmp_path if there else tmp_path / "nothing"
        with pytest.raises(CheckpointError, match="no checkpoint in it" if there else "no such"):
            checkpoints.find(folder)

    def test_no_permission(self, place, tmp_path, without_rights):
        with without_rights(tmp_path), pytest.raises(CheckpointError, match="Permission denied"):
            checkpoints.find(tmp_path)
        with without_rights(place), pytest.raises(CheckpointError, match="Permission denied"):
            checkpoints.read(place, ["network"])
