"""File formats shared by commands, written atomically."""

import csv
import json
import os
import platform
import shutil
import sys
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, TypeVar

import numpy as np
from rendezvous_env.baselines.learned import plain_data

from rendezvous_env.scenario import scenarios
from rendezvous_env.scenario.scenario import Scenario

from .checks import UserError, user_error

FORMAT_VERSION = 8
"""Format version of the files of ``compare``; raised with every visible change."""
READABLE_VERSIONS = (5, 6, 7, 8)
"""Format versions that this version reads."""
FORMER_COLUMNS = {
    former: former.replace("clean", "collision_free", 1)
    for former in (
        "clean", "clean_success", "clean_low", "clean_high", "clean_difference",
        "clean_difference_low", "clean_difference_high", "clean_planner", "clean_best",
        "clean_mean", "never_clean",
    )
} | {"start": "initial_condition"}  # fmt: skip
"""Columns by the names that they have in older files."""

_INTERVAL = "of the 95 % interval of the column before it; empty for a single episode"

RESULTS = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "episodes": "number of initial conditions",
    "success": "fraction of episodes that met, 0 to 1",
    "success_low": f"lower end {_INTERVAL} (Wilson)",
    "success_high": "upper end of it",
    "collision_free_success": "fraction of episodes that met without contact with an obstacle; "
    "empty where robots pass through obstacles",
    "collision_free_low": f"lower end {_INTERVAL} (Wilson)",
    "collision_free_high": "upper end of it",
    "median_time": "median time of rendezvous, s; a time-out counts as later than any time",
    "time_low": f"lower end {_INTERVAL} (bootstrap), s",
    "time_high": "upper end of it, s",
    "time_over_bound": "largest ratio of time to bound in any episode; empty without a bound",
    "path_length": "median path length of all robots together, m",
    "min_clearance": "minimum distance of any robot to an obstacle, m; empty without obstacles",
    "max_rise_between_merges": "largest change of V in a step up to its first merge, m²/s; "
    "negative if V decreased in every step",
    "min_alignment": "minimum alignment |h·f|/‖f‖ of a robot with ‖f‖ ≥ 2δ",
    "contacts": "mean number of contacts in an episode, one for each robot and step",
}
"""Columns of results.csv and their meaning, in order; cells are empty if not applicable."""

PAIRED = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "against": "reference policy of the paired comparison",
    "collision_free_difference": "collision-free success of the policy minus that of against, "
    "fractions",
    "collision_free_difference_low": f"lower end {_INTERVAL} (bootstrap; Wilson where all "
    "episodes agree)",
    "collision_free_difference_high": "upper end of it",
    "probability_of_improvement": "probability of a better episode, collision-free and faster; a "
    "tie counts half",
    "improvement_low": f"lower end {_INTERVAL} (likewise)",
    "improvement_high": "upper end of it",
}
"""Columns of paired.csv and their meaning."""

RESULT_COLUMNS, PAIRED_COLUMNS = tuple(RESULTS), tuple(PAIRED)
Row = TypeVar("Row", bound=Mapping[str, Any])
_PACKAGES = ("rendezvous-env", "numpy", "numba", "scipy", "gymnasium", "pettingzoo")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Temporary path for a file or folder that is moved into place if the body succeeds."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        put_in_place(temporary, path)
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def put_in_place(made: Path, place: Path) -> None:
    """Move a complete file or folder into place, replacing an older one.

    If the process is killed between the two renames of a folder, ``put_back`` restores the older.
    """
    older = _older(place)
    if made.is_dir() and place.exists():
        shutil.rmtree(older, ignore_errors=True)
        place.rename(older)
    made.replace(place)
    if place.is_dir():
        shutil.rmtree(older, ignore_errors=True)


def put_back(place: Path) -> None:
    """Restore an older folder if its replacement is missing."""
    if not place.exists() and _older(place).exists():
        _older(place).rename(place)


def _older(place: Path) -> Path:
    return place.with_name(f".{place.name}.older.part")


def prepare_folder(folder: Path, flag: str | None = None) -> Path:
    """Create a writable folder; a UserError names the flag (default --out) and its value."""
    with user_error(f"{flag or f'--out {folder}'}: cannot write there: ", OSError):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):  # unnamed on Linux: a killed process leaves no file
            pass
    return folder


def prepare_file(path: Path, flag: str) -> None:
    """Create the folder of a file to write.

    Raises:
        UserError: naming flag and file, if it is not writable or a folder.
    """
    if path.is_dir():
        raise UserError(f"{flag} {path}: is a folder; name a file")
    prepare_folder(path.parent, f"{flag} {path}")


def write_csv(
    path: Path, rows: Iterable[Mapping[str, Any]], columns: Sequence[str] | None = None
) -> None:
    """Write rows with the given columns (default: those of the first row).

    None and NaN become empty cells.
    """
    with atomic(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        found = list(rows)
        writer = csv.DictWriter(file, columns or list(found[0]))
        writer.writeheader()
        writer.writerows({name: plain(cell) for name, cell in row.items()} for row in found)


def plain(value: Any) -> Any:
    """Cell as text that parses to the same number."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        value += 0.0  # no minus sign for zero
    return "" if value is None or value != value else value


def read_csv(path: Path) -> list[dict[str, str]]:
    """Rows of a file of ``write_csv``, cells as text, former columns by their current names."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        reader.fieldnames = current_columns(reader.fieldnames or ())
        return list(reader)


def current_columns(columns: Sequence[str]) -> list[str]:
    """Names of columns, those of older files replaced."""
    return [FORMER_COLUMNS.get(name, name) for name in columns]


def grouped(rows: Iterable[Row], column: str) -> dict[Any, list[Row]]:
    """Rows grouped by the value of a column, in order of appearance."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        found.setdefault(row[column], []).append(row)
    return found


def write_arrays(path: Path, arrays: Mapping[str, Any], run: str = "") -> None:
    """Write named arrays to an npz file, with the run id as its comment."""
    with atomic(path) as temporary:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **dict(arrays))
        with zipfile.ZipFile(temporary, "a") as archive:
            archive.comment = run.encode()


def entry(path: Path) -> dict[str, Any]:
    """Size and SHA-256 of a file for run.json."""
    return plain_data.entry(path.read_bytes())


def write_text(path: Path, text: str) -> None:
    """Write text atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain data as indented JSON."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def versioned(scenario: Scenario) -> dict[str, str]:
    """Versioned name ("field") and digest ("digest") of a named scenario, else empty.

    The digest is that of the first initial conditions.
    """
    name = scenario.name
    if name not in scenarios.with_versions() or scenario != scenarios.get(name):
        return {}
    field = scenarios.versioned(name)
    return {"field": field, "digest": scenarios.digests()[field.partition("/")[2]]}


def provenance(packages: Sequence[str] = ()) -> dict[str, Any]:
    """Provenance of a run: format version, package versions, command line."""
    return {
        "format_version": FORMAT_VERSION,
        "command_line": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: metadata.version(name) for name in (*_PACKAGES, *packages)},
    }
