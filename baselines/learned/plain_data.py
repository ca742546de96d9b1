"""Plain data in files: JSON that is read, checked for its types, and identified by its digest."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args


def read_json(path: Path) -> Any:
    """Plain data from a file; an OSError, or a ValueError that says why it is no JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def digest(content: Any) -> str:
    """SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def digest_of_rest(content: Mapping[str, Any]) -> str:
    """The digest that content carries in itself, as "sha256", of all the rest of it."""
    return digest({key: value for key, value in content.items() if key != "sha256"})


def entry(content: bytes) -> dict[str, Any]:
    """Size and SHA-256 of what a file holds, as its description names them."""
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def check_types(values: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    """Refuse values of other types than these, both by name; a ValueError names field and type. No
    bool is a number.
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
