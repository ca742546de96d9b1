"""Checkpoints as they are written: whole or not there at all. ``checkpoints`` reads them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned import checkpoints
from baselines.learned.plain_data import entry

from .. import results

KEPT = 2
"""Checkpoints of a run that stay on disk."""

Tables = Mapping[str, Mapping[str, NDArray[Any]]]


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
    folder = run / checkpoints.FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / f"step-{step:012d}"
    write_folder(place, description, tables)
    results.write_json(folder / checkpoints.POINTER, {"checkpoint": place.name})
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
            files[f"{name}.safetensors"] = entry(content)
            _write(temporary / f"{name}.safetensors", content)
        about = {"format_version": checkpoints.FORMAT_VERSION, **description, "files": files}
        about["sha256"] = checkpoints.digest_of(about)
        _write(temporary / checkpoints.DESCRIPTION, (json.dumps(about, indent=2) + "\n").encode())
        _sync(temporary)
        if place.exists():  # never a moment without either
            place.rename(replaced)
        temporary.rename(place)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(replaced, ignore_errors=True)


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


def ship(run: Path, folder: Path) -> None:
    """Write what others need of a run: weights, settings, and the tables that tell how it went.

    Args:
        run: folder of the run, or of one of its checkpoints.
        folder: where it goes; what stands there is replaced.

    Raises:
        CheckpointError: if the run cannot be read.
    """
    place = checkpoints.find(run)
    about, tables = checkpoints.read(place, ["network"])
    write_folder(folder, about, tables)
    for name in ("metrics.csv", "evaluation.csv"):
        shutil.copyfile(place.parent.parent / name, folder / name)
