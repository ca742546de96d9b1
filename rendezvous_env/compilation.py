"""How every kernel of this project is compiled: serial, cached on disk, IEEE arithmetic.

numba notices a change in a kernel's own file, but not in another file whose kernels it has inlined.
So compiled code is kept in a folder named after all the sources it can depend on: edit one, or
install another version, and it is compiled anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba

_HERE = Path(__file__).parent
_CONFIG: Any = numba.config


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on first use: nogil, IEEE division, no fastmath; cached on disk.

    It counts no references to arrays: to hand tuples of arrays over, and to count who holds each
    array and each view of it, takes longer than a small team's arithmetic, and counters that two
    threads raise at the same time take longest. A kernel must therefore neither allocate arrays,
    which the compiler refuses, nor return any, which would be counted too seldom.
    """
    return _compile(function, allocates=False)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that becomes part of whoever calls it."""
    return _compile(function, allocates=False, inlined=True)


def allocating_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that may allocate and return arrays."""
    return _compile(function, allocates=True)


def _compile(function: Callable[..., Any], allocates: bool, inlined: bool = False) -> Any:
    # both options would otherwise be those of whoever calls the function first
    options: dict[str, Any] = {"forceinline": inlined, "_nrt": allocates}
    with _cache_in(_cache_folder(_package(Path(function.__code__.co_filename)))):
        compiler = numba.njit(cache=True, nogil=True, error_model="numpy", **options)
        return compiler(function)


def entry_point(function: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """What a kernel runs for arguments of these types.

    To call it leaves out numba's look at the types of all arguments, which takes as long as a small
    team's step. So later arguments must have the same types, but for arrays that may not be written
    to: compiled code for those would be the same again.
    """
    if not compiled():
        return function
    types = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(types)
    return function.overloads[types].entry_point


def compiled() -> bool:
    """Whether kernels are compiled; ``NUMBA_DISABLE_JIT=1`` leaves them plain Python."""
    return not _CONFIG.DISABLE_JIT


def _package(source: Path) -> Path:
    """Folder of the top-level package that a source file belongs to."""
    folder = source.parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


@lru_cache
def _cache_folder(package: Path) -> str | None:
    """Where compiled code of a package is kept; None leaves the choice to numba."""
    digest = hashlib.sha256()
    for folder in sorted({_HERE, package}):
        for source in sorted(folder.rglob("*.py")):
            content = source.read_bytes()
            if b"kernel" in content:
                digest.update(source.relative_to(folder).as_posix().encode() + content)
    name = f"kernels-{digest.hexdigest()[:16]}"
    for parent in (
        package / "__pycache__",
        Path.home() / ".cache" / "rendezvous-env" / package.name,
    ):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(parent / name, os.W_OK):
            _remove_others(parent, name)
            return str(parent / name)
    return None


def _remove_others(parent: Path, name: str) -> None:
    for other in parent.glob("kernels-*"):
        if other.name != name:
            shutil.rmtree(other, ignore_errors=True)


@contextmanager
def _cache_in(folder: str | None) -> Iterator[None]:
    """Let numba choose this folder, unless the user has set NUMBA_CACHE_DIR."""
    before = _CONFIG.CACHE_DIR
    if folder is not None and not before:
        _CONFIG.CACHE_DIR = folder
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before
