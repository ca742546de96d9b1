"""Where compiled kernels are kept, and when they are compiled anew.

numba notices a change in a kernel's own file, but not in another file whose kernels it has inlined
or whose constants it has frozen. So the compiled code of a file is kept in a folder named after the
content of that file and of all that it imports, directly or through others: edit one, or install
another version, and it is compiled anew. Compiled code that cannot be read is compiled anew, too.

Functions that are chosen by the type of an argument (a robot model's equations) come from files
that nobody imports. ``depends_on`` says which; what is compiled for arguments of such a type is
kept in a folder named after those files as well.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache

_CONFIG: Any = numba.config
_OURS = ("rendezvous_env", "baselines", "train")
"""Packages beside each other whose kernels may use each other's."""
_KEPT_UNUSED = 14 * 24 * 3600.0
"""Code of other versions, and of other installations that share the folder, is kept so long, s."""
_IMPORTS = re.compile(r"^[ \t]*(?:from\s+([.\w]+)\s+)?import\s+(\([^)]*\)|[^\n]*)", re.MULTILINE)


def keep(dispatcher: Any) -> None:
    """Let a kernel's compiled code be found again by later processes, if there is a place for it.

    Args:
        dispatcher: what numba made of the function; code typed into an interpreter is not kept.
    """
    source = Path(dispatcher.py_func.__code__.co_filename).absolute()
    if source.is_file() and (folder := folder_for(source)) is not None:
        with cache_in(folder), suppress(RuntimeError):  # numba found the folder unfit after all
            dispatcher._cache = KernelCache(dispatcher.py_func)


class KernelCache(FunctionCache):
    """numba's cache of one kernel, which neither damaged nor unwritable files can make fail."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._beside: dict[frozenset[Path], FunctionCache | None] = {}

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature, None if there is none that can be read."""
        if (place := self._place_for(sig)) is None:
            return None
        try:
            return FunctionCache.load_overload(place, sig, target_context)
        except Exception:  # damaged bytes make unpickling raise anything
            with suppress(OSError):
                place.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compiled code, unless the disk is full or the folder gone."""
        if (place := self._place_for(sig)) is not None:
            with suppress(OSError):
                FunctionCache.save_overload(place, sig, data)

    def _place_for(self, sig: Any) -> FunctionCache | None:
        """The cache for a signature; None if what it stands on cannot be followed."""
        files = _files_behind(sig)
        if not files:
            return self if files is not None else None
        if files not in self._beside:
            self._beside[files] = self._cache_beside(files)
        return self._beside[files]

    def _cache_beside(self, files: frozenset[Path]) -> FunctionCache | None:
        source = Path(self._py_func.__code__.co_filename).absolute()
        if (folder := folder_for(source, files)) is not None:
            with cache_in(folder), suppress(RuntimeError):
                return FunctionCache(self._py_func)
        return None


@cache
def folder_for(source: Path, beside: frozenset[Path] = frozenset()) -> str | None:
    """Where the compiled code of a file is kept, as an existing folder that can be written to.

    It lies in NUMBA_CACHE_DIR if that is set, else beside the file or at home; where these cannot
    be written to, in a temporary folder, of which a warning tells.

    Args:
        source: a Python file.
        beside: others that its compiled code stands on without importing them.

    Returns:
        The folder; None if nothing at all can be written to.
    """
    name = f"kernels-{source.stem}-{_digest(source, beside)}"
    for parent in _usual_places(source):
        if found := _made(parent, name):
            return found
    place = _temporary_place()
    found = None if place is None else _made(place, name)
    _warn_once(f"it is kept in {place}" if found else "it is not kept, and made anew each time")
    return found


@contextmanager
def cache_in(folder: str) -> Iterator[None]:
    """Let numba choose this folder for the kernels made within."""
    before, _CONFIG.CACHE_DIR = _CONFIG.CACHE_DIR, folder
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before


# ---- places -------------------------------------------------------------------------------------


def _usual_places(source: Path) -> list[Path]:
    if _CONFIG.CACHE_DIR:
        return [Path(_CONFIG.CACHE_DIR)]
    places = [source.parent / "__pycache__"]
    with suppress(RuntimeError):  # nobody's home
        places.append(Path.home() / ".cache" / "rendezvous-env" / source.parent.name)
    return places


def _temporary_place() -> Path | None:
    """A folder of this user's own, the same for all processes: nobody else may leave code in it.

    None if there is no place for temporary files.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    try:
        place = Path(tempfile.gettempdir()) / f"rendezvous-env-{user}"
        place.mkdir(mode=0o700, exist_ok=True)
        about = place.lstat()
        if hasattr(os, "getuid") and (about.st_uid != user or about.st_mode & 0o77):
            return Path(tempfile.mkdtemp(prefix="rendezvous-env-"))
    except OSError:
        return None
    return place


def _made(parent: Path, name: str) -> str | None:
    """The folder of this name, made if need be; None if it cannot be written to."""
    folder = parent / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
    except OSError:
        return None
    _remove_unused(parent)
    return str(folder)


@cache
def _remove_unused(parent: Path) -> None:
    """Remove what nobody has used for long; others may be at work with what they use."""
    for folder in parent.glob("kernels-*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > _KEPT_UNUSED:
                shutil.rmtree(folder, ignore_errors=True)


@cache
def _warn_once(what_then: str) -> None:
    warnings.warn(
        "there is no place for compiled code: neither the package's folder nor ~/.cache, or else "
        f"NUMBA_CACHE_DIR, can be written to; {what_then}",
        RuntimeWarning,
        stacklevel=2,
    )


# ---- what compiled code depends on --------------------------------------------------------------


_CHOSEN_BY: dict[type, frozenset[Path] | None] = {}
"""Files of the functions that are chosen by a type; None where one was typed into an interpreter or
stands in a script, whose types no later process can find again."""


def depends_on(kind: type, functions: tuple[Any, ...]) -> None:
    """Say that what is compiled for arguments of a type stands on these functions.

    Args:
        kind: a NamedTuple class.
        functions: chosen by it, plain or compiled.
    """
    codes = [getattr(function, "py_func", function).__code__ for function in functions]
    files = frozenset(Path(code.co_filename).absolute() for code in codes)
    found_again = kind.__module__ != "__main__" and all(map(Path.is_file, files))
    _CHOSEN_BY[kind] = files if found_again else None


def _files_behind(signature: Any) -> frozenset[Path] | None:
    """Files of the functions chosen by types in a signature; None if one cannot be followed."""
    files: frozenset[Path] = frozenset()
    for kind in _parts(signature):
        if (made := getattr(kind, "instance_class", None)) in _CHOSEN_BY:
            if (chosen := _CHOSEN_BY[made]) is None:
                return None
            files |= chosen
    return files


def _parts(kind: Any) -> Iterator[Any]:
    """A type, or several, and what they are made of."""
    yield kind
    for part in kind if isinstance(kind, tuple) else getattr(kind, "types", ()):
        yield from _parts(part)


def _digest(source: Path, beside: frozenset[Path] = frozenset()) -> str:
    """Of all that the compiled code of a file depends on."""
    found = hashlib.sha256(f"{numba.__version__} {bool(_CONFIG.BOUNDSCHECK)}".encode())
    for path in sorted(_with_imports(source).union(*map(_with_imports, beside))):
        found.update(path.name.encode() + _text(path).encode())
    return found.hexdigest()[:16]


def _with_imports(source: Path) -> set[Path]:
    """A file and those that it imports, directly or through others, if ours or beside it."""
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        if (path := waiting.pop()) not in found:
            found.add(path)
            waiting += _imported(path)
    return found


@cache
def _imported(source: Path) -> list[Path]:
    """The files that a file imports, whether at the top or within a function."""
    files = []
    for module, names in _IMPORTS.findall(_text(source)):
        within = module if module.endswith(".") or not module else f"{module}."
        for listed in names.split(","):
            name = re.split(r"\s+as\s+|#", listed)[0].strip(" \t\r\n()")
            files += _files_of(within + name, source) or _files_of(module, source)
    return files


def _files_of(module: str, source: Path) -> list[Path]:
    """The file of a module, named as in the file that imports it; none if it is somebody else's."""
    dots = len(module) - len(module.lstrip("."))
    parts = [part for part in module.split(".") if part]
    if dots:
        places = [source.parents[dots - 1]] if dots <= len(source.parents) else []
    else:
        places = [_root(source)] if _is_near(parts, source) else []
        places += [_root(Path(__file__))] if parts[:1] and parts[0] in _OURS else []
    stems = [place.joinpath(*parts) for place in places]
    files = [file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py")]
    return [file for file in files if file.is_file()]


def _is_near(parts: list[str], source: Path) -> bool:
    """Whether an absolute name is looked for beside the file's own package: where packages are
    installed only that package is ours to follow.
    """
    installed = _root(source).name in ("site-packages", "dist-packages")
    return bool(parts) and (not installed or parts[0] == _top(source).name)


@cache
def _top(source: Path) -> Path:
    """The outermost package that a file is part of; the file itself if it is in none."""
    top = source
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    return top


def _root(source: Path) -> Path:
    return _top(source).parent


@cache
def _text(source: Path) -> str:
    return source.read_text(encoding="utf-8", errors="replace")
