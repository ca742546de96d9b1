"""Generated pages of the site: complete with respect to the code."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from test_package import MODULES

import baselines
import rendezvous_env as rv
from train import cli
from train.cli import COMMANDS


@pytest.fixture(scope="module")
def pages():
    """Module that generates pages."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs" / "building")
        yield import_module("pages")


def section(page: str, title: str) -> str:
    """Text below a heading."""
    (found,) = re.findall(rf"^## `{re.escape(title)}`\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.M)
    return found


@dataclasses.dataclass
class Sample:
    """A dataclass as the code has them."""

    least: float
    """Of two | three values, m;
    never negative."""
    names: tuple[str, ...] = ("a", "b")
    unit: int | None = None
    """In ``x|y``."""
    more: dict[str, Any] = dataclasses.field(default_factory=dict)
    """And others."""


def test_field_table_matches_hand_written_sample(pages):
    rows = import_module("attributes").fields_table(Sample).splitlines()
    assert rows[2:] == [
        r"| `least` | `float` | – | Of two \| three values, m; never negative. |",
        "| `names` | `tuple[str, ...]` | `a` `b` |  |",
        "| `unit` | `int | None` | `None` | In `x|y`. |",
        "| `more` | `dict[str, Any]` | `dict()` | And others. |",
    ]


def test_every_scenario_field_is_documented(pages):
    page = pages.data()
    for kind, _ in pages.DATA:
        rows = section(page, kind.__name__)
        for field in dataclasses.fields(kind):
            found = re.search(rf"^\| `{field.name}` \|.*\| (.*) \|$", rows, re.MULTILINE)
            assert found and found[1], f"{kind.__name__}.{field.name}"


def test_every_column_and_array_is_documented(pages, compared):
    page = pages.data()
    told = {
        file: re.findall(r"^\| `(\w+)` \| \S", section(page, file), re.MULTILINE)
        for file in ("results.csv", "episodes.csv", "paired.csv", "trajectories.npz")
    }
    arrays = told.pop("trajectories.npz")
    for file, names in told.items():
        header = (compared / file).read_text(encoding="utf-8").splitlines()[0]
        assert header.split(",") == names
    with np.load(compared / "trajectories.npz") as kept:
        there = {name.rpartition("/")[2] for name in kept}
    # the links of small teams stand in one array; observations are found again; obstacles are
    # still, and no robot fails
    absent = {"observations", "first", "second", "obstacle_offsets", "conditions"}
    assert there | absent == set(arrays) and not there & absent


def test_every_flag_is_documented_as_in_help(pages):
    page = pages.commands()
    for name, (module, _) in COMMANDS.items():
        rows = re.findall(r"^\| (`[^|]*`) \|", section(page, f"rendezvous {name}"), re.MULTILINE)
        told = cli.help_of(name, import_module(f"train.{module}"))
        flags = re.findall(r"^  (--[\w-]+(?:, --[\w-]+)*|[A-Z]+\b)", told, re.MULTILINE)
        assert sorted(row.replace("`", "") for row in rows) == sorted(flags), name


def test_scenario_files_are_shown_as_read(pages, tmp_path):
    shown = re.findall(r"```toml\n(.*?)```", pages.data(), re.DOTALL)
    assert len(shown) == len(pages.SHOWN_AS_FILES)
    for name, text in zip(pages.SHOWN_AS_FILES, shown, strict=True):
        (tmp_path / "it.toml").write_text(text, encoding="utf-8")
        assert rv.Scenario.from_toml(tmp_path / "it.toml") == rv.scenarios.get(name)


def test_reference_has_every_public_name_and_module(pages):
    front = pages.public()
    for alias, package in (("rv", rv), ("baselines", baselines)):
        for name in package.__all__:
            assert re.search(rf"^\* \[?`{alias}\.{name}`.*: \S", front, re.MULTILINE), name
    asked = set(re.findall(r"^::: (\S+)$", "\n".join(text for _, text in pages.reference()), re.M))
    hidden = re.compile(r"checks|\.(engine|render)\b|/_|\.(building|__init__)")
    folders = {name for name in MODULES if any(other.startswith(f"{name}.") for other in MODULES)}
    wanted = {
        name
        for name in set(MODULES) - folders
        if not name.startswith("train") and not hidden.search(name)
    }
    assert len(wanted) > 80 and wanted <= asked
    assert asked <= set(MODULES)


def test_notebook_becomes_page(pages, tmp_path):
    pixel = "aGVsbG8="
    cells = [
        {"cell_type": "markdown", "source": ["# A\n", "b"]},
        {
            "cell_type": "code",
            "source": ["x = 1\n", "x"],
            "outputs": [
                {"output_type": "stream", "text": ["\x1b[1mone\x1b[0m\n"]},
                {"output_type": "execute_result", "data": {"text/plain": ["1"]}},
                {"output_type": "display_data", "data": {"image/png": pixel, "text/plain": "F"}},
            ],
        },
    ]
    path = tmp_path / "note.ipynb"
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    text, pictures = pages.notebook(path)
    assert text.startswith("# A\nb\n\n```python\nx = 1\nx\n```\n\n")
    assert "```text\none\n1\n```" in text
    assert pictures == {"note-0.png": b"hello"} and "](note-0.png)" in text


def test_reference_starts_with_main_entries(pages):
    names = re.findall(r"^\* \[?`(rv|baselines)\.(\w+)`", pages.public(), re.MULTILINE)
    assert [name for package, name in names if package == "rv"][:2] == ["parallel_env", "make_vec"]
    assert next(name for package, name in names if package == "baselines") == "make"


@pytest.mark.parametrize(
    ("link", "expected"),
    [
        ("[a](docs/theory.md#x)", "[a](theory.md#x)"),
        ("[a](docs/README.md)", "[a](overview.md)"),
        ("[a](../examples)", "[a](examples.md)"),
        ("![a](docs/images/a.png)", "![a](images/a.png)"),
        ("[a](https://a.b/docs/)", "[a](https://a.b/docs/)"),
        ("[a](#b)", "[a](#b)"),
    ],
)
def test_links_hold_in_site(pages, link, expected):
    assert pages.for_site(f"x {link} y") == f"x {expected} y"


def test_tested_versions_match_files():
    files = (*ROOT.glob("constraints*.txt"), *(ROOT / "tests/adapters").glob("*/requirements.txt"))
    pins = {line for file in files for line in file.read_text(encoding="utf-8").split()}
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([a-z0-9, -]+)(?: \(.*?\))? \| ([\d., ]+)", page, re.MULTILINE)
    told = [
        f"{name}=={version}"
        for names, versions in rows
        for name, version in zip(names.split(", "), versions.strip(" ,").split(", "), strict=True)
    ]
    assert len(told) >= 9
    unpinned = {pin.replace("[rllib]", "").replace("[tune]", "") for pin in pins}
    assert [pin for pin in told if pin not in unpinned] == []


def test_citation_and_version_are_shown():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: {re.escape(rv.__version__)}$", text, re.MULTILINE)
    assert "Flexible Bearing-Only Rendezvous Control of Mobile Robots" in text
    assert re.search(r"^authors:\n  - name: \S", text, re.MULTILINE)
    assert re.search(r"^date-released: 20\d\d-", text, re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "Bearing-Only" in project["urls"]["Paper"] and project["version"] == rv.__version__
