"""TOML files of scenarios as plain data; paths that no file can have are refused in words."""

from __future__ import annotations

import errno
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..checks import refuse, shown

_PathLike = str | os.PathLike[str]


def read(path: _PathLike) -> dict[str, Any]:
    """The plain data of a TOML file; ValueError for text that is none."""
    file = _file(path)
    with _possible(path):
        content = file.read_bytes()
    try:
        return tomllib.loads(content.decode("utf-8"))
    except RecursionError as error:
        raise ValueError(f"{_name(path)}: its tables and lists are nested too deep") from error
    except ValueError as error:
        reason = shown(str(error))[1:-1]
        raise ValueError(f"{_name(path)}: not a TOML file: {reason}") from error


def stem(path: _PathLike) -> str:
    """Name of the file without its ending."""
    return _file(path).stem


def write(path: _PathLike, plain: dict[str, Any]) -> None:
    """Write plain data to a TOML file: all of it, or nothing."""
    import tomli_w

    text = tomli_w.dumps(plain)
    target = _file(path)
    temporary = Path(f"{target}.part")
    with _possible(path):
        temporary.write_text(text, encoding="utf-8")
        try:
            temporary.replace(target)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


def _name(path: _PathLike) -> str:
    return shown(str(path))[1:-1]


def _file(path: _PathLike) -> Path:
    if not isinstance(path, str | os.PathLike):
        refuse("path", path, "the path of a TOML file")
    return Path(path)


@contextmanager
def _possible(path: _PathLike) -> Iterator[None]:
    """Tell a path that no file can have."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ValueError(f"path is {shown(str(path))}; it is too long for a file") from error
    except ValueError as error:
        raise ValueError(f"path is {shown(str(path))}; no file can be called that") from error
