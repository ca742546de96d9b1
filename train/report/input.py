"""Reader of the result folder of ``compare``, with verified digests."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rendezvous_env.baselines.learned import plain_data

from rendezvous_env.scenario.scenario import Scenario

from .. import results
from ..checks import UserError
from ..compare.out_folder import RUN, is_ours, part_of
from ..recording import Recording, with_observations

Key = tuple[str, str, int]
"""Scenario, policy and number of the initial condition."""
Row = dict[str, str]
"""Cells of a line of a CSV file, as text."""

_FORMER_COUNTS = "starts"
"""Name of the entry ``initial_conditions`` before format version 8."""
_FILES = ("results.csv", "paired.csv", "episodes.csv", "trajectories.npz")


@dataclass(frozen=True)
class Comparison:
    """Contents of a result folder."""

    run: dict[str, Any]  # run.json
    scenarios: dict[str, Scenario]  # by name
    rows: list[Row]  # of results.csv
    paired: list[Row]
    episodes: list[Row]
    recordings: dict[Key, Recording]  # with observations
    figures: list[Path]  # its PNG files


def read(folder: Path) -> Comparison:
    """Read a result folder.

    Raises:
        UserError: if it is missing, incomplete, of another format version, or mixes two runs.
    """
    if not folder.is_dir():
        part = part_of(folder) if folder.name else folder
        left = f"; {part} is unfinished, and the same command resumes it"
        raise UserError(
            f"{folder}: the folder does not exist; rendezvous compare --out writes one"
            f"{left if part.is_dir() else ''}"
        )
    run = _read_run(folder)
    _check_files(folder, run)
    try:
        scenarios = {name: Scenario.from_plain(plain) for name, plain in run["scenarios"].items()}
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        raise UserError(
            f"{folder / RUN}: a scenario is not readable: {error}; if your program registers its "
            "extensions, call train.report.build.run there"
        ) from error
    rows, paired, episodes = (results.read_csv(folder / name) for name in _FILES[:3])
    recordings = _read_recordings(folder / _FILES[3], scenarios)
    pictures = sorted(folder / name for name in run["files"] if name.endswith(".png"))
    return Comparison(run, scenarios, rows, paired, episodes, recordings, pictures)


def half_written(path: Path, what: str, command: str = "compare") -> UserError:
    """Error for a file that differs from what the command wrote."""
    return UserError(f"{path}: {what}; run rendezvous {command} into this folder again")


def _read_run(folder: Path) -> dict[str, Any]:
    path = folder / RUN
    if not path.is_file():
        raise UserError(
            f"{folder} has no run.json: rendezvous compare did not write it, or did not finish"
        )
    try:
        run: dict[str, Any] = plain_data.read_json(path)
        version = run["format_version"]
    except (ValueError, KeyError, TypeError) as error:
        raise half_written(path, f"not readable ({type(error).__name__}: {error})") from error
    if version not in results.READABLE_VERSIONS:
        versions = run.get("versions")
        writer = versions.get("rendezvous-env") if isinstance(versions, dict) else None
        raise UserError(
            f"{path}: format_version is {version!r}; this version of rendezvous reads "
            f"{results.FORMAT_VERSION}. Compare again, or use the version that wrote it "
            f"({writer or 'unknown'})"
        )
    if run.get("sha256") != plain_data.digest_of_rest(run):
        raise half_written(path, "its content was changed: its digest does not match")
    if _FORMER_COUNTS in run:  # after the check of the digest, which covers names
        run["initial_conditions"] = run.pop(_FORMER_COUNTS)
    return run


def _check_files(folder: Path, run: dict[str, Any]) -> None:
    """Raise a UserError for a missing, modified or foreign file."""
    for name in _FILES:
        if name not in run["files"]:
            raise half_written(folder / RUN, f"names no {name}")
    for name, entry in run["files"].items():
        path = folder / name
        if not is_ours(name):
            raise half_written(folder / RUN, f"names {name!r}, which compare does not write")
        if not path.is_file():
            raise half_written(path, "is not a file" if path.exists() else "missing")
        if path.stat().st_size != entry["bytes"] or results.entry(path) != entry:
            raise half_written(path, f"is not of run {run['run']}: its sha256 differs from {RUN}")
    for path in sorted(folder.iterdir()):
        if is_ours(path.name) and path.name not in (*run["files"], RUN, "report.html"):
            raise UserError(
                f"{path}: is not of run {run['run']}, to which {RUN} belongs; remove it"
            )


def _read_recordings(path: Path, scenarios: dict[str, Scenario]) -> dict[Key, Recording]:
    found: dict[Key, Recording] = {}
    with np.load(path) as arrays:
        for name in arrays.files:
            scenario, rest = name.split("/", 1)
            policy, start, kind = rest.rsplit("/", 2)  # a policy may hold slashes (learned:PATH)
            found.setdefault((scenario, policy, int(start)), {})[kind] = arrays[name]
    for key, recording in found.items():
        try:
            found[key] = with_observations(recording, scenarios[key[0]])
        except ValueError as error:
            raise half_written(path, f"{'/'.join(map(str, key))}: {error}") from error
    return found
