"""Checkpoints: a folder of safetensors and one JSON file, whole or not there at all. No pickle.

RUN/checkpoints/step-000001234567 holds checkpoint.json, which says what the checkpoint is and what
the digests of its other files are, and network.safetensors, optimizer.safetensors and so on.
RUN/checkpoints/latest.json names the newest one.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import results
from ..checks import check_types

FORMAT_VERSION = 1
DESCRIPTION = "checkpoint.json"
KEPT = 2
"""Checkpoints of a run that stay on disk."""
_FOLDER, _POINTER = "checkpoints", "latest.json"

Tables = Mapping[str, Mapping[str, NDArray[Any]]]


class CheckpointError(ValueError):
    """A checkpoint cannot be read; the message names the file and what would be right."""


# ---- write --------------------------------------------------------------------------------------


def write(run: Path, step: int, description: Mapping[str, Any], tables: Tables) -> Path:
    """Write a checkpoint of a run and remove those that are no longer needed.

    Args:
        run: its folder.
        step: by which the checkpoint is called.
        description: plain data.
        tables: named arrays for each file, without the suffix.

    Raises:
        OSError: if it cannot be written; older checkpoints are as they were.
    """
    folder = run / _FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / f"step-{step:012d}"
    write_folder(place, description, tables)
    results.write_json(folder / _POINTER, {"checkpoint": place.name})
    _sync(folder)
    for old in sorted(folder.glob("step-*"))[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return place


def write_folder(place: Path, description: Mapping[str, Any], tables: Tables) -> None:
    """Write one checkpoint under a temporary name and rename it; one that stands there goes.

    Raises:
        OSError: if it cannot be written; nothing has changed then.
    """
    from safetensors.numpy import save

    for left in place.parent.glob(".*.part"):
        shutil.rmtree(left, ignore_errors=True)
    temporary, replaced = (place.with_name(f".{place.name}{end}.part") for end in ("", ".old"))
    try:
        temporary.mkdir()
        files = {}
        for name, arrays in tables.items():
            content = save({key: np.ascontiguousarray(value) for key, value in arrays.items()})
            files[f"{name}.safetensors"] = _entry(content)
            _write(temporary / f"{name}.safetensors", content)
        about = {"format_version": FORMAT_VERSION, **description, "files": files}
        about["sha256"] = _digest(about)
        _write(temporary / DESCRIPTION, (json.dumps(about, indent=2) + "\n").encode())
        _sync(temporary)
        if place.exists():  # never a moment without either
            place.rename(replaced)
        temporary.rename(place)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(replaced, ignore_errors=True)


def _entry(content: bytes) -> dict[str, Any]:
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Make names that were given in a folder outlast a power failure."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _digest(description: Mapping[str, Any]) -> str:
    content = {key: value for key, value in description.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


# ---- find ---------------------------------------------------------------------------------------


def find(path: Path) -> Path:
    """The checkpoint that a path means: the folder itself, or the newest one of a run.

    Raises:
        CheckpointError: if there is none, or the folder cannot be read.
    """
    found = [path] if DESCRIPTION in _names(path) else candidates(path)
    if not found:
        there = "no checkpoint in it" if path.is_dir() else "no such folder"
        raise CheckpointError(
            f"{path}: {there}; give the folder of a run of `rendezvous train`, or of a checkpoint"
        )
    return found[0]


def candidates(run: Path) -> list[Path]:
    """All checkpoints of a run, the one that its pointer names first, then the newest.

    Raises:
        CheckpointError: if the folder cannot be read.
    """
    folder = run / _FOLDER
    found = sorted((name for name in _names(folder) if name.startswith("step-")), reverse=True)
    try:
        named = results.read_json(folder / _POINTER)["checkpoint"]
    except (OSError, ValueError, LookupError, TypeError):  # the newest one, then
        named = None
    return [folder / name for name in sorted(found, key=lambda name: name != named)]


def _names(folder: Path) -> list[str]:
    """Names in a folder; none if it does not exist."""
    try:
        return os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise CheckpointError(f"{folder}: cannot be read: {_reason(error)}") from error


# ---- read ---------------------------------------------------------------------------------------


def describe(place: Path) -> dict[str, Any]:
    """The description of a checkpoint, which is checked against its own digest.

    Raises:
        CheckpointError: if it cannot be read, was changed, or is of another version.
    """
    path = place / DESCRIPTION
    try:
        about = results.read_json(path)
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path}: cannot be read: {_reason(error)}") from error
    version = about.get("format_version") if isinstance(about, dict) else None
    if version != FORMAT_VERSION:
        raise CheckpointError(
            f"{path}: format_version is {version!r}; this version reads {FORMAT_VERSION}"
        )
    if about.get("sha256") != _digest(about):
        raise CheckpointError(f"{path}: its content was changed: the digest in it does not fit")
    try:
        check_types({"files": about.get("files")}, {"files": dict[str, dict[str, Any]]})
    except ValueError as error:
        raise CheckpointError(f"{path}: {error}") from error
    return about


def read(place: Path, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The description of a checkpoint and the arrays of some of its files.

    Raises:
        CheckpointError: naming the file that is missing, truncated, changed or of another version.
    """
    about = describe(place)
    return about, {name: _read_file(place / f"{name}.safetensors", about) for name in names}


def _read_file(path: Path, about: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    expected = about["files"].get(path.name)
    if expected is None:
        raise CheckpointError(f"{path}: is not part of this checkpoint, which holds no such state")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read: {_reason(error)}") from error
    if len(content) != expected.get("bytes"):
        raise CheckpointError(
            f"{path}: has {len(content)} bytes; it must have {expected.get('bytes')}, so it is "
            "truncated or another file"
        )
    if _entry(content) != expected:
        raise CheckpointError(f"{path}: its content was changed: sha256 differs from {DESCRIPTION}")
    try:
        return load(content)
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f"{path}: holds no arrays: {error}") from error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
