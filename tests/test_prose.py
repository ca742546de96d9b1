"""Prose of pages and docstrings: sentence length, banned words, vocabulary, spelling."""

import ast
import functools
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import ROOT

PAGES = [
    ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/tutorial.ipynb")
] + sorted((ROOT / "docs").rglob("*.md"))
PACKAGES = ("rendezvous_env", "baselines", "train")
LONGEST = 25
"""Maximum number of words of a sentence."""
LONGEST_CELL = 22
"""Maximum number of words of a table cell."""
LONGEST_PAGE = 600
"""Maximum number of words of a page of FEATURE_PAGES, code included."""
FEATURE_PAGES = (
    "activation", "certify", "costs", "failures", "graphs", "jax", "maps", "measured-sensors",
    "moving-obstacles", "play", "quickstart-control", "quickstart-rl", "rewards", "write-a-law",
)  # fmt: skip
"""Pages of one feature or task each."""
BANNED = re.compile(
    r"\b(whom|whoever|nobody|everybody|somebody|everyone|someone|of which|whose own|one's own"
    r"|as told|in turns?|so many|what is|by how much|comes? home|goes any way|in the air|turns? up"
    r"|one after another|all the same|none of it|be it)\b",
    re.IGNORECASE,
)
VOCABULARY = {
    r"clean(ly)? (success|start|run)|cleanly": "collision-free",
    r"silhouettes?": "angular extent",
    r"joined (rule|interval|silhouette)s?": "merged intervals",
    r"privileged (references?|polic(y|ies))": "oracle",
    r"robots? decisions?": "agent step, decision of a robot",
    r"wrong bearings": "bearing error",
    r"bit by bit|bit for bit": "bitwise",
    r"robots that turn": "nonholonomic robots",
    r"robots? (knows?|hears?|walks?|tells?|owes?)": "measure, move, report",
    r"results? cards?": "run record",
}
"""Home-made terms, and terms of the field that replace them."""
SECTION = re.compile(r"(Args|Attributes|Examples?|Returns|Yields|Raises):")
ENTRY = re.compile(r"\*{0,2}\w[\w., *]*: ")
OPENING = re.compile(r"^(What|Whether|How|Whom|Whose|Who|Which|Where|When|Why)\b")


def text_of(page: Path) -> str:
    """Markdown of a page or notebook."""
    text = page.read_text(encoding="utf-8")
    if page.suffix != ".ipynb":
        return text
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown"]
    return "\n\n".join("".join(cell["source"]) for cell in cells)


def prose_of(markdown: str) -> str:
    """Markdown without code, formulas and addresses; inline code becomes one word."""
    text = re.sub(r"^```.*?^```$", "", markdown, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL)
    text = re.sub(r"^ {4,}\S.*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"`[^`\n]+`", "code", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return text.replace("**", "").replace("\\", "")


def paragraphs(markdown: str) -> Iterator[str]:
    """Paragraphs and list items; headings and tables are left out."""
    lines = [
        "" if line.startswith(("|", "#", ">")) else re.sub(r"^\s*([*-]|\d+\.) +", "\n\n", line)
        for line in prose_of(markdown).split("\n")
    ]
    for part in re.split(r"\n\s*\n", "\n".join(lines)):
        if part.strip():
            yield " ".join(part.split())


def cells(markdown: str) -> Iterator[str]:
    """Cells of all tables."""
    for line in prose_of(markdown).split("\n"):
        if line.startswith("|"):
            yield from (cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1])


def sentences(markdown: str) -> Iterator[str]:
    """Sentences, also those that a colon or semicolon separates, and entries joined by dots."""
    for paragraph in paragraphs(markdown):
        yield from re.split(r"(?<=[.;:!?])[*)\]]*\s+| · ", paragraph)


def words(text: str) -> int:
    """Number of words; signs and numbers are none."""
    return sum(bool(re.search(r"[^\W\d_]", token)) for token in text.split())


@functools.cache
def docstrings() -> tuple[tuple[str, str], ...]:
    """Place and text of every public docstring."""
    return tuple(_docstrings())


def _docstrings() -> Iterator[tuple[str, str]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
                if not isinstance(node, kinds) or getattr(node, "name", "").startswith("_"):
                    continue
                if found := ast.get_docstring(node):
                    name = getattr(node, "name", "module")
                    yield f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {name}", found


def prose_of_docstring(docstring: str) -> str:
    """Docstring as Markdown: each entry of a section is a paragraph; tables of keys are no text."""
    lines, in_section = [], False
    for line in re.sub(r"``[^`]*``", "code", docstring).split("\n"):
        text = line.strip()
        if text and text == line:
            in_section = SECTION.fullmatch(line) is not None
        if re.search(r"\S {3,}\S", line):
            lines.append("")
        elif in_section:
            lines += [""] * bool(ENTRY.match(text) or SECTION.fullmatch(text)) + [text]
        else:
            lines.append(line)
    return "\n".join(lines)


def each(pages: list[Path]) -> list[object]:
    return [pytest.param(page, id=page.relative_to(ROOT).as_posix()) for page in pages]


@pytest.mark.parametrize("page", each(PAGES))
def test_page_sentences_are_short(page):
    long = [one for one in sentences(text_of(page)) if words(one) > LONGEST]
    assert not long, "\n".join(f"{words(one)} words: {one}" for one in long)
    long = [cell for cell in cells(text_of(page)) if words(cell) > LONGEST_CELL]
    assert not long, "\n".join(long)


@pytest.mark.parametrize("page", each(PAGES))
def test_page_words_are_those_of_the_field(page):
    if page.name == "migration.md":
        return  # names earlier words
    text = prose_of(text_of(page))
    found = [match[0] for match in BANNED.finditer(text)]
    found += [
        f"{match[0]} → {better}"
        for term, better in VOCABULARY.items()
        for match in re.finditer(rf"\b({term})\b", text, re.IGNORECASE)
    ]
    assert not found, found


@pytest.mark.parametrize("name", FEATURE_PAGES)
def test_feature_page_is_short(name):
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert sum(bool(re.search(r"\w", word)) for word in text.split()) <= LONGEST_PAGE


def test_docstrings_have_no_banned_words_and_openings():
    banned = [
        f"{place}: {match[0]}" for place, text in docstrings() for match in BANNED.finditer(text)
    ]
    openings = [place for place, text in docstrings() if OPENING.match(text)]
    assert not banned, "\n".join(banned)
    assert not openings, "\n".join(openings)


def test_docstring_sentences_are_short():
    long = [
        f"{place}: {words(one)} words: {one}"
        for place, text in docstrings()
        for one in sentences(prose_of_docstring(text))
        if words(one) > LONGEST
    ]
    assert not long, "\n".join(long)


def test_reader_splits_entries_of_docstrings():
    shown = (
        "Do it.\n\n    y = a b\n\nkey    what\n\nArgs:\n    one: first\n        line.\n    two: b."
    )
    assert list(sentences(prose_of_docstring(shown))) == [
        *("Do it.", "Args:", "one:", "first line.", "two:", "b."),
    ]


def test_changelog_entries_are_short():
    entries = re.findall(r"^- (.*?)(?=^- |^#|^$)", text_of(PAGES[1]), re.MULTILINE | re.DOTALL)
    assert len(entries) > 50
    assert not [entry for entry in entries if words(prose_of(entry)) > LONGEST]


def test_spelling():
    pytest.importorskip("codespell_lib")
    places = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs", "examples", *PACKAGES]
    done = subprocess.run(
        [sys.executable, "-m", "codespell_lib", *places], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_reader_splits_sentences_and_counts_words():
    shown = (
        "# Head\n\nOne `a b` two. Three\nfour:\n\n* five six\n\n| long cell |\n\n```text\nx\n```\n"
    )
    assert list(sentences(shown)) == ["One code two.", "Three four:", "five six"]
    assert list(cells(shown)) == ["long cell"]
    assert words("V ≤ 3 m²/s, 20 %") == 2
