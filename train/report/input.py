"""What ``compare`` left in a folder, read and checked before a page is made of it."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous_env.experiment.scenario import Scenario

from .. import results
from ..errors import UserError
from ..recording import Recording

Key = tuple[str, str, int]
"""Scenario, policy and start."""
Row = dict[str, str]
"""Cells of a line of a CSV file, as they stand there."""

_WORDS = ("scenario", "policy", "against")
_ARRAYS = (
    "times", "positions", "frames", "active", "lyapunov", "lyapunov_before_merge",
    "lyapunov_after_merge", "contacts", "alignment", "observations", "obstacles",
)  # fmt: skip
"""What a page shows of a recording."""


@dataclass(frozen=True)
class Comparison:
    """One result folder."""

    run: dict[str, Any]
    """run.json."""
    scenarios: dict[str, Scenario]
    """By name."""
    rows: list[Row]
    """results.csv."""
    paired: list[Row]
    """paired.csv."""
    episodes: list[Row]
    """episodes.csv."""
    recordings: dict[Key, Recording] | None
    """trajectories.npz; None if the folder has none."""
    figures: list[Path]
    """Its PNG files."""


def read(folder: Path) -> Comparison:
    """Read a result folder.

    Raises:
        UserError: if it is missing, half written, of another format version, or a mixture of two
            comparisons.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder; rendezvous compare --out writes one")
    run = _read_run(folder)
    found = Comparison(
        run=run,
        scenarios=_scenarios(folder, run),
        rows=_read_table(folder / "results.csv", results.RESULT_COLUMNS),
        paired=_read_table(folder / "paired.csv", results.PAIRED_COLUMNS),
        episodes=_read_table(folder / "episodes.csv", results.EPISODE_COLUMNS),
        recordings=_read_recordings(folder / "trajectories.npz"),
        figures=sorted(folder.glob("*.png")),
    )
    _check_agreement(folder, found)
    return found


def _half_written(path: Path, what: str) -> UserError:
    return UserError(f"{path}: {what}; run rendezvous compare into this folder again")


# ---- run.json -----------------------------------------------------------------------------------


def _read_run(folder: Path) -> dict[str, Any]:
    path = folder / "run.json"
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
        version = run["format_version"]
    except FileNotFoundError as error:
        raise UserError(
            f"{folder} holds no run.json: rendezvous compare did not write it, or not to the end"
        ) from error
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise _half_written(path, f"not readable ({error!r})") from error
    if version != results.FORMAT_VERSION:
        raise UserError(
            f"{path}: format_version is {version}; this version of rendezvous reads "
            f"{results.FORMAT_VERSION}. Compare again, or use the version that wrote it "
            f"({run.get('versions', {}).get('rendezvous-env', 'unknown')})"
        )
    for key in ("scenarios", "policies", "seed", "episodes", "keep", "versions", "command_line"):
        if key not in run:
            raise _half_written(path, f"has no {key!r}")
    return dict(run)


def _scenarios(folder: Path, run: dict[str, Any]) -> dict[str, Scenario]:
    try:
        return {name: Scenario.from_plain(plain) for name, plain in run["scenarios"].items()}
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise UserError(f"{folder / 'run.json'}: a scenario is not readable: {error}") from error


# ---- tables -------------------------------------------------------------------------------------


def _read_table(path: Path, columns: Sequence[str]) -> list[Row]:
    """Rows with at least these columns, every other cell than a name a number or empty."""
    try:
        rows = results.read_csv(path)
    except FileNotFoundError as error:
        raise _half_written(path, "missing") from error
    except (OSError, ValueError) as error:
        raise _half_written(path, f"not readable ({error})") from error
    for number, row in enumerate(rows, start=2):
        for column in columns:
            if column not in row:
                raise _half_written(path, f"has no column {column!r}")
            if row[column] is None:
                raise _half_written(path, f"line {number} ends before {column!r}")
            if column not in _WORDS and row[column] and not _is_number(row[column]):
                raise _half_written(path, f"line {number}: {column} is {row[column]!r}, no number")
    return rows


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _check_agreement(folder: Path, found: Comparison) -> None:
    """Refuse files that do not belong together."""
    wanted = [(name, policy) for name, played in found.run["policies"].items() for policy in played]
    if sorted(wanted) != sorted((row["scenario"], row["policy"]) for row in found.rows):
        raise _half_written(folder / "results.csv", "its rows are not those that run.json names")
    shares: dict[tuple[str, str], list[float]] = {pair: [] for pair in wanted}
    for row in found.episodes:
        shares.setdefault((row["scenario"], row["policy"]), []).append(float(row["success"]))
    for row in found.rows:
        met = shares[row["scenario"], row["policy"]]
        what = f"{row['policy']} on {row['scenario']}"
        if len(met) != int(row["episodes"]) or len(met) != found.run["episodes"]:
            raise _half_written(
                folder / "episodes.csv",
                f"{len(met)} starts of {what}; run.json says {found.run['episodes']}",
            )
        if not math.isclose(sum(met) / len(met), float(row["success"]), abs_tol=1e-12):
            raise _half_written(folder, f"results.csv and episodes.csv differ in {what}")
    for key in found.recordings or {}:
        if key[:2] not in shares:
            raise _half_written(
                folder / "trajectories.npz", f"{key[1]} on {key[0]} is not in run.json"
            )


# ---- trajectories -------------------------------------------------------------------------------


def _read_recordings(path: Path) -> dict[Key, Recording] | None:
    found: dict[Key, Recording] = {}
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            for name in arrays.files:
                scenario, policy, start, array = _parts(name)
                found.setdefault((scenario, policy, start), {})[array] = arrays[name]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise _half_written(path, f"not readable ({error})") from error
    for key, recording in found.items():
        _check_recording(path, key, recording)
    return found


def _parts(name: str) -> tuple[str, str, int, str]:
    """Of scenario/policy/start/array; a policy may hold slashes (learned:PATH)."""
    scenario, rest = name.split("/", 1)
    policy, start, array = rest.rsplit("/", 2)
    return scenario, policy, int(start), array


def _check_recording(path: Path, key: Key, recording: Recording) -> None:
    name = "/".join(map(str, key))
    for array in _ARRAYS:
        if array not in recording:
            raise _half_written(path, f"{name} has no {array!r}")
    frames, robots, dim = recording["positions"].shape
    shapes = {
        "times": (frames,),
        "frames": (frames, robots, dim, dim),
        "active": (frames, robots),
        "observations": (frames, robots, recording["observations"].shape[-2], dim),
    }
    for array, shape in shapes.items():
        if recording[array].shape != shape:
            raise _half_written(path, f"{name}/{array} is {recording[array].shape}, not {shape}")
