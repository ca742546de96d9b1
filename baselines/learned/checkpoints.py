"""Checkpoints: folders of safetensors files and one JSON file, written atomically, no pickle.

RUN/checkpoints/step-000001234567 holds checkpoint.json, which describes the checkpoint and lists
the digests of its other files. These are network.safetensors, optimizer.safetensors and so on.
RUN/checkpoints/latest.json names the newest checkpoint.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rendezvous_env.checks import counted, raise_invalid

from .plain_data import check_types, digest_of_rest, entry, read_json

PathLike = str | os.PathLike[str]
FORMAT_VERSION = 1
DESCRIPTION = "checkpoint.json"
FOLDER, POINTER = "checkpoints", "latest.json"
"""Folder of a run's checkpoints, and the file in it that names the newest one."""


class CheckpointError(ValueError):
    """Error for a missing, truncated, modified or incompatible checkpoint.

    The message names the file and the remedy.
    """


@contextmanager
def refusing(
    path: Path,
    fault: str = "cannot be read",
    errors: tuple[type[Exception], ...] = (OSError, TypeError, ValueError),
) -> Iterator[None]:
    """Convert errors to a CheckpointError that names the file or folder and the fault."""
    try:
        yield
    except errors as error:
        reason = getattr(error, "strerror", None) or error
        raise CheckpointError(f"{path}: {fault}: {reason}") from error


def as_path(path: Any) -> Path:
    """Convert a path or its text to a Path; ValueError for anything else."""
    if not isinstance(path, str | os.PathLike):
        raise_invalid("path", path, "the path of a run, a checkpoint or an exported network")
    return Path(path)


def find(path: PathLike) -> Path:
    """Path of a checkpoint: the folder itself, or the newest checkpoint of a run."""
    path = as_path(path)
    found = [path] if DESCRIPTION in _names(path) else candidates(path)
    if not found:
        there = "no checkpoint in it" if path.is_dir() else "no such folder"
        raise CheckpointError(
            f"{path}: {there}; give the folder of a run of `rendezvous train`, or of a checkpoint"
        )
    return found[0]


def candidates(run: PathLike) -> list[Path]:
    """All checkpoints of a run: first the one that its pointer names, then newest first."""
    folder = as_path(run) / FOLDER
    found = sorted((name for name in _names(folder) if name.startswith("step-")), reverse=True)
    try:
        named = read_json(folder / POINTER)["checkpoint"]
    except (OSError, ValueError, LookupError, TypeError):  # try the newest one
        named = None
    return [folder / name for name in sorted(found, key=lambda name: name != named)]


def _names(folder: Path) -> list[str]:
    """Names in a folder; empty if it does not exist."""
    with refusing(folder):
        return os.listdir(folder) if folder.is_dir() else []


def describe(place: PathLike) -> dict[str, Any]:
    """Read the description of a checkpoint and verify its digest."""
    path = as_path(place) / DESCRIPTION
    with refusing(path):
        about = read_json(path)
    version = about.get("format_version") if isinstance(about, dict) else None
    if version != FORMAT_VERSION:
        raise CheckpointError(
            f"{path}: format_version is {version!r}; this version reads {FORMAT_VERSION}"
        )
    if about.get("sha256") != digest_of_rest(about):
        raise CheckpointError(f"{path}: its content was changed: its digest does not match")
    try:
        check_types({"files": about.get("files")}, {"files": dict[str, dict[str, Any]]})
    except ValueError as error:
        raise CheckpointError(f"{path}: {error}") from error
    return about


def read(place: PathLike, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Read the description of a checkpoint and the arrays of some of its files."""
    place = as_path(place)
    about = describe(place)
    return about, {name: _read_file(place / f"{name}.safetensors", about) for name in names}


def _read_file(path: Path, about: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    expected = about["files"].get(path.name)
    if expected is None:
        raise CheckpointError(f"{path}: is not part of this checkpoint, which has no such state")
    with refusing(path):
        content = path.read_bytes()
    if len(content) != expected.get("bytes"):
        raise CheckpointError(
            f"{path}: has {counted(len(content), 'byte')}; it must have "
            f"{expected.get('bytes')}, so it is truncated or another file"
        )
    if entry(content) != expected:
        raise CheckpointError(f"{path}: its content was changed: sha256 differs from {DESCRIPTION}")
    errors = SafetensorError, ValueError, KeyError, TypeError, AttributeError
    with refusing(path, "contains no arrays", errors):
        return load(content)
