"""Folders that belong to one process at a time, and go again if nothing comes of them."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from .errors import UserError
from .results import prepare_folder


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """A folder that can be written to; what had to be made of it goes again if it stays empty.

    Raises:
        UserError: if it cannot be made or written to.
    """
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        prepare_folder(folder)
        yield
    finally:
        with suppress(OSError):  # the first that is not empty ends it
            for path in new:
                path.rmdir()


@contextmanager
def held(path: Path, what: str) -> Iterator[None]:
    """A lock file that no other process holds meanwhile; the system frees it if this one dies.

    Args:
        path: of the file; it says who holds it, and goes in the end.
        what: is locked, for the message.

    Raises:
        UserError: if another process holds it, which is named; or it cannot be made.
    """
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise UserError(
            f"{what} is in use by {_holder(path)}; wait for its end, or stop it"
        ) from None
    except OSError as error:
        raise UserError(f"{path}: cannot be locked: {error.strerror}") from error
    try:
        began = datetime.now(UTC).isoformat(timespec="seconds")
        path.write_text(f"process {os.getpid()} on {socket.gethostname()}, since {began}\n")
        yield
    finally:
        path.unlink(missing_ok=True)
        lock.release()


def _holder(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or "another process"
    except OSError:
        return "another process"
