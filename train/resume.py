"""Resumable work: results of finished tasks are stored, and the same command resumes.

plan.json describes the request; cells/ holds the results of finished tasks. Results depend on the
plan alone, so a resumed command gives the same results as an uninterrupted one. A lock admits one
process at a time.
"""

import hashlib
import json
import os
import pickle
import shutil
import socket
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from filelock import FileLock, Timeout
from rendezvous_env.baselines.learned import plain_data

import rendezvous_env
from rendezvous_env import baselines
from rendezvous_env.checks import counted

from . import results
from .checks import UserError, user_error
from .console import Console

PLAN = "plan.json"
Task = TypeVar("Task", bound=Any)
_PROGRAM = ("format_version", "versions", "source")
_DIGEST = hashlib.sha256().digest_size


def program() -> dict[str, Any]:
    """Version information on which results depend, as plain data."""
    about = results.provenance()
    return {key: _source() if key == "source" else about[key] for key in _PROGRAM}


@cache
def _source() -> str:
    """Digest of the source files."""
    found = hashlib.sha256()
    for file in (rendezvous_env.__file__, baselines.__file__, __file__):
        for path in sorted(Path(str(file)).parent.rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()


def run_id(plan: Mapping[str, Any]) -> str:
    """Identifier of a plan, equal for equal commands."""
    return plain_data.digest(plan)[:16]


@contextmanager
def claimed(folder: Path, lock: str, what: str) -> Iterator[None]:
    """Create a folder and hold a lock file in it, which the system releases if the process dies.

    Created folders are removed again if they stay empty.

    Raises:
        UserError: if another process holds the lock, or the folder cannot be written.
    """
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    path = folder / lock
    try:
        results.prepare_folder(folder)
        try:
            held = FileLock(path, timeout=0).acquire()
        except Timeout:
            who = ""
            with suppress(OSError):
                who = path.read_text(encoding="utf-8", errors="replace").strip()
            who = who or "another process"
            raise UserError(f"{what} is in use by {who}; wait until it ends, or stop it") from None
        except OSError as error:
            raise UserError(f"{path}: cannot be locked: {error.strerror}") from error
        with held:
            began = datetime.now(UTC).isoformat(timespec="seconds")
            path.write_text(f"process {os.getpid()} on {socket.gethostname()}, since {began}\n")
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
    finally:
        with suppress(OSError):  # stops at the first folder that is not empty
            for made in new:
                made.rmdir()


class RunCheckpoint:
    """Checkpoint folder of a resumable command.

    It stores a plan as plain data; ``what`` names the work in one word. Results may be assembled in
    its folder ``whole`` and moved into place at once.
    """

    def __init__(self, folder: Path, plan: Mapping[str, Any], what: str) -> None:
        self.folder, self.run = folder, run_id(plan)
        self._plan, self._what, self._cells = plan, what, folder / "cells"
        self.whole = folder / "whole"

    @contextmanager
    def at_work(self, given: Path, console: Console, *, fresh: bool) -> Iterator[None]:
        """Create or resume the folder while holding its lock; ``given`` is the value of --out.

        The folder is removed if no task was finished.

        Raises:
            UserError: if it belongs to another command and is not to be overwritten, or if another
                process holds the lock.
        """
        with claimed(self.folder.parent, f".{self.folder.stem}.lock", f"--out {given}"):
            if any(self.folder.glob("[!.]*")):
                if fresh and (self.folder / PLAN).is_file():
                    self.discard()
                else:
                    self._check_same(given)
            results.prepare_folder(self.folder)
            try:
                results.write_json(self.folder / PLAN, {**self._plan, "run": self.run})
                self._cells.mkdir(exist_ok=True)
                shutil.rmtree(self.whole, ignore_errors=True)
                self.whole.mkdir()
                if count := self._count():
                    said = f"resumes with {counted(count, 'finished task')} in {self.folder}"
                    console.print(said, soft_wrap=True)
                yield
            except KeyboardInterrupt as error:
                if count := self._count():
                    error.add_note(
                        f"the same command resumes with {counted(count, 'finished task')} in "
                        f"{self.folder}"
                    )
                raise
            finally:
                if self.folder.is_dir() and not self._count():
                    self.discard()

    def save(self, name: str, result: Any) -> None:
        """Store the result of a task."""
        content = pickle.dumps(result)
        with results.atomic(self._cells / f"{name}.cell") as temporary:
            temporary.write_bytes(self._digest(content) + content)

    def load(self, name: str) -> Any:
        """Result of a task; None if it is missing or damaged, so that it is repeated."""
        try:
            content = (self._cells / f"{name}.cell").read_bytes()
        except OSError:
            return None
        own, content = content[:_DIGEST], content[_DIGEST:]
        # only results of this plan are unpickled
        return pickle.loads(content) if own == self._digest(content) else None

    def finish(
        self,
        tasks: Sequence[Task],
        do: Callable[[Sequence[Task]], Generator[tuple[int, Any], None, None]],
    ) -> Iterator[tuple[Task, Any, bool]]:
        """Iterate over (task, result, whether computed now) of uniquely named tasks.

        Stored results come first, then those of the other tasks as they finish; each is stored.
        ``do`` computes them, as ``tasks.each``.
        """
        left = []
        for task in tasks:
            if (kept := self.load(task.name)) is None:
                left.append(task)
            else:
                yield task, kept, False
        with closing(do(left)) as done:
            for number, result in done:
                self.save(left[number].name, result)
                yield left[number], result, True

    def discard(self) -> None:
        """Remove the folder atomically."""
        gone = self.folder.with_name(f".{self.folder.name}.gone")
        shutil.rmtree(gone, ignore_errors=True)
        self.folder.rename(gone)
        shutil.rmtree(gone)

    def _digest(self, content: bytes) -> bytes:
        return hashlib.sha256(self.run.encode() + content).digest()

    def _count(self) -> int:
        """Number of finished tasks."""
        return len(list(self._cells.glob("[!.]*.cell")))

    def _check_same(self, given: Path) -> None:
        """Raise a UserError if the folder belongs to another command."""
        path = self.folder / PLAN
        if not path.is_file():
            raise UserError(f"{self.folder}: has no {PLAN}, so it is not ours; move it away")
        unreadable = f"{path}: not readable; remove {self.folder}: "
        with user_error(unreadable, OSError, ValueError, TypeError):
            stored = dict(plain_data.read_json(path))
        if stored.get("run") == self.run:
            return
        plain = json.loads(json.dumps(self._plan))
        other = next((key for key in plain if stored.get(key) != plain[key]), "run")
        values = stored.get(other), plain.get(other)
        if other == "versions":
            values = _differing(*values)
        there, here = (
            text if len(text := json.dumps(value)) <= 60 else f"…{plain_data.digest(value)[:8]}"
            for value in values
        )
        remedy = ": give its command to resume it"
        if other in _PROGRAM:
            remedy = (
                ", started with another version of rendezvous or of its packages: finish it with "
                "that version"
            )
        raise UserError(
            f"{self.folder} holds an unfinished {self._what} of other {other} ({there}, here "
            f"{here}){remedy}, --overwrite to discard it, or another folder than --out {given}"
        )


def _differing(*tables: Any) -> tuple[Any, ...]:
    """Tables without their common items."""
    if not all(isinstance(table, dict) for table in tables):
        return tables
    return tuple(
        {
            key: value
            for key, value in table.items()
            if any(key not in other or other[key] != value for other in tables)
        }
        for table in tables
    )
