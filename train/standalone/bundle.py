"""One Python file of some functions and classes, and of all that they need of this project.

The text is the project's own, word for word: of each module those definitions are taken that the
roots lead to, and of each class those methods whose names occur. Kernels are plain functions there.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import symtable
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module, util
from typing import NamedTuple

PROJECT = ("rendezvous_env", "baselines", "train")
_DROPPED = ("kernel", "inner_kernel", "register")
"""Decorators that mean nothing in one file."""
_FUTURE = "from __future__ import annotations\n"
Definition = ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign


class Name(NamedTuple):
    """What a module calls something."""

    module: str
    word: str


@dataclass
class Module:
    """The definitions of a module of this project."""

    name: str
    text: list[str]
    """Its lines."""
    definitions: dict[str, list[Definition]] = field(default_factory=dict)
    imports: dict[str, Name] = field(default_factory=dict)
    """Name here → where it comes from; the word is empty for a module as a whole."""

    def cut(self, node: ast.stmt) -> str:
        """The text of a statement with its decorators, and with the docstring of a constant."""
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", ()))])
        return "\n".join(self.text[first - 1 : node.end_lineno]) + "\n"


@cache
def module_of(name: str) -> Module:
    """A module, read and taken apart."""
    loaded = import_module(name)
    source, name = inspect.getsource(loaded), loaded.__name__
    module = Module(name, source.splitlines())
    package = name if hasattr(loaded, "__path__") else name.rpartition(".")[0]
    for node in ast.parse(source).body:
        if isinstance(node, ast.Import):
            for alias in node.names:
                module.imports[alias.asname or alias.name] = Name(alias.name, "")
        elif isinstance(node, ast.ImportFrom):
            origin = util.resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                module.imports[alias.asname or alias.name] = Name(origin, alias.name)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            module.definitions[node.name] = [node]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                for word in (n.id for n in ast.walk(target) if isinstance(n, ast.Name)):
                    module.definitions.setdefault(word, []).append(node)
    return module


def resolve(name: Name) -> Name:
    """Where a name of this project is defined; a name from elsewhere as it is."""
    while name.module.partition(".")[0] in PROJECT and name.word:
        module = module_of(name.module)
        if name.word in module.definitions:
            return Name(module.name, name.word)
        if module.imports.get(name.word, name) == name:  # a module of a package
            return Name(f"{name.module}.{name.word}", "")
        name = module.imports[name.word]
    return name


class Bundle:
    """Everything that some names lead to, as the text of one file.

    Args:
        roots: names that must be there.
        stand_ins: text that takes the place of a definition.

    Raises:
        ValueError: naming what cannot stand in one file.
    """

    def __init__(self, roots: Iterable[Name], stand_ins: Mapping[Name, str]) -> None:
        self._stand_ins = dict(stand_ins)
        self._reached: dict[Name, None] = {}
        self._imports: dict[str, Name] = {}
        self._attributes: set[str] = set()
        self._read: set[str] = set()
        self._roots = {resolve(root) for root in roots}
        self._waiting = list(self._roots)
        known = -1
        while self._waiting or known < len(self._attributes):
            while self._waiting:
                self._reach(self._waiting.pop())
            known = len(self._attributes)
            for name in list(self._reached):  # methods whose names have come up since
                self._read_all(name)

    def _reach(self, name: Name) -> None:
        if name not in self._reached:
            self._reached[name] = None
            self._read_all(name)

    def _read_all(self, name: Name) -> None:
        """Look for names in all parts of a definition that are taken."""
        if name in self._stand_ins:
            return self._read_text(name, self._stand_ins[name])
        for text in self._parts(name):
            self._read_text(name, text)
        return None

    def _parts(self, name: Name) -> Iterator[str]:
        module = module_of(name.module)
        for node in module.definitions[name.word]:
            if isinstance(node, ast.ClassDef):
                wanted = _public(node) if name in self._roots else set()
                yield _without_methods(module, node, wanted | self._attributes)
            else:
                yield _undecorated(module.cut(node), node)

    def _read_text(self, name: Name, text: str) -> None:
        key = f"{name.module}:{text}"
        if key in self._read:
            return
        self._read.add(key)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute):
                self._attributes.add(node.attr)
        for word in _free_names(text):
            self._find(name, word)

    def _find(self, name: Name, word: str) -> None:
        """Take what a word of a definition means, if it is ours, or note its import."""
        module = module_of(name.module)
        if word in module.definitions:
            self._waiting.append(Name(module.name, word))
            return
        if word not in module.imports:
            if name not in self._stand_ins and not hasattr(builtins, word):
                raise ValueError(f"{name.module}.{name.word} needs {word}, which nobody defines")
            return
        found = resolve(module.imports[word])
        if found.module.partition(".")[0] not in PROJECT:
            known = self._imports.setdefault(word, found)
            if known != found:
                raise ValueError(f"{word} is {known} and {found}; one file has room for one")
        elif found.word:
            self._waiting.append(found)
        else:
            raise ValueError(f"{name.module}.{name.word} uses the module {found.module} as such")

    def text(self) -> str:
        """Imports, and all definitions in an order in which they can be run."""
        called = self._called()
        lines = [_import_of(word, name) for word, name in sorted(self._imports.items())]
        parts = ["\n".join(sorted(lines, key=lambda line: (line.split()[0] != "import", line)))]
        for module in self._in_order():
            parts.append(f"\n\n# ---- {module.replace('.', '/')}.py {'-' * (88 - len(module))}")
            parts += self._of_module(module, called)
        return "\n".join(parts) + "\n"

    def _of_module(self, module: str, called: Mapping[Name, str]) -> Iterator[str]:
        source, done = module_of(module), set()
        for word, nodes in source.definitions.items():
            name = Name(module, word)
            if name not in self._reached:
                continue
            for node, text in zip(nodes, self._texts(name), strict=False):
                if id(node) not in done:
                    done.add(id(node))
                    space = "\n\n" if isinstance(node, ast.FunctionDef | ast.ClassDef) else ""
                    yield space + self._renamed(name, text, called).rstrip("\n")

    def _texts(self, name: Name) -> list[str]:
        return [self._stand_ins[name]] if name in self._stand_ins else list(self._parts(name))

    def _called(self) -> dict[Name, str]:
        """What each definition is called in the file: words that occur twice get their module's."""
        called: dict[Name, str] = {}
        for name in self._reached:
            word = name.word
            if word in called.values() or word in self._imports:
                word = f"{name.module.rpartition('.')[2]}_{name.word.lstrip('_')}"
            assert word not in called.values(), word
            called[name] = word
        return called

    def _renamed(self, name: Name, text: str, called: Mapping[Name, str]) -> str:
        """A definition with the words that the file has for what it needs."""
        module = module_of(name.module)
        places = []
        tree = ast.parse(text)
        defined = {n.id for part in tree.body for n in ast.walk(part) if isinstance(n, ast.Name)}
        defined &= set(module.definitions)
        for word in {name.word, *_free_names(text), *defined} - set(self._imports):
            meant = Name(module.name, word)
            if word not in module.definitions:
                meant = resolve(module.imports.get(word, meant))
            if (new := called.get(meant, word)) != word:
                places += [(*place, word, new) for place in _places(text, word)]
        lines = text.splitlines(keepends=True)
        for row, column, word, new in sorted(places, reverse=True):
            line = lines[row - 1].encode()
            lines[row - 1] = (line[:column] + new.encode() + line[column + len(word) :]).decode()
        return "".join(lines)

    def _in_order(self) -> list[str]:
        """Modules, those first that others need."""
        order: list[str] = []
        seen: set[str] = set()

        def visit(module: str) -> None:
            if module in seen or module.partition(".")[0] not in PROJECT:
                return
            seen.add(module)
            for name in module_of(module).imports.values():
                visit(name.module)
                found = resolve(name)
                if not found.word or found.module != name.module:
                    visit(found.module)
            order.append(module)

        for name in self._reached:
            visit(name.module)
        used = {name.module for name in self._reached}
        return [module for module in order if module in used]


def _import_of(word: str, name: Name) -> str:
    if not name.word:
        return f"import {name.module}" + (f" as {word}" if word != name.module else "")
    return f"from {name.module} import {name.word}" + (f" as {word}" if word != name.word else "")


def _free_names(text: str) -> set[str]:
    """Global names that a piece of code uses when it is run; annotations are not."""

    def of(table: symtable.SymbolTable) -> Iterator[str]:
        top = table.get_type() == "module"
        for symbol in table.get_symbols():
            if symbol.is_referenced() and (symbol.is_global() or top):
                yield symbol.get_name()
        for inner in table.get_children():
            yield from of(inner)

    found = set(of(symtable.symtable(_FUTURE + text, "<part>", "exec")))
    return found - {"__class__", "super"}


def _places(text: str, word: str) -> Iterator[tuple[int, int]]:
    """Row and column, in bytes, at which a global name stands."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.arg) and node.arg == word:
            raise ValueError(f"{word} is a global name and an argument of one definition")
        if isinstance(node, ast.Name) and node.id == word:
            yield node.lineno, node.col_offset
        elif isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == word:
            yield node.lineno, node.col_offset + (4 if isinstance(node, ast.FunctionDef) else 6)


def _undecorated(text: str, node: ast.stmt) -> str:
    """Without the decorators that mean nothing here; they stand above everything else."""
    decorators = getattr(node, "decorator_list", [])
    lines = text.splitlines(keepends=True)
    first = min([node.lineno, *(d.lineno for d in decorators)])
    dropped = {
        row - first
        for decorator in decorators
        if _word_of(decorator) in _DROPPED
        for row in range(decorator.lineno, (decorator.end_lineno or 0) + 1)
    }
    return "".join(line for row, line in enumerate(lines) if row not in dropped)


def _word_of(decorator: ast.expr) -> str:
    inner = decorator.func if isinstance(decorator, ast.Call) else decorator
    return inner.id if isinstance(inner, ast.Name) else ""


def _public(node: ast.ClassDef) -> set[str]:
    """The methods of a class that its users call."""
    names = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    return {name for name in names if not name.startswith("_")}


def _without_methods(module: Module, node: ast.ClassDef, wanted: set[str]) -> str:
    """A class with those methods only that are wanted, or that Python itself calls."""
    first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
    lines = module.cut(node).splitlines(keepends=True)
    for part in reversed(node.body):
        if not isinstance(part, ast.FunctionDef) or part.name in wanted or part.name[:2] == "__":
            continue
        begins = min([part.lineno, *(d.lineno for d in part.decorator_list)]) - first
        ends = (part.end_lineno or 0) - first
        while begins and not lines[begins - 1].strip():
            begins -= 1
        del lines[begins : ends + 1]
    return "".join(lines)
