"""The files that commands exchange, and how they are written: whole or not at all."""

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

FORMAT_VERSION = 5
"""Of the files of ``compare``; a change that a reader would notice raises it."""

_INTERVAL = "of the 95 % interval of the column before it; empty for a single start"

RESULTS = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "episodes": "number of starts",
    "success": "fraction of teams that met, 0 to 1",
    "success_low": f"lower end {_INTERVAL} (Wilson)",
    "success_high": "upper end of it",
    "clean_success": "fraction of teams that met without touching an obstacle; empty where robots "
    "pass through obstacles",
    "clean_low": f"lower end {_INTERVAL} (Wilson)",
    "clean_high": "upper end of it",
    "median_time": "median time of rendezvous, s; a time-out counts as later than any time",
    "time_low": f"lower end {_INTERVAL} (bootstrap), s",
    "time_high": "upper end of it, s",
    "time_over_bound": "largest share of the proven time that a start took; empty without a proof",
    "path_length": "median way of all robots together, m",
    "min_clearance": "least distance of any robot to an obstacle, m; empty without obstacles",
    "max_rise_between_merges": "largest change of V in a step up to its first merge, m²/s; "
    "negative if V fell in every step",
    "min_alignment": "least alignment |h·f|/‖f‖ of a robot with ‖f‖ ≥ 2δ",
    "contacts": "mean number of contacts in an episode, one for each robot and step",
}
"""What the columns of results.csv mean, in order; empty where it does not apply."""

PAIRED = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "against": "the policy that it is compared with, start by start",
    "clean_difference": "collision-free success of the policy minus that of against, fractions",
    "clean_difference_low": f"lower end {_INTERVAL} (bootstrap; Wilson where all starts agree)",
    "clean_difference_high": "upper end of it",
    "probability_of_improvement": "chance of doing better on a start, without a collision "
    "and sooner; a tie counts half",
    "improvement_low": f"lower end {_INTERVAL} (likewise)",
    "improvement_high": "upper end of it",
}
"""The same for paired.csv."""

RESULT_COLUMNS, PAIRED_COLUMNS = tuple(RESULTS), tuple(PAIRED)
Row = TypeVar("Row", bound=Mapping[str, Any])
_PACKAGES = ("rendezvous-env", "numpy", "numba", "scipy", "gymnasium", "pettingzoo")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A name for a file or a folder, which takes its place once it is whole, unless the body
    raises.
    """
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
    """Rename what is whole, in place of an older one: of a folder a kill between two renamings
    leaves the older one for ``put_back``.
    """
    older = _older(place)
    if made.is_dir() and place.exists():
        shutil.rmtree(older, ignore_errors=True)
        place.rename(older)
    made.replace(place)
    if place.is_dir():
        shutil.rmtree(older, ignore_errors=True)


def put_back(place: Path) -> None:
    """Put back an older folder if nothing has taken its place."""
    if not place.exists() and _older(place).exists():
        _older(place).rename(place)


def _older(place: Path) -> Path:
    return place.with_name(f".{place.name}.older.part")


def prepare_folder(folder: Path, flag: str | None = None) -> Path:
    """Make a folder that can be written to; a UserError names the flag with its value, by default
    --out and the folder.
    """
    with user_error(f"{flag or f'--out {folder}'}: cannot write there: ", OSError):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):  # on Linux without a name: a kill leaves nothing behind
            pass
    return folder


def prepare_file(path: Path, flag: str) -> None:
    """Make the folder of a file that can be written to; a UserError names the flag and the file,
    also where that is a folder itself.
    """
    if path.is_dir():
        raise UserError(f"{flag} {path}: is a folder; name a file")
    prepare_folder(path.parent, f"{flag} {path}")


def write_csv(
    path: Path, rows: Iterable[Mapping[str, Any]], columns: Sequence[str] | None = None
) -> None:
    """Write rows, each with exactly these columns, by default those of the first row; None and NaN
    become empty cells.
    """
    with atomic(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        found = list(rows)
        writer = csv.DictWriter(file, columns or list(found[0]))
        writer.writeheader()
        writer.writerows({name: plain(cell) for name, cell in row.items()} for row in found)


def plain(value: Any) -> Any:
    """A cell as text that reads back as the same number."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        value += 0.0  # no minus sign on a zero
    return "" if value is None or value != value else value


def read_csv(path: Path) -> list[dict[str, str]]:
    """Rows of a file that ``write_csv`` wrote, every cell as text."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        return list(csv.DictReader(file))


def grouped(rows: Iterable[Row], column: str) -> dict[Any, list[Row]]:
    """Rows by what they have in a column, both in their order."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        found.setdefault(row[column], []).append(row)
    return found


def write_arrays(path: Path, arrays: Mapping[str, Any], run: str = "") -> None:
    """Write named arrays to an npz file, with the id of their run as its comment."""
    with atomic(path) as temporary:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **dict(arrays))
        with zipfile.ZipFile(temporary, "a") as archive:
            archive.comment = run.encode()


def entry(path: Path) -> dict[str, Any]:
    """Size and SHA-256 of a file, as run.json names them."""
    return plain_data.entry(path.read_bytes())


def write_text(path: Path, text: str) -> None:
    """Write text, whole or not at all."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain data, indented."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def versioned(scenario: Scenario) -> dict[str, str]:
    """Versioned name ("field") and digest of the first starts ("digest") of a named scenario;
    empty for another one.
    """
    name = scenario.name
    if name not in scenarios.with_versions() or scenario != scenarios.get(name):
        return {}
    field = scenarios.versioned(name)
    return {"field": field, "digest": scenarios.digests()[field.partition("/")[2]]}


def provenance(packages: Sequence[str] = ()) -> dict[str, Any]:
    """What it takes to run the same again: format, versions, command line."""
    return {
        "format_version": FORMAT_VERSION,
        "command_line": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: metadata.version(name) for name in (*_PACKAGES, *packages)},
    }
