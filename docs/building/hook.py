"""What MkDocs calls while it builds the site: adds the pages that are made, draws equations."""

from __future__ import annotations

import html
import re
from typing import Any

import pages
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

EQUATION = re.compile(r'<(div|span) class="arithmatex">\\[\[(](.*?)\\[\])]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made from the code and from files outside of docs/."""
    root = pages.ROOT
    made: dict[str, Any] = {
        "index.md": root / "README.md",
        "overview.md": root / "docs/README.md",
        "changelog.md": root / "CHANGELOG.md",
        "contributing.md": root / "CONTRIBUTING.md",
        "CITATION.cff": root / "CITATION.cff",
        "data.md": pages.data(),
        "commands.md": pages.commands(),
        "examples.md": pages.examples(),
        "reference/index.md": pages.public(),
    }
    made |= {f"reference/{name}.md": text for name, text in pages.reference()}
    tutorial, pictures = pages.notebook(root / "docs/tutorial.ipynb")
    made |= {"tutorial.md": tutorial, **pictures}
    for name in ("README.md", "tutorial.ipynb"):
        if (own := files.get_file_from_path(name)) is not None:
            files.remove(own)
    for name, content in made.items():
        text = content.read_text(encoding="utf-8") if hasattr(content, "read_text") else content
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Make links hold in the site."""
    within = "/" in page.file.src_uri
    return pages.without_links_to_code(markdown) if within else pages.for_site(markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Draw equations as MathML."""

    def drawn(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return str(convert(html.unescape(match[2]), display=display))

    return EQUATION.sub(drawn, content)
