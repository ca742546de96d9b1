"""A result folder stands at OUT whole, or not at all.

OUT.part holds an unfinished comparison (``resume``). In a folder there it gets tables, figures and,
last of all, run.json with the digests of all of them; then that is renamed to OUT, and the rest
goes. So wherever a kill strikes, the same command resumes, and the older OUT stays until then.
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
"""What a kill leaves of a file that was being written."""


def is_ours(name: str) -> bool:
    """Whether ``compare`` and ``report`` write a file of that name."""
    return _OURS.fullmatch(name) is not None


def part_of(out: Path) -> Path:
    """Where a comparison stands until it is finished."""
    return out.with_name(f"{out.name}.part")


def destination(
    given: Path, command: str = "compare", ours: Callable[[str], object] = is_ours
) -> Path:
    """The folder that --out means; a UserError if it holds what the command has not written, which
    would be lost with the older results.
    """
    out = Path(os.path.realpath(given))
    here = Path.cwd()
    if out == here or out in here.parents or os.path.ismount(out):
        raise UserError(f"--out {given}: cannot be replaced as a whole; name a folder in it")
    with user_error(f"--out {given}: cannot write there: ", OSError):
        names = sorted(os.listdir(out)) if out.exists() else ()
    for name in names:
        if not (ours(name) or _LITTER.fullmatch(name)):
            raise UserError(
                f"--out {given}: holds {name!r}, which {command} has not written; choose another "
                "folder, or move it away"
            )
    return out


def seal(folder: Path, files: Sequence[str], about: Mapping[str, Any]) -> None:
    """Write run.json: what is known about a run, the digest of every file, and its own."""
    for name in files:
        with (folder / name).open("rb") as file:
            os.fsync(file.fileno())  # outlasts a power failure, as run.json does
    entries = {name: results.entry(folder / name) for name in sorted(files)}
    content = {**about, "files": entries}
    results.write_json(folder / RUN, {**content, "sha256": plain_data.digest_of_rest(content)})
