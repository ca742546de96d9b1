"""Coverage of kernels in a test run: ``pytest -m kernels --every-kernel``.

With this option compiled kernels record that they run. The test run fails unless every kernel of
the packages has run at least once. ``make test-kernels`` combines it with ``NUMBA_BOUNDSCHECK=1``,
which checks every index of every kernel.

When a kernel is lowered to LLVM, a store of 1 into a table of bytes is inserted at its beginning.
The table is an external symbol, so compiled code from the disk finds it in any process of the test
run. The run has a separate kernel cache, since other processes lack the symbol.
"""

import ctypes
import gc
import hashlib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType
from typing import Any

import llvmlite.binding
import numba
import pytest
from llvmlite import ir
from numba.core import lowering
from numba.core.dispatcher import Dispatcher

from rendezvous_env import kernel_cache

PACKAGES = "rendezvous_env", "baselines", "train"
SIZE = 2**24
SYMBOL = "rendezvous_kernel_runs"
_table = (ctypes.c_uint8 * SIZE)()


def place(name: str) -> int:
    """Index of a kernel in the table, equal in every process."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:3])


def is_ours(module: str) -> bool:
    """Whether a module belongs to the tested packages."""
    return module.partition(".")[0] in PACKAGES


def record() -> None:
    """Make every kernel compiled from now on record its execution."""
    llvmlite.binding.add_symbol(SYMBOL, ctypes.addressof(_table))
    pre_lower = lowering.Lower.pre_lower

    def marked(self: Any) -> None:
        pre_lower(self)
        function = self.func_ir.func_id
        if not is_ours(function.modname):
            return
        byte = ir.IntType(8)
        table = self.module.globals.get(SYMBOL) or ir.GlobalVariable(
            self.module, ir.ArrayType(byte, SIZE), SYMBOL
        )
        index = place(f"{function.modname}.{function.func_qualname}")
        at = self.builder.gep(table, [ir.IntType(32)(0), ir.IntType(32)(index)])
        self.builder.store(byte(1), at)

    lowering.Lower.pre_lower = marked


def loaded() -> dict[str, Dispatcher]:
    """Kernels of the packages in the modules imported so far, by module and name."""
    gc.unfreeze()  # code that froze its objects hides them from ``get_objects``
    made = [one for one in gc.get_objects() if issubclass(type(one), Dispatcher)]
    return {_name(one): one for one in made if is_ours(str(one.py_func.__module__))}


def kernels() -> dict[str, Dispatcher]:
    """All kernels of the packages, by module and name."""
    for package in map(import_module, PACKAGES):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            try:
                import_module(module.name)
            except (ImportError, AttributeError):  # an adapter whose library is absent or replaced
                assert "adapters" in module.name or "pixels" in module.name, module.name
    found = loaded()
    assert len({place(name) for name in found}) == len(found), "two kernels share a place"
    return found


def _name(kernel: Dispatcher) -> str:
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"


def missing(ran: set[str]) -> list[str]:
    """Kernels that were neither executed nor inlined into an executed one."""
    known = kernels()
    seen, left = set(), [known[name] for name in ran if name in known]
    while left:
        kernel = left.pop()
        seen.add(_name(kernel))
        left += [
            one
            for one in _named(kernel)
            if one.targetoptions.get("inline") == "always" and _name(one) not in seen
        ]
    return sorted(known.keys() - seen)


def _named(kernel: Dispatcher) -> Iterator[Dispatcher]:
    """Kernels referenced by a kernel, directly or as attributes of modules."""
    function = kernel.py_func
    codes = [
        function.__code__,
        *filter(lambda c: hasattr(c, "co_names"), function.__code__.co_consts),
    ]
    names = {name for code in codes for name in code.co_names}
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    values = [function.__globals__[name] for name in names if name in function.__globals__] + held
    for module in [value for value in values if isinstance(value, ModuleType)]:
        values += [getattr(module, name) for name in names if hasattr(module, name)]
    yield from (value for value in values if isinstance(value, Dispatcher))


class EveryKernel:
    """Plugin of ``--every-kernel``; with xdist it combines the records of its workers."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        numba.config.CACHE_DIR = str(folder)
        assert kernel_cache._folder().is_relative_to(folder), "kernels were loaded too early"
        self._ran: set[str] = set()
        self._missing: list[str] = []
        self._worker_output = getattr(config, "workeroutput", None)
        record()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._ran |= {*getattr(node, "workeroutput", {}).get("kernels", ())}

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self._ran |= {name for name in loaded() if _table[place(name)]}
        if self._worker_output is not None:
            self._worker_output["kernels"] = sorted(self._ran)
            return
        self._missing = missing(self._ran)
        if self._missing and not session.exitstatus:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        total = len(kernels())
        terminalreporter.write_sep("=", f"{total - len(self._missing)} of {total} kernels ran")
        for name in self._missing:
            terminalreporter.write_line(f"never ran: {name}", red=True)
