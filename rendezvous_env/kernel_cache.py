"""Where compiled kernels are kept, and when they are compiled anew.

The compiled code of a kernel for one signature is a file, named after all that it was made from:
what numba freezes of the kernel, which is its own code and what it names, in turn, in whatever
module; how kernels are compiled; the types of the arguments; processor and versions. It begins with
a digest of what follows, since damaged machine code would end the process.
"""

import hashlib
import os
import pickle
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import BuiltinMethodType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import serialize, sigutils
from numba.core.compiler import CompileResult

_CONFIG: Any = numba.config
_BESIDE = Path(__file__).parent / "__pycache__"
_COMPILING = [Path(__file__).with_name(name) for name in ("compilation.py", "kernel_cache.py")]
"""How kernels are compiled and kept: an edit of these makes every kernel anew."""
_LIBRARIES = {"numba", "numpy", *sys.stdlib_module_names}
"""Known by their version; the code of all other modules is followed."""
_DIGEST_SIZE = 32
_SIGNATURE = 3  # Place of the signature in what numba makes of a compiled function for pickle
_KEPT_UNUSED = 14 * 24 * 3600.0
"""s; code of other versions, and of other installations that share the folder, is kept so long."""


class KernelCache:
    """Compiled code of one kernel, by signature: what numba asks of a dispatcher's cache."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(_folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None if there is none that is whole."""
        target_context.refresh()
        arguments, path = self._file(sig, target_context)
        if path is None:
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
        _, path = self._file(sig, compiled.target_context)
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

    def _file(self, sig: Any, target_context: Any) -> tuple[tuple[Any, ...], Path | None]:
        """Types of the arguments, and the file for them; None where no later process finds it."""
        arguments, _ = sigutils.normalize_signature(sig)
        kinds = [kind for argument in arguments for kind in named_tuples(argument)]
        if (folder := _folder()) is None or any(kind.__module__ == "__main__" for kind in kinds):
            return arguments, None
        made_from = [_base(), target_context.codegen().magic_tuple(), arguments]
        digest = hashlib.sha256(repr(made_from).encode())
        for text in content(self._kernel, *kinds):
            digest.update(text.encode())
        name = self._kernel.__name__.strip("<>")
        return arguments, folder / f"{name}-{digest.hexdigest()[:32]}.code"


_CHOSEN_BY: dict[type, tuple[Any, ...]] = {}


def depends_on(kind: type, functions: tuple[Any, ...]) -> None:
    """Say that compiled code that has to do with a NamedTuple class is made from these functions,
    plain or compiled, which are chosen by it.
    """
    _CHOSEN_BY[kind] = functions


@cache
def _base() -> str:
    """Of versions, settings and the way in which kernels are compiled."""
    sources = b"".join(path.read_bytes() for path in _COMPILING)
    versions = sys.version, numba.__version__, llvmlite.__version__, _CONFIG.BOUNDSCHECK
    return f"{versions} {hashlib.sha256(sources).hexdigest()}"


def named_tuples(kind: Any) -> Iterator[type]:
    """The NamedTuple classes in a numba type."""
    if (made := getattr(kind, "instance_class", None)) is not None:
        yield made
    for part in getattr(kind, "types", ()):
        yield from named_tuples(part)


def content(*values: Any) -> Iterator[str]:
    """What numba freezes of values: of a function its code and what that names, in turn."""
    return _content(values, frozenset(), set())


def _content(values: Iterable[Any], names: frozenset[str], seen: set[int]) -> Iterator[str]:
    """``names`` are the attributes of modules that are asked for, ``seen`` functions that need not
    be followed again.
    """
    for value in values:
        if hasattr(value, "targetoptions"):  # a kernel, whose options hold for whoever inlines it
            yield f"{sorted(value.targetoptions.items())} {getattr(value, 'slp', False)}"
        value = getattr(value, "py_func", value)
        if not isinstance(value, FunctionType):
            text, parts = _told(value, names)
            yield text
            yield from _content(parts, names, seen)
            continue
        yield f"{value.__module__} {value.__qualname__}"
        if id(value) not in seen and (value.__closure__ or _is_followed(value.__module__)):
            seen.add(id(value))
            yield from _content(_frozen(value), _names(value.__code__), seen)


def _frozen(function: FunctionType) -> Iterable[Any]:
    """What a function is made from: its code without the docstring, and what that names."""
    code, known = function.__code__, function.__globals__
    if code.co_consts[:1] == (function.__doc__,):
        code = code.replace(co_consts=(None, *code.co_consts[1:]))
    named = [known[name] for name in sorted(_names(code)) if name in known]
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    return (code, *named, *held, function.__defaults__)


def _told(value: Any, names: frozenset[str]) -> tuple[str, Iterable[Any]]:
    """What a value that is no function says of itself, and what there is in it to follow."""
    if isinstance(value, CodeType):
        variables = value.co_varnames, value.co_freevars, value.co_cellvars
        code = value.co_code, value.co_exceptiontable
        return f"{code} {value.co_names} {variables}", value.co_consts
    if isinstance(value, ModuleType):
        asked = sorted(names & set(vars(value))) if _is_followed(value.__name__) else ()
        return value.__name__, [vars(value)[name] for name in asked]
    if isinstance(value, MethodType | BuiltinMethodType):  # of a table, say
        return value.__name__, (value.__self__, getattr(value, "__func__", None))
    if isinstance(value, type):
        fields = getattr(value, "_fields", None), getattr(value, "_field_defaults", None)
        return f"{value.__module__} {value.__qualname__} {fields}", (_CHOSEN_BY.get(value),)
    if isinstance(value, dict):  # what a class chooses is followed where the class comes up
        return "", [item for item in value.items() if item[0] not in _CHOSEN_BY]
    if isinstance(value, set | frozenset):
        return repr(sorted(map(repr, value))), ()
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes()!r}", ()
    if isinstance(value, tuple | list):
        return f"{type(value)} {len(value)}", value
    return repr(value), ()


def _is_followed(module: str) -> bool:
    return module.partition(".")[0] not in _LIBRARIES


def _names(code: CodeType) -> frozenset[str]:
    """What a function and the functions within it name."""
    within = [_names(part) for part in code.co_consts if isinstance(part, CodeType)]
    return frozenset(code.co_names).union(*within)


@cache
def _folder() -> Path | None:
    """Where compiled code is kept: NUMBA_CACHE_DIR if that is set, else beside the sources or at
    home; where these cannot be written to a temporary folder, with a warning; or nowhere.
    """
    places = [Path(_CONFIG.CACHE_DIR or _BESIDE)]
    with suppress(RuntimeError):  # nobody's home
        places += [] if _CONFIG.CACHE_DIR else [Path.home() / ".cache" / "rendezvous-env"]
    if found := next(filter(None, map(_made, places)), None):
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
    """The folder of kernels in a place, made if need be, without what was long not used; None if it
    cannot be written to.
    """
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
    user = os.getuid()
    try:
        place = Path(tempfile.gettempdir()) / f"rendezvous-env-{user}"
        place.mkdir(mode=0o700, exist_ok=True)
        about = place.lstat()
        if about.st_uid != user or about.st_mode & 0o77:
            place = Path(tempfile.mkdtemp(prefix="rendezvous-env-"))
    except OSError:
        return None
    return _made(place)
