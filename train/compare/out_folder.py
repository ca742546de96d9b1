"""How a result folder comes to stand at OUT: whole, or not at all.

OUT.part holds a comparison that is not finished (``resume``). In the end it gets tables,
figures and, last of all, run.json with the digests of all of them; then the rest goes and it is
renamed to OUT. So wherever a kill strikes, OUT.part with a run.json is whole, OUT.part without one
is resumed, and what stood at OUT stays until then.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rendezvous_env.baselines.learned import plain_data

from .. import results, resume
from ..checks import UserError
from ..resume import Part

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


def _replaced(out: Path) -> Path:
    """Where an older OUT stands while the new one takes its place."""
    return out.with_name(f".{out.name}.replaced")


def destination(given: Path) -> Path:
    """The folder that --out means, which is replaced as a whole.

    Raises:
        UserError: if something would be lost with it that ``compare`` has not written.
    """
    out = Path(os.path.realpath(given))
    here = Path.cwd()
    if out == here or out in here.parents or os.path.ismount(out):
        raise UserError(f"--out {given}: cannot be replaced as a whole; name a folder in it")
    try:
        foreign = sorted(
            name for name in os.listdir(out) if not (is_ours(name) or _LITTER.fullmatch(name))
        )
    except FileNotFoundError:
        return out
    except OSError as error:
        raise UserError(f"--out {given}: cannot write there: {error.strerror}") from error
    if foreign:
        raise UserError(
            f"--out {given}: holds {foreign[0]!r}, which compare has not written and would remove "
            "with the older results; choose another folder, or move it away"
        )
    return out


def finish(out: Path, part: Part, files: Sequence[str], about: Mapping[str, Any]) -> None:
    """Seal the files in OUT.part with run.json, and put them in the place of OUT.

    Args:
        out: the folder.
        part: its OUT.part.
        files: names, all written.
        about: what run.json says besides.
    """
    seal(part.folder, files, {**about, "run": part.run})
    promote(out)


def seal(folder: Path, files: Sequence[str], about: Mapping[str, Any]) -> None:
    """Write run.json with the digest of every file, and its own."""
    for name in files:
        _sync(folder / name)
    entries = {name: results.entry(folder / name) for name in sorted(files)}
    content = {**about, "files": entries}
    results.write_json(folder / RUN, {**content, "sha256": plain_data.digest(content)})


# ---- begin, go on, put in place -----------------------------------------------------------------


def open_part(given: Path, out: Path, plan: Mapping[str, Any], *, fresh: bool) -> Part | None:
    """OUT.part for a comparison, with the cells that an earlier run of it has finished.

    Args:
        given: what --out said, for messages.
        out: the folder, as ``destination`` gives it.
        plan: plain data that says what is asked for.
        fresh: whether to throw away what another comparison has left unfinished.

    Returns:
        None if just this comparison was finished, and only had to be put in its place.

    Raises:
        UserError: if OUT.part is of something else.
    """
    part = Part(part_of(out), plan, "comparison")
    if settle(out) == part.run:
        return None
    part.begin(given, fresh=fresh)
    return part


def settle(out: Path) -> str | None:
    """Put in place what a kill has left finished beside OUT; the id of its run, if there was."""
    replaced, promoted = _replaced(out), None
    if (part_of(out) / RUN).is_file():
        promoted = _finished(part_of(out))["run"]
        promote(out)
    if replaced.exists():
        if out.exists():
            shutil.rmtree(replaced)
        else:
            replaced.rename(out)
    return promoted


def promote(out: Path) -> None:
    """Rename a finished OUT.part to OUT; an older OUT goes as a whole."""
    part, replaced = part_of(out), _replaced(out)
    files = {*_finished(part)["files"], RUN}
    for path in part.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name not in files:
            path.unlink()
    if out.exists():
        if replaced.exists():
            shutil.rmtree(replaced)
        _rename(out, replaced)
    _rename(part, out)
    shutil.rmtree(replaced, ignore_errors=True)


def _rename(old: Path, new: Path) -> None:
    old.rename(new)


def _finished(part: Path) -> dict[str, Any]:
    """run.json of a folder that is whole."""
    about = resume.read(part / RUN)
    if not is_sealed(about):
        raise UserError(f"{part / RUN}: its content was changed; remove {part}")
    return about


def is_sealed(about: Mapping[str, Any]) -> bool:
    """Whether what run.json says is what ``seal`` wrote."""
    content = {key: value for key, value in about.items() if key != "sha256"}
    return about.get("sha256") == plain_data.digest(content)


def _sync(path: Path) -> None:
    """Make a file outlast a power failure."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
