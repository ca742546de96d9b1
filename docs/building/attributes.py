"""Tables of the fields of dataclasses, from their annotations, defaults and docstrings."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import sys
import textwrap
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, get_origin, get_type_hints

from train.cli import flags_of


def docstrings(kind: type[Any]) -> dict[str, tuple[str, str]]:
    """Annotation and docstring of every field of a dataclass, inherited ones included."""
    found: dict[str, tuple[str, str]] = {}
    for each in reversed(kind.__mro__):
        if dataclasses.is_dataclass(each):
            found |= _own_docstrings(each)
    return found


def _own_docstrings(kind: type[Any]) -> dict[str, tuple[str, str]]:
    """Those that the class itself writes down."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(body, ast.ClassDef)
    found, plain = {}, _WithoutChecks(vars(sys.modules[kind.__module__]))
    for node, after in zip(body.body, [*body.body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            text = inspect.cleandoc(str(after.value.value)) if told else ""
            found[node.target.id] = ast.unparse(plain.visit(node.annotation)), text
    return found


class _WithoutChecks(ast.NodeTransformer):
    """Annotations in which ``Annotated``, and what names it, is the type alone."""

    def __init__(self, names: Mapping[str, Any]) -> None:
        self._names = names

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if isinstance(node.slice, ast.Tuple) and ast.unparse(node.value) == "Annotated":
            return self.visit(node.slice.elts[0])
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        meant = self._names.get(node.id)
        if get_origin(meant) is not Annotated:
            return node
        return ast.parse(inspect.formatannotation(meant.__origin__), mode="eval").body


def default_of(field: dataclasses.Field[Any]) -> str:
    """What a field is if it is not given; a dash where it must be."""
    if isinstance(field.default, tuple):
        return " ".join(f"`{entry}`" for entry in field.default) or "none"
    if field.default is not dataclasses.MISSING:
        return f"`{field.default}`"
    if field.default_factory is not dataclasses.MISSING:
        return f"`{field.default_factory.__name__}()`"
    return "–"


def fields_table(kind: type[Any]) -> str:
    """Name, type, default and meaning of every field of a dataclass, as Markdown."""
    told = docstrings(kind)
    rows = (
        (f"`{field.name}`", f"`{told[field.name][0]}`", default_of(field), told[field.name][1])
        for field in dataclasses.fields(kind)
    )
    return table(("field", "type", "default", "what it is"), rows)


def flags_table(config: type[Any]) -> str:
    """Flag, type, default and meaning of every field of a command's settings, as Markdown."""
    told, hints = docstrings(config), get_type_hints(config, include_extras=True)
    rows = []
    for field in dataclasses.fields(config):
        annotation, text = told[field.name]
        flags = flags_of(field.name, hints[field.name])
        if field.default is True:
            flags += [f"--no-{flags[0][2:]}"]
        if annotation.startswith("Positional["):
            flags, annotation = [field.name.upper()], annotation[len("Positional[") : -1]
        flag = ", ".join(f"`{name}`" for name in flags)
        rows.append((flag, f"`{annotation}`", default_of(field), text))
    return table(("flag", "type", "default", "what it is"), rows)


def meanings_table(head: str, meanings: Mapping[str, str]) -> str:
    """Names and what they mean, as Markdown."""
    return table((head, "what it is"), ((f"`{name}`", text) for name, text in meanings.items()))


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; cells may hold any text."""
    head = tuple(head)
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    """One line, in which a bar outside of code is no end of the cell."""
    parts = " ".join(text.split()).replace("``", "`").split("`")
    return "`".join(p if k % 2 else p.replace("|", r"\|") for k, p in enumerate(parts))
