"""Plain data in JSON files: reading, type checks and digests."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args


def read_json(path: Path) -> Any:
    """Read plain data from a file; OSError, or a ValueError with the reason why it is not JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def digest(content: Any) -> str:
    """SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def digest_of_rest(content: Mapping[str, Any]) -> str:
    """Digest of content without its entry "sha256", which holds this digest."""
    return digest({key: value for key, value in content.items() if key != "sha256"})


def entry(content: bytes) -> dict[str, Any]:
    """Size and SHA-256 of a file's content, as in descriptions."""
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def check_types(values: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    """Check the types of values by name; a ValueError names field and type.

    A bool does not count as a number.
    """
    from typeguard import CollectionCheckStrategy, TypeCheckError, check_type  # not for imports

    every = CollectionCheckStrategy.ALL_ITEMS
    for name, hint in hints.items():
        try:
            check_type(values[name], hint, collection_check_strategy=every)
            if isinstance(values[name], bool) and bool not in (hint, *get_args(hint)):
                raise TypeCheckError(name)
        except TypeCheckError:
            wanted = getattr(hint, "__name__", "") if isinstance(hint, type) else str(hint)
            text = repr(values[name])
            text = text if len(text) <= 60 else f"{text[:60]}…"
            raise ValueError(f"{name} is {text}; it must be of type {wanted or hint}") from None
