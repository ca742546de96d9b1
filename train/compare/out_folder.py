"""Atomic output folder of a comparison.

OUT.part holds an unfinished comparison (``resume``). A folder in it receives tables, figures and
finally run.json with all digests, and is then renamed to OUT. If the process is killed, the same
command resumes; an older OUT stays until the end.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rendezvous_env.baselines.learned import plain_data

from .. import results
from ..checks import UserError, user_error

RUN = "run.json"
_OURS = re.compile(
    r"(results|episodes|paired|ceiling|levels)\.csv|trajectories\.npz|run\.json|report\.html"
    r"|(success|times|against-.+|levels-.+|trajectories-.+)\.(png|pdf)"
)
_LITTER = re.compile(r"\..+\.part(\.\w+)?")
"""Pattern of temporary files left by a killed process."""


def is_ours(name: str) -> bool:
    """True if a file name is one of those written by ``compare`` and ``report``."""
    return _OURS.fullmatch(name) is not None


def part_of(out: Path) -> Path:
    """Folder of an unfinished comparison."""
    return out.with_name(f"{out.name}.part")


def destination(
    given: Path, command: str = "compare", ours: Callable[[str], object] = is_ours
) -> Path:
    """Resolve --out; a UserError if the folder holds foreign files, which would be lost."""
    out = Path(os.path.realpath(given))
    here = Path.cwd()
    if out == here or out in here.parents or os.path.ismount(out):
        raise UserError(f"--out {given}: cannot be replaced as a whole; name a folder in it")
    with user_error(f"--out {given}: cannot write there: ", OSError):
        names = sorted(os.listdir(out)) if out.exists() else ()
    for name in names:
        if not (ours(name) or _LITTER.fullmatch(name)):
            raise UserError(
                f"--out {given}: contains {name!r}, which {command} did not write; choose another "
                "folder, or move it away"
            )
    return out


def seal(folder: Path, files: Sequence[str], about: Mapping[str, Any]) -> None:
    """Write run.json: the description of a run and the digests of all files and of itself."""
    for name in files:
        with (folder / name).open("rb") as file:
            os.fsync(file.fileno())  # survives a power failure, as run.json does
    entries = {name: results.entry(folder / name) for name in sorted(files)}
    content = {**about, "files": entries}
    results.write_json(folder / RUN, {**content, "sha256": plain_data.digest_of_rest(content)})
