"""Where compiled kernels are kept, and when they are compiled anew.

The compiled code of a kernel for one signature is a file, named after all that it was made from:
the sources of this package, taken together; of kernels from elsewhere (other packages, a user's
robot model) what numba freezes of them, which is their own code and what it names, in turn; the
types of the arguments; processor and versions. Edit one of these, and the name is another one. The
file begins with a digest of what follows, since damaged machine code would end the process.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import serialize, sigutils
from numba.core.compiler import CompileResult

_CONFIG: Any = numba.config
_PACKAGE = Path(__file__).parent
_WITHOUT_KERNELS = {"adapters", "envs", "render", "theorems"}
"""Folders that nothing compiled is made from; they stand above all that is."""
_LIBRARIES = {"numba", "numpy", *sys.stdlib_module_names}
_DIGEST_SIZE = 32
_SIGNATURE = 3
"""Place of the signature in what numba makes of a compiled function for pickle."""
_KEPT_UNUSED = 14 * 24 * 3600.0
"""s; code of other versions, and of other installations that share the folder, is kept so long."""


class KernelCache:
    """Compiled code of one kernel, by signature: what numba asks of a dispatcher's cache."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self._function = function
        self._options = sorted(options.items())

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(_folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None if there is none that is whole."""
        target_context.refresh()
        arguments, _ = sigutils.normalize_signature(sig)
        if (path := self._path(arguments, target_context)) is None:
            return None
        try:
            content = path.read_bytes()
            digest, code = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
            if hashlib.sha256(code).digest() != digest:
                return None
            parts = pickle.loads(code)
            if parts[_SIGNATURE].args != arguments:  # of a class of the same name
                return None
            os.utime(path)
            return CompileResult._rebuild(target_context, *parts)
        except Exception:  # it is not there, or names a class that is no longer there
            return None

    def save_overload(self, sig: Any, compiled: Any) -> None:
        """Keep compiled code, unless the disk is full or the folder gone."""
        arguments, _ = sigutils.normalize_signature(sig)
        path = self._path(arguments, compiled.target_context)
        if path is None or compiled.lifted or compiled.library.has_dynamic_globals:
            return
        code = serialize.dumps(compiled._reduce())
        part = path.with_name(f"{uuid.uuid4().hex}.part")
        with suppress(OSError):
            try:
                part.write_bytes(hashlib.sha256(code).digest() + code)
                part.replace(path)
            finally:
                part.unlink(missing_ok=True)

    def _path(self, arguments: tuple[Any, ...], target_context: Any) -> Path | None:
        """The file for these types; None where no later process could find it."""
        kinds = [kind for argument in arguments for kind in _named_tuples(argument)]
        if (folder := _folder()) is None or any(kind.__module__ == "__main__" for kind in kinds):
            return None
        made_from = [_base(), target_context.codegen().magic_tuple(), self._options, arguments]
        digest = hashlib.sha256(repr(made_from).encode())
        seen: set[int] = set()
        for value in (self._function, *kinds, *(_CHOSEN_BY.get(kind) for kind in kinds)):
            for text in _content(value, frozenset(), seen):
                digest.update(text.encode())
        return folder / f"{self._function.__name__.strip('<>')}-{digest.hexdigest()[:32]}.code"


# ---- what compiled code is made from ------------------------------------------------------------


_CHOSEN_BY: dict[type, tuple[Any, ...]] = {}


def depends_on(kind: type, functions: tuple[Any, ...]) -> None:
    """Say that what is compiled for arguments of a type is made from these functions.

    Args:
        kind: a NamedTuple class.
        functions: chosen by it, plain or compiled.
    """
    _CHOSEN_BY[kind] = functions


@cache
def _base() -> str:
    """Of versions, settings and the sources of this package."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        if not _WITHOUT_KERNELS & set(path.relative_to(_PACKAGE).parts):
            digest.update(path.name.encode() + path.read_bytes())
    versions = sys.version, numba.__version__, llvmlite.__version__, _CONFIG.BOUNDSCHECK
    return f"{versions} {digest.hexdigest()}"


def _named_tuples(kind: Any) -> Iterator[type]:
    """The NamedTuple classes in a numba type."""
    if (made := getattr(kind, "instance_class", None)) is not None:
        yield made
    for part in getattr(kind, "types", ()):
        yield from _named_tuples(part)


def _content(value: Any, names: frozenset[str], seen: set[int]) -> Iterator[str]:
    """What numba freezes of a value: of a function its code and what that names, in turn.

    Args:
        value: anything.
        names: which attributes of a module are asked for.
        seen: functions that need not be followed again.
    """
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        yield f"{value.__module__} {value.__qualname__} {value.__code__.co_firstlineno}"
        if id(value) not in seen and (value.__closure__ or _is_followed(value.__module__)):
            seen.add(id(value))
            yield from _content(value.__code__, names, seen)
            asked = _names(value.__code__)
            named = [value.__globals__[name] for name in sorted(asked & set(value.__globals__))]
            held = [cell.cell_contents for cell in value.__closure__ or ()]
            for part in (*named, *held, value.__defaults__):
                yield from _content(part, asked, seen)
    elif isinstance(value, CodeType):
        yield f"{value.co_code!r} {value.co_names} {value.co_varnames}"
        yield from _content(value.co_consts, names, seen)
    elif isinstance(value, ModuleType):
        yield value.__name__
        if _is_followed(value.__name__):
            for name in sorted(names & set(vars(value))):
                yield from _content(vars(value)[name], names, seen)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _content(part, names, seen)
        yield f"{type(value)} {len(value)}"
    elif isinstance(value, type):
        fields = getattr(value, "_fields", None), getattr(value, "_field_defaults", None)
        yield f"{value.__module__} {value.__qualname__} {fields}"
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {value.tobytes()!r}"
    else:
        yield repr(value)


def _is_followed(module: str) -> bool:
    """Whether code of a module is known by its content; else its version says it all."""
    return module.partition(".")[0] not in _LIBRARIES | {_PACKAGE.name}


def _names(code: CodeType) -> frozenset[str]:
    """What a function and the functions within it name."""
    within = [_names(part) for part in code.co_consts if isinstance(part, CodeType)]
    return frozenset(code.co_names).union(*within)


# ---- places -------------------------------------------------------------------------------------


@cache
def _folder() -> Path | None:
    """Where compiled code is kept: an existing folder that can be written to.

    NUMBA_CACHE_DIR if that is set, else beside the sources or at home; where these cannot be
    written to a temporary folder, of which a warning tells. None if nothing can be written to.
    """
    if _CONFIG.CACHE_DIR:
        places = [Path(_CONFIG.CACHE_DIR)]
    else:
        places = [_PACKAGE / "__pycache__"]
        with suppress(RuntimeError):  # nobody's home
            places.append(Path.home() / ".cache" / "rendezvous-env")
    for place in places:
        if found := _made(place):
            return found
    found = _temporary()
    warnings.warn(
        "there is no place for compiled code: neither the package's folder nor ~/.cache, or else "
        "NUMBA_CACHE_DIR, can be written to; "
        + (f"it is kept in {found}" if found else "it is not kept, and made anew each time"),
        RuntimeWarning,
        stacklevel=2,
    )
    return found


def _made(place: Path) -> Path | None:
    """The folder of kernels in a place, made if need be, without what was long not used."""
    folder = place / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    for file in folder.iterdir():
        with suppress(OSError):  # another process removes them, too
            if time.time() - file.stat().st_mtime > _KEPT_UNUSED:
                file.unlink()
    return folder


def _temporary() -> Path | None:
    """A folder of this user's own, the same for all processes: nobody else may leave code in it."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    try:
        place = Path(tempfile.gettempdir()) / f"rendezvous-env-{user}"
        place.mkdir(mode=0o700, exist_ok=True)
        about = place.lstat()
        if hasattr(os, "getuid") and (about.st_uid != user or about.st_mode & 0o77):
            place = Path(tempfile.mkdtemp(prefix="rendezvous-env-"))
    except OSError:
        return None
    return _made(place)
