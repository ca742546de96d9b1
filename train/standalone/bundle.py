"""Single-file bundles of functions and classes with their dependencies in this project.

The text is that of the project, verbatim: the definitions in each module on which the roots depend.
Classes contain only the methods whose names occur. Kernels become plain functions.
"""

import ast
import builtins
import inspect
import re
import symtable
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module, util
from typing import NamedTuple

PROJECT = ("rendezvous_env", "baselines", "train")
_own: set[str] = set()
"""Modules of users whose definitions are included."""
_DROPPED = ("kernel", "inner_kernel", "register")
"""Decorators without effect in one file."""
_FUTURE = "from __future__ import annotations\n"
Definition = ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign


class Name(NamedTuple):
    """Word of a module; an empty word is the module as a whole."""

    module: str
    word: str

    @property
    def is_ours(self) -> bool:
        """True if it belongs to this project, or to an added module."""
        return self.module.partition(".")[0] in PROJECT or self.module in _own


@dataclass
class Module:
    """Definitions of a module."""

    name: str
    lines: list[str]
    definitions: dict[str, list[Definition]] = field(default_factory=dict)
    imports: dict[str, Name] = field(default_factory=dict)

    def cut(self, node: Definition, methods: set[str]) -> str:
        """Text of a statement, without decorators that have no effect in one file.

        A class keeps these methods and those that Python itself calls.
        """
        dropped: list[ast.AST] = [
            one for one in _decorators(node) if ast.unparse(one).partition("(")[0] in _DROPPED
        ]
        if isinstance(node, ast.ClassDef):
            dropped += [
                part
                for part in node.body
                if isinstance(part, ast.FunctionDef)
                and part.name not in methods
                and not part.name.startswith("__")
            ]
        gone = {row for part in dropped for row in _rows(part)}
        kept = "\n".join(self.lines[row - 1] for row in _rows(node) if row not in gone)
        return re.sub(r"\n{3,}", "\n\n", kept).rstrip() + "\n"


def _decorators(node: ast.AST) -> list[ast.expr]:
    return getattr(node, "decorator_list", [])


def _rows(node: ast.AST) -> range:
    """Line numbers of a node with its decorators."""
    first, last = getattr(node, "lineno", 0), getattr(node, "end_lineno", 0)
    return range(min([first, *(d.lineno for d in _decorators(node))]), last + 1)


def add_module(name: str) -> None:
    """Include definitions of a user's module, from the current content of its file."""
    _own.add(name)
    module_of.cache_clear()


@cache
def module_of(name: str) -> Module:
    """Read and parse a module."""
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
            for word in (n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)):
                module.definitions.setdefault(word, []).append(node)
    return module


def resolve(name: Name) -> Name:
    """Module in which a name of this project is defined; other names are unchanged."""
    while name.is_ours and name.word:
        module = module_of(name.module)
        if name.word in module.definitions:
            return Name(module.name, name.word)
        if module.imports.get(name.word, name) == name:  # a module of a package
            return Name(f"{name.module}.{name.word}", "")
        name = module.imports[name.word]
    return name


def _meaning(module: str, word: str) -> Name:
    """Definition of a word in a module; a word without one belongs to no module."""
    here = module_of(module)
    if word in here.definitions:
        return Name(module, word)
    return resolve(here.imports[word]) if word in here.imports else Name("", word)


def _is_module(name: str) -> bool:
    try:
        return util.find_spec(name) is not None
    except ModuleNotFoundError:  # not in a package
        return False


def _meaning_of_path(module: str, path: str) -> tuple[Name, int]:
    """Definition of a word in a module, or of an attribute of a module of this project.

    The second is the number of words of the path that it stands for.
    """
    word, *attributes = path.split(".")
    found, used = _meaning(module, word), 1
    while found.module and found.is_ours and not found.word and used <= len(attributes):
        place, attribute = module_of(found.module), attributes[used - 1]
        if attribute not in {**place.definitions, **place.imports}:
            if not _is_module(f"{found.module}.{attribute}"):
                break
        found, used = resolve(Name(found.module, attribute)), used + 1
    return found, used


class Bundle:
    """Definitions on which some names depend, as the text of one file.

    A ValueError names code that cannot be in one file. ``stand_ins`` are texts that replace a
    definition.
    """

    def __init__(self, roots: Iterable[Name], stand_ins: Mapping[Name, str]) -> None:
        self._stand_ins = {resolve(name): text for name, text in stand_ins.items()}
        self._roots = [resolve(root) for root in roots]
        self._reached = dict.fromkeys(self._roots)
        self._needs: dict[str, dict[str, None]] = {root.module: {} for root in self._roots}
        self._imports: dict[str, Name] = {}
        self._attributes: set[str] = set()
        self._read: set[tuple[str, str]] = set()
        known = -1
        while known != (known := len(self._read)):  # each word may add further methods
            for name in list(self._reached):
                for text in self._parts(name).values():
                    if (name.module, text) not in self._read:
                        self._read.add((name.module, text))
                        self._follow(name, text)

    def _parts(self, name: Name) -> dict[int, str]:
        """Text of a definition by the first lines of its statements."""
        nodes = module_of(name.module).definitions[name.word]
        if name in self._stand_ins:
            return {nodes[0].lineno: self._stand_ins[name]}
        return {n.lineno: module_of(name.module).cut(n, self._wanted(name, n)) for n in nodes}

    def _wanted(self, name: Name, node: Definition) -> set[str]:
        """Methods whose names occur, and for a root those of its interface."""
        parts = node.body if isinstance(node, ast.ClassDef) and name in self._roots else []
        names = {part.name for part in parts if isinstance(part, ast.FunctionDef)}
        return self._attributes | {method for method in names if not method.startswith("_")}

    def _follow(self, name: Name, text: str) -> None:
        """Add the dependencies of a part of a definition in this project; record other imports."""
        nodes = ast.walk(ast.parse(text))
        self._attributes |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        for path in sorted(_free_paths(text, name.module)):
            word = path.partition(".")[0]
            found, _ = _meaning_of_path(name.module, path)
            if not found.module:
                if name not in self._stand_ins and not hasattr(builtins, word):
                    raise ValueError(
                        f"{name.module}.{name.word} needs {word}, which is not defined"
                    )
            elif not found.is_ours:
                known = self._imports.setdefault(word, found)
                if known != found:
                    raise ValueError(f"{word} is {known} and {found}; one file can have one only")
            elif not found.word:
                raise ValueError(
                    f"{name.module}.{name.word} uses the module {found.module} as such"
                )
            else:
                self._reached[found] = None
                self._needs.setdefault(found.module, {})
                if found.module != name.module:
                    self._needs[name.module][found.module] = None

    @property
    def foreign(self) -> list[str]:
        """Imported modules that are part of neither Python nor NumPy."""
        tops = {name.module.partition(".")[0] for name in self._imports.values()}
        return sorted(tops - sys.stdlib_module_names - {"numpy"})

    def text(self) -> str:
        """Imports, and all definitions in an executable order."""
        lines = []
        for word, name in sorted(self._imports.items()):
            line = (
                f"from {name.module} import {name.word}" if name.word else f"import {name.module}"
            )
            lines.append(line if line.split()[-1] == word else f"{line} as {word}")
        parts = ["\n".join(sorted(lines, key=lambda line: (line.split()[0] != "import", line)))]
        order, called = list(TopologicalSorter(self._needs).static_order()), self._called()
        for module in order:
            parts.append(f"\n\n# ---- {module.replace('.', '/')}.py {'-' * (88 - len(module))}")
            own = {
                line: (name, text)
                for name in self._reached
                if name.module == module
                for line, text in self._parts(name).items()
            }
            for _, (name, text) in sorted(own.items()):
                space = "\n\n" if re.match(r"\s*(@|def |class )", text) else ""
                parts.append(space + _renamed(name, text, called).rstrip("\n"))
        return "\n".join(parts) + "\n"

    def _called(self) -> dict[Name, str]:
        """Name of each definition in the file; ambiguous words are qualified by their module."""
        called: dict[Name, str] = {}
        for name in self._reached:
            word = name.word
            if word in called.values() or word in self._imports:
                word = f"{name.module.rpartition('.')[2]}_{name.word.lstrip('_')}"
            assert word not in called.values(), word
            called[name] = word
        return called


def _free_names(text: str) -> set[str]:
    """Global names that code uses at run time; annotations do not count."""

    def of(table: symtable.SymbolTable) -> Iterator[str]:
        top = table.get_type() == "module"
        for symbol in table.get_symbols():
            if symbol.is_referenced() and (symbol.is_global() or top):
                yield symbol.get_name()
        for inner in table.get_children():
            yield from of(inner)

    found = set(of(symtable.symtable(_FUTURE + text, "<part>", "exec")))
    return found - {"__class__", "super"}


def _free_paths(text: str, module: str) -> set[str]:
    """As ``_free_names``; names of modules of this project with the attributes that follow them."""
    free = _free_names(text)
    modules = {
        word
        for word in free
        if (found := _meaning(module, word)).module and found.is_ours and not found.word
    }
    if not modules:
        return free
    tree, paths = ast.parse(text), set()
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    for node in ast.walk(tree):
        read = isinstance(node, ast.Attribute | ast.Name) and not isinstance(node.ctx, ast.Store)
        if read and id(node) not in inner:
            path = ast.unparse(node)
            if path.partition(".")[0] in modules and path.replace(".", "").isidentifier():
                paths.add(path)
    return (free - modules) | paths


def _renamed(name: Name, text: str, called: Mapping[Name, str]) -> str:
    """Definition with the names of the file for its dependencies.

    Attributes are unchanged, except those of modules of this project.
    """

    def word_here(found: re.Match[str]) -> str:
        meaning, used = _meaning_of_path(name.module, found[0])
        rest = found[0].split(".")[used:]
        return ".".join([called[meaning], *rest]) if meaning in called else found[0]

    return re.sub(r"(?<![.\w])[^\W\d]\w*(\.[^\W\d]\w*)*", word_here, text)
