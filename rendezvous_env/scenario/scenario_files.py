"""Reading and writing scenarios as TOML files, with validated paths."""

import errno
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..checks import raise_invalid, short_repr

_PathLike = str | os.PathLike[str]


def read(path: _PathLike) -> dict[str, Any]:
    """Plain data of a TOML file; a ValueError for invalid TOML."""
    with _possible(path) as file:
        content = file.read_bytes()
    try:
        return tomllib.loads(content.decode("utf-8-sig"))  # editors of Windows begin with a mark
    except (RecursionError, ValueError) as error:
        reason = f"not a TOML file: {short_repr(str(error))[1:-1]}"
        if isinstance(error, UnicodeDecodeError):
            reason += "; save it as UTF-8"
        if isinstance(error, RecursionError):
            reason = "its tables and lists are nested too deep"
        raise ValueError(f"{short_repr(str(path))[1:-1]}: {reason}") from error


def write(path: _PathLike, plain: dict[str, Any]) -> None:
    """Write plain data to a TOML file atomically."""
    import tomli_w

    text = tomli_w.dumps(plain)
    with _possible(path) as target:
        temporary = Path(f"{target}.part")
        try:
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def _possible(path: _PathLike) -> Iterator[Path]:
    """The path of a file; one that no file can have is refused."""
    if not isinstance(path, str | os.PathLike):
        raise_invalid("path", path, "the path of a TOML file")
    try:
        yield Path(path)
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ValueError(f"path is {short_repr(str(path))}; it is too long for a file") from error
    except ValueError as error:
        raise ValueError(f"path is {short_repr(str(path))}; no file can be called that") from error
