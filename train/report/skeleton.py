"""What all pages have: one file that loads nothing, with its data, looks and scripts inside."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from .words import caption

_PAGE = files("train.report") / "page"


def part(name: str) -> str:
    """A file of the page."""
    return (_PAGE / name).read_text(encoding="utf-8")


def whole(
    title: str,
    links: Sequence[str],
    sections: str,
    data: Any,
    scripts: Sequence[str],
    recordings: str,
) -> str:
    """The page.

    Args:
        title: of the window.
        links: titles of sections in the head; "About" leads to the section "run".
        sections: HTML.
        data: what the scripts read as DATA.
        scripts: names of files, put into one function.
        recordings: further elements with data; with any, the page has the library of plots.
    """
    ids = {"About": "run"}
    own = "\n".join(part(f"{name}.js") for name in scripts)
    css, js = (part(f"uPlot.{end}") if recordings else "" for end in ("min.css", "iife.min.js"))
    return Template(part("page.html")).substitute(
        title=escape(title),
        links=" ".join(f'<a href="#{ids.get(one, one.lower())}">{one}</a>' for one in links),
        sections=sections,
        css=css + part("page.css"),
        js=f'{js}\n(() => {{\n"use strict";\n{own}}})();',
        recordings=recordings,
        data=_json(data),
    )


def _json(data: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def figures(paths: Sequence[Path]) -> str:
    """Pictures with what they show."""
    return "\n".join(map(_figure, paths)) or (
        '<p class="note">The folder has no figures; compare draws them by default.</p>'
    )


def _figure(path: Path) -> str:
    source = base64.b64encode(path.read_bytes()).decode("ascii")
    name, said = escape(path.name), escape(caption(path.stem))
    return (
        f'<figure id="{escape(path.stem)}"><img loading="lazy" alt="{said}" '
        f'src="data:image/png;base64,{source}"><figcaption>{said} <button type="button" '
        f'class="save" data-name="{name}" aria-label="Save {name}">PNG</button></figcaption>'
        "</figure>"
    )


def terms(lines: Mapping[str, str]) -> str:
    """A list of terms and what they mean here."""
    items = (f"<dt>{escape(name)}</dt><dd>{escape(line)}</dd>" for name, line in lines.items())
    return f"<dl>{''.join(items)}</dl>"
