"""Build the site: ``python docs/building/build.py [mkdocs|zensical]``.

Writes generated pages, and the pages of docs/ with links adapted to the site, to out/docs. A
generator turns them into out/site. Equations and redirects are added afterwards, so any generator
that reads mkdocs.yml works without plugins of ours.
"""

from __future__ import annotations

import html
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pages
from latex2mathml.converter import convert

GENERATORS = {
    "mkdocs": ("mkdocs", "build", "--strict", "--quiet"),
    "zensical": ("zensical", "build", "--clean", "--strict", "--config-file", "mkdocs.yml"),
}
REDIRECTS = {
    "noise": "sensing",
    "training": "train",
    "comparing": "evaluate",
    "scaling": "scale-out",
    "peers": "throughput",
    "extending": "write-a-law",
    "learners-rllib": "learners",
    "learners-pufferlib": "learners",
}
"""Old addresses of pages of the site, and the pages that replace them."""
REDIRECT = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Page moved</title>
<link rel="canonical" href="{new}.html"><meta http-equiv="refresh" content="0; url={new}.html">
</head><body><p>This page is now <a href="{new}.html">{new}</a>.</p></body></html>
"""
NOT_PAGES = ("building", "__pycache__", "tutorial.ipynb")
EQUATION = re.compile(r'<(div|span) class="arithmatex">\\[\[(](.*?)\\[\])]</\1>', re.DOTALL)


def write_pages(folder: Path) -> None:
    """Write all pages that a generator reads."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(pages.ROOT / "docs", folder, ignore=shutil.ignore_patterns(*NOT_PAGES))
    (folder / "README.md").rename(folder / "overview.md")
    shutil.copy(pages.ROOT / "README.md", folder / "index.md")
    for name in ("CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"):
        shutil.copy(pages.ROOT / name, folder / pages.RENAMED.get(name, name))
    made = {"data": pages.data(), "commands": pages.commands(), "examples": pages.examples()}
    made |= {"reference/index": pages.public()}
    made |= {f"reference/{name}": text for name, text in pages.reference()}
    made["tutorial"], pictures = pages.notebook(pages.ROOT / "docs/tutorial.ipynb")
    for name, picture in pictures.items():
        (folder / name).write_bytes(picture)
    (folder / "reference").mkdir()
    for name, text in made.items():
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
    for page in folder.rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        within = page.parent != folder
        text = pages.without_links_to_code(text) if within else pages.for_site(text)
        page.write_text(text, encoding="utf-8")


def write_redirects(site: Path) -> None:
    """Write a page that forwards to the new page at each old address."""
    for old, new in REDIRECTS.items():
        assert (site / f"{new}.html").is_file(), new
        (site / f"{old}.html").write_text(REDIRECT.format(new=new), encoding="utf-8")


def draw_equations(site: Path) -> None:
    """Convert the equations in the pages of a site to MathML."""

    def drawn(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return str(convert(html.unescape(match[2]), display=display))

    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        if "arithmatex" in text:
            page.write_text(EQUATION.sub(drawn, text), encoding="utf-8")


def main() -> None:
    """Build out/site, or the site in the folder SITE_DIR."""
    os.chdir(pages.ROOT)
    _, generator = (*sys.argv, "mkdocs")[:2]
    write_pages(Path("out/docs"))
    subprocess.run([sys.executable, "-m", *GENERATORS[generator]], check=True)
    site = Path(os.environ.get("SITE_DIR", "out/site"))
    draw_equations(site)
    write_redirects(site)


if __name__ == "__main__":
    main()
