"""Disk cache of compiled kernels and its invalidation.

The compiled code of a kernel for one signature is a file, named by a digest of all its inputs.
These are its own code and, recursively, everything it references in any module; compiler settings;
argument types; processor and versions. The file begins with a digest of the rest, since damaged
machine code would crash the process.
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
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from types import BuiltinMethodType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import serialize

from .inner_code import rebuild

try:
    import fcntl
except ImportError:  # not on Windows, where two processes may compile the same kernel
    fcntl = None  # type: ignore[assignment]

_CONFIG: Any = numba.config
_PACKAGE = Path(__file__).parent / "__pycache__"
_SOURCES = "compilation.py", "inner_code.py", "kernel_cache.py"
_COMPILING = [Path(__file__).with_name(name) for name in _SOURCES]
"""Modules whose edits recompile every kernel."""
_LIBRARIES = {"llvmlite", "numba", "numpy", *sys.stdlib_module_names}
"""Libraries identified by version; the code of all other modules is followed."""
_DIGEST_SIZE = 32
_SIGNATURE = 3  # index of the signature in numba's pickle of a compiled function
_MAX_AGE = 14 * 24 * 3600.0  # s; kernels unused for longer are deleted


class KernelCache:
    """Compiled code of one kernel, by signature, with the methods that numba calls."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._paths: dict[Any, Path | None] = {}  # by signature in compilation

    @property
    def cache_path(self) -> str:
        """Cache folder."""
        return str(_folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code for a signature; None if absent or damaged."""
        if (path := self._paths[sig]) is None:
            return None
        try:
            content = path.read_bytes()
            digest, code = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
            if hashlib.sha256(code).digest() != digest:
                return None
            parts = pickle.loads(code)
            if parts[_SIGNATURE].args != sig:  # from another class of the same name
                return None
            os.utime(path)
            target_context.refresh()
            return rebuild(target_context, *parts)
        except Exception:  # no file, or it references a class that no longer exists
            return None

    def save_overload(self, sig: Any, compiled: Any) -> None:
        """Store compiled code, unless the disk is full or the folder does not exist."""
        path = self._paths[sig]
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

    @contextmanager
    def exclusive(self, sig: Any, entry: bool) -> Iterator[None]:
        """Let one process at a time compile a signature, so that others find its code.

        ``entry``: with an entry for Python; compiled code with and without it are two files.
        """
        path = self._paths[sig] = self._path(sig, entry)
        try:
            if fcntl is None or path is None or path.exists():
                yield
            else:
                with _locked(path.with_suffix(".lock")):
                    yield
        finally:
            del self._paths[sig]

    def _path(self, sig: Any, entry: bool) -> Path | None:
        """File for a signature; None if no later process could find it."""
        kinds = [kind for argument in sig for kind in named_tuples(argument)]
        if (folder := _folder()) is None or any(kind.__module__ == "__main__" for kind in kinds):
            return None
        name = self._kernel.__name__.strip("<>")
        kept = digest_of(self._kernel, sig)[:32]
        return folder / f"{name}-{kept}{'-entry' if entry else ''}.code"


@contextmanager
def _locked(lock: Path) -> Iterator[None]:
    """Hold a lock file; without effect if it cannot be created or locked."""
    with ExitStack() as held:
        with suppress(OSError):
            file = held.enter_context(lock.open("w"))
            held.callback(lock.unlink, missing_ok=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def digest_of(function: Any, argument_types: Any) -> str:
    """Hexadecimal digest of all inputs to the code of a function for given types."""
    kinds = [kind for argument in argument_types for kind in named_tuples(argument)]
    made = hashlib.sha256(f"{_base()} {argument_types}".encode())
    for text in content(function, *kinds):
        made.update(text.encode())
    return made.hexdigest()


_CHOSEN_BY: dict[type, tuple[Any, ...]] = {}


def depends_on(kind: type, functions: tuple[Any, ...]) -> None:
    """Declare functions, plain or compiled, that code for a NamedTuple class depends on.

    They are selected by the class.
    """
    _CHOSEN_BY[kind] = functions


@cache
def _base() -> str:
    """Versions, settings, processor, and compiler settings."""
    sources = b"".join(path.read_bytes() for path in _COMPILING)
    versions = sys.version, numba.__version__, llvmlite.__version__
    settings = _CONFIG.BOUNDSCHECK, _CONFIG.OPT, _CONFIG.LOOP_VECTORIZE
    processor = numba.core.registry.cpu_target.target_context.codegen().magic_tuple()
    return f"{versions} {settings} {processor} {hashlib.sha256(sources).hexdigest()}"


def named_tuples(kind: Any) -> Iterator[type]:
    """NamedTuple classes in a numba type."""
    if (made := getattr(kind, "instance_class", None)) is not None:
        yield made
    for part in getattr(kind, "types", ()):
        yield from named_tuples(part)


def content(*values: Any) -> Iterator[str]:
    """Content that numba freezes: of a function its code and, recursively, its references."""
    return _content(values, frozenset(), set())


def _content(values: Iterable[Any], names: frozenset[str], seen: set[int]) -> Iterator[str]:
    """Content of values; ``names`` are used module attributes, ``seen`` visited functions."""
    for value in values:
        if hasattr(value, "targetoptions"):  # a kernel; its options affect inlining callers
            tuning = getattr(value, "slp", False), getattr(value, "unroll", True)
            yield f"{sorted(value.targetoptions.items())} {tuning}"
        value = getattr(value, "py_func", getattr(value, "_defn", value))  # or an intrinsic
        if not isinstance(value, FunctionType):
            text, parts = _described(value, names)
            yield text
            yield from _content(parts, names, seen)
            continue
        yield f"{value.__module__} {value.__qualname__}"
        if id(value) not in seen and (value.__closure__ or _is_followed(value.__module__)):
            seen.add(id(value))
            yield from _content(_frozen(value), _names(value.__code__), seen)


def _frozen(function: FunctionType) -> Iterable[Any]:
    """Inputs of a function: its code without the docstring, and its references."""
    code, known = function.__code__, function.__globals__
    if code.co_consts[:1] == (function.__doc__,):
        code = code.replace(co_consts=(None, *code.co_consts[1:]))
    named = [known[name] for name in sorted(_names(code)) if name in known]
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    return (code, *named, *held, function.__defaults__)


def _described(value: Any, names: frozenset[str]) -> tuple[str, Iterable[Any]]:
    """Text that identifies a value other than a function, and its parts to follow."""
    if isinstance(value, CodeType):
        variables = value.co_varnames, value.co_freevars, value.co_cellvars
        code = value.co_code, value.co_exceptiontable
        return f"{code} {value.co_names} {variables}", value.co_consts
    if isinstance(value, ModuleType):
        used = sorted(names & set(vars(value))) if _is_followed(value.__name__) else ()
        return value.__name__, [vars(value)[name] for name in used]
    if isinstance(value, MethodType | BuiltinMethodType):  # for example of a table
        return value.__name__, (value.__self__, getattr(value, "__func__", None))
    if isinstance(value, type):
        fields = getattr(value, "_fields", None), getattr(value, "_field_defaults", None)
        return f"{value.__module__} {value.__qualname__} {fields}", (_CHOSEN_BY.get(value),)
    if isinstance(value, dict):  # entries selected by a class are followed where the class occurs
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
    """Names in a function and in its nested functions."""
    within = [_names(part) for part in code.co_consts if isinstance(part, CodeType)]
    return frozenset(code.co_names).union(*within)


@cache
def _folder() -> Path | None:
    """Cache folder: NUMBA_CACHE_DIR if set, else in the package or the user's cache.

    If these are not writable, a temporary folder with a warning; None if there is none.
    """
    places = [Path(_CONFIG.CACHE_DIR or _PACKAGE)]
    with suppress(RuntimeError):  # no home directory
        places += [] if _CONFIG.CACHE_DIR else [Path.home() / ".cache" / "rendezvous-env"]
    if found := next(filter(None, map(_prepared, places)), None):
        return found
    found = _temporary()
    warnings.warn(
        "no folder for compiled code is writable: neither the package's folder nor ~/.cache, nor "
        "NUMBA_CACHE_DIR if set; "
        + (f"code is cached in {found}" if found else "code is compiled in every process"),
        RuntimeWarning,
        stacklevel=2,
    )
    return found


def _prepared(place: Path) -> Path | None:
    """Cache folder in a location, created if necessary; None if it is not writable.

    Kernels unused for long are deleted.
    """
    folder = place / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    for file in folder.iterdir():
        with suppress(OSError):  # another process may delete them
            if time.time() - file.stat().st_mtime > _MAX_AGE:
                file.unlink()
    return folder


def _temporary() -> Path | None:
    """Folder that only this user can write to, the same for all processes."""
    user = os.getuid()
    try:
        place = Path(tempfile.gettempdir()) / f"rendezvous-env-{user}"
        place.mkdir(mode=0o700, exist_ok=True)
        about = place.lstat()
        if about.st_uid != user or about.st_mode & 0o77:
            place = Path(tempfile.mkdtemp(prefix="rendezvous-env-"))
    except OSError:
        return None
    return _prepared(place)
