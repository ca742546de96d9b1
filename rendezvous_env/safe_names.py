"""``rendezvous_env.baselines`` and ``rendezvous_env.train``: aliases safe from shadowing.

A user's ``train.py`` or folder ``baselines`` shadows these packages, but not their aliases. Without
shadowing both names are the same modules, loaded once.
"""

import sys
from collections.abc import Sequence
from importlib import import_module, util
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

_BESIDE = Path(__file__).absolute().parents[1]
_PACKAGE = __name__.partition(".")[0]
_NAMES = ("baselines", "train")


class _SameModule(Loader):
    """Loader that returns a module loaded under its short name."""

    def __init__(self, short: str) -> None:
        self._short = short

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(self._short)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # the import has set the alias's spec


class _SafeNames(MetaPathFinder):
    """Finder of the packages beside this one, and their modules, under ``rendezvous_env``."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        package, _, short = fullname.partition(".")
        top = short.partition(".")[0]
        if package != _PACKAGE or top not in _NAMES:
            return None
        if not _is_hidden(top):
            spec = util.find_spec(short)
            return spec and util.spec_from_loader(
                fullname, _SameModule(short), is_package=bool(spec.submodule_search_locations)
            )
        return PathFinder.find_spec(fullname, [str(_BESIDE)]) if top == short else None


def _is_hidden(top: str) -> bool:
    """True if another module shadows the short name."""
    ours = str(_BESIDE / top / "__init__.py")
    if (module := sys.modules.get(top)) is not None:
        return getattr(module, "__file__", None) != ours
    found = util.find_spec(top)
    return found is None or found.origin != ours


def install() -> None:
    """Install the import finder of the aliases."""
    if not any(isinstance(finder, _SafeNames) for finder in sys.meta_path):
        sys.meta_path.insert(0, _SafeNames())
