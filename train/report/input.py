"""What ``compare`` left in a folder, read and checked before a page is made of it."""

from __future__ import annotations

import csv
import errno
import math
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict, get_type_hints

from rendezvous_env.baselines.learned import plain_data
from rendezvous_env.baselines.learned.plain_data import check_types

from rendezvous_env.scenario.scenario import Scenario

from .. import results
from ..checks import UserError
from ..compare.out_folder import RUN, is_ours, is_sealed, part_of
from ..recording import Recording, fault_of, whole

Key = tuple[str, str, int]
"""Scenario, policy and start."""
Row = dict[str, str]
"""Cells of a line of a CSV file, as they stand there."""

_WORDS = ("scenario", "policy", "against")
_WHOLE = ("episodes", "start")
_SHARES = ("success", "clean_success")
_MAY_NOT_APPLY = ("clean_success",)
"""Shares that are empty where robots pass through obstacles."""
_MOST_OF_RUN = 2**26
"""Bytes of run.json."""
_TABLES = ("results.csv", "paired.csv", "episodes.csv")


class Run(TypedDict):
    """What a page needs of run.json."""

    scenarios: dict[str, dict[str, Any]]
    policies: dict[str, list[str]]
    seed: int
    episodes: int
    starts: dict[str, int]
    keep: int
    versions: dict[str, str]
    command_line: list[str]
    python: str
    platform: str
    run: str
    files: dict[str, dict[str, Any]]
    sha256: str


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
    recordings: dict[Key, Recording]
    """trajectories.npz, with what the robots saw."""
    figures: list[Path]
    """Its PNG files."""


def read(folder: Path) -> Comparison:
    """Read a result folder.

    Raises:
        UserError: if it is missing, half written, of another format version, or a mixture of two
            comparisons.
    """
    if not folder.is_dir():
        part = part_of(folder) if folder.name else folder
        left = f"; {part} is an unfinished one, and the same command goes on with it"
        raise UserError(
            f"{folder}: there is no such folder; rendezvous compare --out writes one"
            f"{left if part.is_dir() else ''}"
        )
    run = _read_run(folder)
    _check_files(folder, run)
    scenarios = _scenarios(folder, run)
    found = Comparison(
        run=run,
        scenarios=scenarios,
        rows=_read_table(folder / "results.csv", results.RESULT_COLUMNS),
        paired=_read_table(folder / "paired.csv", results.PAIRED_COLUMNS),
        episodes=_read_table(folder / "episodes.csv", results.EPISODE_COLUMNS),
        recordings=_read_recordings(folder / "trajectories.npz", run, scenarios),
        figures=sorted(folder / name for name in run["files"] if name.endswith(".png")),
    )
    _check_agreement(folder, found)
    return found


def _half_written(path: Path, what: str) -> UserError:
    return UserError(f"{path}: {what}; run rendezvous compare into this folder again")


def _check_regular(path: Path, most: Any) -> None:
    """Refuse what would block or never end, as a pipe or a device, and what is too large.

    Raises:
        OSError: saying what it is; a folder is left to whoever opens it.
    """
    about = path.stat()
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        raise OSError(errno.EINVAL, "is no regular file")
    if stat.S_ISREG(about.st_mode) and isinstance(most, int) and about.st_size > most:
        raise OSError(errno.EFBIG, f"has {about.st_size} bytes, more than {most}")


# ---- run.json -----------------------------------------------------------------------------------


def _read_run(folder: Path) -> dict[str, Any]:
    path = folder / RUN
    try:
        _check_regular(path, _MOST_OF_RUN)
        run = plain_data.read_json(path)
        version = run["format_version"]
    except FileNotFoundError as error:
        raise UserError(
            f"{folder} holds no run.json: rendezvous compare did not write it, or not to the end"
        ) from error
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise _half_written(path, f"not readable ({type(error).__name__}: {error})") from error
    if version != results.FORMAT_VERSION:
        versions = run.get("versions")
        writer = versions.get("rendezvous-env") if isinstance(versions, dict) else None
        raise UserError(
            f"{path}: format_version is {version!r}; this version of rendezvous reads "
            f"{results.FORMAT_VERSION}. Compare again, or use the version that wrote it "
            f"({writer or 'unknown'})"
        )
    for key in Run.__annotations__:
        if key not in run:
            raise _half_written(path, f"has no {key!r}")
    try:
        check_types(run, get_type_hints(Run))
    except ValueError as error:
        raise _half_written(path, str(error)) from error
    if not is_sealed(run):
        raise _half_written(path, "its content was changed: the digest in it does not fit")
    return dict(run)


def _check_files(folder: Path, run: dict[str, Any]) -> None:
    """Refuse a file that is not the one that run.json names, or that it does not name."""
    for name in (*_TABLES, "trajectories.npz"):
        if name not in run["files"]:
            raise _half_written(folder / RUN, f"names no {name}")
    for name, entry in run["files"].items():
        path = folder / name
        if not is_ours(name):
            raise _half_written(folder / RUN, f"names {name!r}, which compare does not write")
        try:
            _check_regular(path, entry.get("bytes"))
            own = results.entry(path)
        except FileNotFoundError as error:
            raise _half_written(path, "missing") from error
        except OSError as error:
            what = f"not readable ({error.strerror})"
            if error.errno == errno.EFBIG:
                what = f"is not of run {run['run']}: it {error.strerror}"
            raise _half_written(path, what) from error
        if own != entry:
            raise _half_written(path, f"is not of run {run['run']}: its sha256 differs from {RUN}")
    for path in sorted(folder.iterdir()):
        if is_ours(path.name) and path.name not in (*run["files"], RUN, "report.html"):
            raise UserError(
                f"{path}: is not of run {run['run']}, to which {RUN} belongs; remove it"
            )


def _scenarios(folder: Path, run: dict[str, Any]) -> dict[str, Scenario]:
    try:
        return {name: Scenario.from_plain(plain) for name, plain in run["scenarios"].items()}
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        raise UserError(f"{folder / RUN}: a scenario is not readable: {error}") from error


# ---- tables -------------------------------------------------------------------------------------


def _read_table(path: Path, columns: Sequence[str]) -> list[Row]:
    """Rows with exactly these columns, every other cell than a name a number or empty."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            header, rows = list(reader.fieldnames or ()), list(reader)
    except (OSError, ValueError, csv.Error) as error:
        raise _half_written(path, f"not readable ({error})") from error
    for column in columns:
        if column not in header:
            raise _half_written(path, f"has no column {column!r}")
    if len(header) > len(columns):
        raise _half_written(path, f"has {len(header)} columns; it must have {len(columns)}")
    for number, row in enumerate(rows, start=2):
        if None in row:
            raise _half_written(path, f"line {number} has more cells than columns")
        for column in columns:
            _check_cell(path, number, column, row[column])
    return rows


def _check_cell(path: Path, number: int, column: str, cell: str | None) -> None:
    where = f"line {number}: {column} is {cell!r}"
    if cell is None:
        raise _half_written(path, f"line {number} ends before {column!r}")
    if column in _WORDS:
        return
    if cell and not _is_number(cell):
        raise _half_written(path, f"{where}, no number")
    if column in _WHOLE and not (cell.isascii() and cell.isdigit()):
        raise _half_written(path, f"{where}; it must be a whole number")
    if column in _MAY_NOT_APPLY and not cell:
        return
    if column in _SHARES and not (cell and 0 <= float(cell) <= 1):
        raise _half_written(path, f"{where}; it must be from 0 to 1")


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _check_agreement(folder: Path, found: Comparison) -> None:
    """Refuse files that do not belong together."""
    wanted = [(name, policy) for name, played in found.run["policies"].items() for policy in played]
    for key in ("policies", "starts"):
        if set(found.run[key]) != set(found.scenarios):
            raise _half_written(folder / RUN, f"scenarios and {key} name different scenarios")
    if sorted(wanted) != sorted((row["scenario"], row["policy"]) for row in found.rows):
        raise _half_written(folder / "results.csv", "its rows are not those that run.json names")
    shares: dict[tuple[str, str], list[float]] = {pair: [] for pair in wanted}
    for row in found.episodes:
        shares.setdefault((row["scenario"], row["policy"]), []).append(float(row["success"]))
    for row in found.rows:
        met = shares[row["scenario"], row["policy"]]
        what = f"{row['policy']} on {row['scenario']}"
        starts = found.run["starts"][row["scenario"]]
        if len(met) != int(row["episodes"]) or len(met) != starts:
            raise _half_written(
                folder / "episodes.csv", f"{len(met)} starts of {what}; run.json says {starts}"
            )
        if not math.isclose(sum(met) / len(met), float(row["success"]), abs_tol=1e-12):
            raise _half_written(folder, f"results.csv and episodes.csv differ in {what}")
    _check_names(folder, found, wanted)


def _check_names(folder: Path, found: Comparison, wanted: Sequence[tuple[str, str]]) -> None:
    """Refuse pairs and recordings of episodes that are not there."""
    outcomes = {(row["scenario"], row["policy"], int(row["start"])) for row in found.episodes}
    if len(outcomes) != len(found.episodes):
        raise _half_written(folder / "episodes.csv", "a start of a policy stands there twice")
    for row in found.paired:
        for policy in (row["policy"], row["against"]):
            if (row["scenario"], policy) not in wanted:
                where = f"{policy} on {row['scenario']}"
                raise _half_written(folder / "paired.csv", f"{where} is not in run.json")
    for key in found.recordings:
        if key not in outcomes:
            where = f"start {key[2]} of {key[1]} on {key[0]}"
            raise _half_written(folder / "trajectories.npz", f"{where} is not in episodes.csv")


# ---- trajectories -------------------------------------------------------------------------------


def _read_recordings(
    path: Path, run: dict[str, Any], scenarios: dict[str, Scenario]
) -> dict[Key, Recording]:
    found: dict[Key, Recording] = {}
    try:
        for name, array in results.read_arrays(path, run["run"]).items():
            scenario, policy, start, kind = _parts(name)
            found.setdefault((scenario, policy, start), {})[kind] = array
    except (OSError, ValueError) as error:
        raise _half_written(path, f"not readable ({error})") from error
    for key, recording in found.items():
        if key[0] not in scenarios:
            raise _half_written(path, f"{key[1]} on {key[0]} is not in run.json")
        if fault := fault_of(recording, scenarios[key[0]]):
            raise _half_written(path, f"{'/'.join(map(str, key))} {fault}")
        try:
            found[key] = whole(recording, scenarios[key[0]])
        except ValueError as error:
            raise _half_written(path, f"{'/'.join(map(str, key))}: {error}") from error
    return found


def _parts(name: str) -> tuple[str, str, int, str]:
    """Of scenario/policy/start/array; a policy may hold slashes (learned:PATH)."""
    scenario, rest = name.split("/", 1)
    policy, start, array = rest.rsplit("/", 2)
    return scenario, policy, int(start), array
