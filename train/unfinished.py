"""Work that a kill may stop: what is finished of it lies in a folder, and the same command goes on.

plan.json says what was asked for, cells/ holds what each finished task gave. A cell depends on
nothing but the plan, so who goes on finds what an uninterrupted command would have found.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import baselines
import rendezvous_env
import train
from baselines.learned import plain_data

from . import folders, results
from .errors import UserError

PLAN, _CELLS = "plan.json", "cells"

Arrays = dict[str, np.ndarray[Any, Any]]


def program() -> dict[str, Any]:
    """What numbers depend on besides what was asked for, as plain data."""
    about = results.provenance()
    return {**{key: about[key] for key in ("format_version", "versions")}, "source": _source()}


@cache
def _source() -> str:
    """Digest of the program's own files, which change more often than its version."""
    found = hashlib.sha256()
    for package in (rendezvous_env, baselines, train):
        for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()


def run_id(plan: Mapping[str, Any]) -> str:
    """What was asked for, as a name: the same command gives the same one."""
    return plain_data.digest(plan)[:16]


class Part:
    """The folder of work that goes on.

    Args:
        folder: where it lies.
        plan: plain data that says what is asked for, with ``program``.
        what: is done, in a word.
    """

    def __init__(self, folder: Path, plan: Mapping[str, Any], what: str) -> None:
        self.folder, self.run = folder, run_id(plan)
        self._plan, self._what = plan, what

    def begin(self, given: Path, *, fresh: bool) -> None:
        """Make the folder, or go on with what is there.

        Args:
            given: what --out said, for messages.
            fresh: whether to throw away what another command has left unfinished.

        Raises:
            UserError: if it is of something else.
        """
        if any(self.folder.glob("[!.]*")):
            if fresh and (self.folder / PLAN).is_file():
                self.discard()
            else:
                self._check_same(given)
        with folders.made(self.folder):
            results.write_json(self.folder / PLAN, {**self._plan, "run": self.run})
        (self.folder / _CELLS).mkdir(exist_ok=True)

    @contextmanager
    def at_work(self, console: Console) -> Iterator[None]:
        """Say what is there before the body, and after a body that is interrupted; nothing stays
        where no task was finished.
        """
        if count := self._count():
            console.print(f"goes on with {count} finished parts in {self.folder}", soft_wrap=True)
        try:
            yield
        except KeyboardInterrupt as error:
            if count := self._count():
                error.add_note(
                    f"{count} finished parts lie in {self.folder}; the same command goes on"
                )
            raise
        finally:
            if self.folder.is_dir() and not self._count():
                self.discard()

    def save(self, name: str, arrays: Mapping[str, Any]) -> None:
        """Keep what a task gave."""
        results.write_arrays(self._cell(name), arrays, self.run, packed=False)

    def load(self, name: str) -> Arrays | None:
        """What a task gave; None if it is not finished, or cannot be read: it is done anew."""
        try:
            return results.read_arrays(self._cell(name), self.run)
        except (OSError, ValueError):
            return None

    def discard(self) -> None:
        """Remove the folder; the plan goes last, so that a kill leaves what can be gone on with."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != PLAN:
                path.unlink()
        shutil.rmtree(self.folder)

    def _cell(self, name: str) -> Path:
        return self.folder / _CELLS / f"{name}.npz"

    def _count(self) -> int:
        """How many tasks are finished."""
        return len(list((self.folder / _CELLS).glob("[!.]*.npz")))

    def _check_same(self, given: Path) -> None:
        """Refuse to go on with something else than what was begun."""
        if not (self.folder / PLAN).is_file():
            raise UserError(f"{self.folder}: holds no {PLAN}, so it is none of ours; move it away")
        stored = read(self.folder / PLAN)
        if stored.get("run") == self.run:
            return
        plain = json.loads(json.dumps(self._plan))
        other = next((key for key in plain if stored.get(key) != plain[key]), "run")
        raise UserError(
            f"{self.folder} holds an unfinished {self._what} of other {other} "
            f"({_short(stored.get(other))}, here {_short(plain.get(other))}): give its command to "
            f"go on with it, --fresh to throw it away, or another folder than --out {given}"
        )


def read(path: Path) -> dict[str, Any]:
    """Plain data of a folder of work.

    Raises:
        UserError: if it cannot be read.
    """
    try:
        return dict(plain_data.read_json(path))
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not readable ({error}); remove {path.parent}") from error


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"…{hashlib.sha256(text.encode()).hexdigest()[:8]}"
