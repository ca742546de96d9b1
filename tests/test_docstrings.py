"""Docstrings of equations and guarantees: kind of value, unit, formula.

The test searches for their vocabulary. A matching word does not prove correctness; a missing one
reveals an omission.
"""

import ast
import re

import pytest
from conftest import ROOT

FOLDERS = ("physics", "safety")
LEAST_SHARE = 0.9
KIND = re.compile(
    r"\(\.\.\.[,)]"  # (..., d)
    r"|\((?:[nNBMESdkK]|2M|\d|count|width)[^()\s]*,[^()]*\)"  # (n, d), (B,)
    r"|\b(?:[Pp]airs?|[Tt]riples?|[Nn]umbers?|arrays?|tuples?)\b"
    r"|\b(?:any shape|uint64|bool|unit vectors?)\b"
)
UNIT = re.compile(
    r"\bm\b|\bm²|\b1/s\b|\brad\b|, s[,;:.)\n]|, s$|\bin s\b"
    r"|\bunits? of\b|\bwithout unit\b|\bunit (?:vectors?|triples?)\b"
    r"|\b(?:same|their|its|row's|any) units?\b|\bfraction of\b"
)
SOURCE = re.compile(
    r"(?:=|≤|≥|<|>|←|∈|≠) ?(?!\d)\S|[‖√Σ∫Π×·±ᵀ∇⊥]|\b(?:min|max)\(| [−+] [^\d\s]"
    r"|\beqs?\. |\btheor(?:y|ems?)\b|\bguarantees\b|\bassumption \d|\bsection \w|\d{4}\)"
)
REFERENCE = re.compile(r"\b[Aa]s (?:for )?``(\w+)``")


def functions() -> dict[str, ast.FunctionDef]:
    """Functions of the modules in the two folders, by name."""
    return {
        node.name: node
        for folder in FOLDERS
        for path in sorted((ROOT / "rendezvous_env" / folder).rglob("*.py"))
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
    }


FUNCTIONS = functions()


def handles_numbers(function: ast.FunctionDef) -> bool:
    """Whether a function has numeric inputs or outputs: kernels, and by annotation."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    annotations = [function.returns, *(argument.annotation for argument in arguments)]
    if None in annotations:
        return bool(arguments)
    words = " ".join(ast.unparse(found) for found in annotations if found)
    return bool(re.search(r"Array|\bfloat\b|\bint\b|\bAny\b", words)) and bool(arguments)


def told_of(function: ast.FunctionDef) -> str:
    """Docstring of a function, and those of the functions that it refers to."""
    text = ast.get_docstring(function) or ""
    others = [FUNCTIONS[name] for name in REFERENCE.findall(text) if name in FUNCTIONS]
    return "\n".join([text, *(told_of(other) for other in others if other is not function)])


def described(function: ast.FunctionDef) -> str:
    """Docstring of a function, and its return annotation if it is a number."""
    returned = ast.unparse(function.returns) if function.returns else ""
    kind = "\nnumber" if re.fullmatch(r"(float|int|bool)( \| None)?", returned) else ""
    return told_of(function) + kind


def missing(text: str) -> list[str]:
    wanted = {"kind": KIND, "unit": UNIT, "source": SOURCE}
    return [name for name, words in wanted.items() if not words.search(text)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Velocities, (..., d), m/s, by eq. (4).", []),
        ("Scalar product aᵀb of two triples; unit of a times unit of b.", []),
        ("Squared length ‖v‖² of a pair, m².", []),
        ("The value, at most bound either way.", ["kind", "unit", "source"]),
        ("Vector product of triples.", ["unit", "source"]),
        ("Whether an obstacle (m) is touched.", ["kind", "source"]),
        ("Time, (...), s; none is proven.", ["source"]),
        ("A row (x, y) is a = b.", ["kind", "unit"]),
    ],
)
def test_checker_reports_missing_parts(text, expected):
    assert missing(text) == expected


def test_docstrings_give_kind_unit_and_source():
    public = {
        name: function
        for name, function in FUNCTIONS.items()
        if not name.startswith("_") and handles_numbers(function)
    }
    assert len(public) > 100
    lacking = {name: missing(described(function)) for name, function in public.items()}
    offenders = {name: words for name, words in lacking.items() if words}
    share = 1.0 - len(offenders) / len(public)
    assert share >= LEAST_SHARE, f"{share:.1%} of {len(public)}; without them: {offenders}"
