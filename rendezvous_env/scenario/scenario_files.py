"""Reading and writing scenarios as TOML files, with validated paths."""

import errno
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..checks import raise_invalid, short_repr
from ..field_checks import known_fields
from ..obstacles.maps import from_map
from ..obstacles.maps.reading import OPTIONS

_PathLike = str | os.PathLike[str]


def read(path: _PathLike) -> dict[str, Any]:
    """Plain data of a TOML file; a ValueError for invalid TOML."""
    with _possible(path) as file:
        content = file.read_bytes()
    try:
        return tomllib.loads(content.decode("utf-8-sig"))  # Windows editors write an order mark
    except (RecursionError, ValueError) as error:
        reason = f"not a TOML file: {short_repr(str(error))[1:-1]}"
        if isinstance(error, UnicodeDecodeError):
            reason += "; save it as UTF-8"
        if isinstance(error, RecursionError):
            reason = "its tables and lists are nested too deeply"
        raise ValueError(f"{short_repr(str(path))[1:-1]}: {reason}") from error


def with_map(plain: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Plain data of a scenario with the obstacles of a map file, if it refers to one.

    ``obstacles`` is then a table of kind "map" with the ``path`` of the map, relative to the folder
    of the scenario, and options of ``from_map``. A ``clearance`` in it also sets the start region,
    see ``ObstacleMap.scenario_fields``; other keys of the file override that.
    """
    table = plain.get("obstacles")
    if not isinstance(table, dict) or table.get("kind") != "map":
        return plain
    options = {key: value for key, value in table.items() if key != "kind"}
    known_fields(options, ("path", "clearance", "near", *OPTIONS), "obstacles: a map", "key")
    if not isinstance(path := options.pop("path", None), str):
        raise_invalid("obstacles: path", path, "the path of a map, relative to the scenario's file")
    clearance, near = options.pop("clearance", None), options.pop("near", None)
    try:
        found = from_map(folder / path, **options)
    except FileNotFoundError as error:
        raise ValueError(f"obstacles: path is {path!r}; {folder / path} does not exist") from error
    if clearance is None:
        return {**plain, "obstacles": found}
    return found.scenario_fields(clearance, near) | {**plain, "obstacles": found}


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
    """Validated path of a file."""
    if not isinstance(path, str | os.PathLike):
        raise_invalid("path", path, "the path of a TOML file")
    try:
        yield Path(path)
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ValueError(f"path is {short_repr(str(path))}; it is too long for a path") from error
    except ValueError as error:
        raise ValueError(f"path is {short_repr(str(path))}; it is not a valid path") from error
