"""Where compiled kernels are kept, and when they are compiled anew."""

from __future__ import annotations

import gc
import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numba
import numpy as np
import pytest
from conftest import ROOT

import baselines
import rendezvous_env
import train
from rendezvous_env import compilation, kernel_cache
from rendezvous_env.engine import step
from rendezvous_env.kernel_cache import folder_for

OUTER = """
from rendezvous_env.compilation import kernel
from .inner import half

@kernel
def f(x):
    return half(x) + 1.0
"""
INNER = """
from rendezvous_env.compilation import kernel

@kernel
def half(x):
    return {factor} * x
"""


def package(folder: Path, factor: float) -> None:
    (folder / "demo").mkdir(exist_ok=True)
    (folder / "demo" / "__init__.py").write_text("")
    (folder / "demo" / "outer.py").write_text(OUTER)
    (folder / "demo" / "inner.py").write_text(INNER.format(factor=factor))


def call(folder: Path, **environment: str) -> tuple[float, int, int]:
    """f(10) in a fresh process, and how often its compiled code was found and not found."""
    script = """
        from demo.outer import f
        value = f(10.0)
        print(value, sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))
    """
    value, hits, misses = python(textwrap.dedent(script), folder, **environment).stdout.split()
    return float(value), int(hits), int(misses)


def python(script: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh process that finds the packages in the folder, and ours."""
    path = f"{folder}{os.pathsep}{ROOT}"
    return subprocess.run(
        [sys.executable, "-c", script],
        check=True,
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, **environment},
        timeout=200,
    )


def test_an_edit_of_an_inlined_kernel_is_noticed(tmp_path):
    package(tmp_path, 0.5)
    assert call(tmp_path) == (6.0, 0, 1)
    assert call(tmp_path) == (6.0, 1, 0)  # from disk
    package(tmp_path, 0.25)  # outer.py, which inlines it, stays as it is
    assert call(tmp_path) == (3.5, 0, 1)
    package(tmp_path, 0.5)  # as another version beside this one, whose code is still there
    assert call(tmp_path) == (6.0, 1, 0)


@pytest.mark.parametrize("chosen", [False, True], ids=["own folder", "NUMBA_CACHE_DIR"])
@pytest.mark.parametrize("where", ["demo/deeper/inner.py", "demo/inner.py", "baselines/inner.py"])
def test_an_edit_anywhere_below_is_noticed(tmp_path, where, chosen):
    """In a sub-folder, in a constant, in another package of ours; in a cache of one's own, too."""
    inner = tmp_path / where
    names = ".".join(inner.relative_to(tmp_path).with_suffix("").parts)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "elsewhere")} if chosen else {}
    package(tmp_path, 0.5)
    for folder in (inner.parent, *inner.parent.parents):
        if folder == tmp_path:
            break
        folder.mkdir(exist_ok=True)
        (folder / "__init__.py").write_text("")
    (tmp_path / "demo" / "outer.py").write_text(
        "from rendezvous_env.compilation import kernel\n"
        f"from {names} import (\n    FACTOR as factor,\n)\n"
        "@kernel\ndef f(x):\n    return factor * x\n"
    )
    for factor in (2.0, 3.0):
        inner.write_text(f"FACTOR = {factor}\n")  # of the same size, in the same second
        assert call(tmp_path, **environment) == (10.0 * factor, 0, 1)
        assert call(tmp_path, **environment) == (10.0 * factor, 1, 0)
    if chosen:
        assert list((tmp_path / "elsewhere").rglob("*.nbi"))


def test_every_source_that_a_kernel_stands_on_counts():
    """By hand: what the learned policies' perception inlines or freezes, in two packages."""
    found = kernel_cache._with_imports(ROOT / "baselines" / "learned" / "perception.py")
    names = {str(path.relative_to(ROOT)) for path in found}
    assert {"baselines/learned/perception.py", "baselines/silhouettes.py"} <= names
    inlined = ("guarantee/heading", "equations/vectors", "compilation")
    assert {f"rendezvous_env/{name}.py" for name in inlined} <= names
    assert "rendezvous_env/simulator.py" not in names  # an edit of it need not compile anything


def test_a_kernel_of_a_lone_file_is_keyed_by_what_lies_beside_it(tmp_path):
    (tmp_path / "constants.py").write_text("FACTOR = 1.0\n")
    (tmp_path / "mine.py").write_text(
        "import constants, numpy\nfrom rendezvous_env.compilation import kernel\n"
    )
    found = {path.name for path in kernel_cache._with_imports(tmp_path / "mine.py")}
    assert found == {"mine.py", "constants.py", "compilation.py", "kernel_cache.py"}


def test_two_installations_leave_each_others_code_alone(tmp_path, monkeypatch):
    """They share the folder at home, since their own cannot be written to."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    found = []
    for name, factor in (("one", 0.5), ("two", 0.25)):
        (tmp_path / name).mkdir()
        package(tmp_path / name, factor)
        (tmp_path / name / "demo" / "__pycache__").write_text("in the way of the folder")
        found.append(Path(folder_for(tmp_path / name / "demo" / "inner.py")))
        assert found[-1].parent == tmp_path / "home" / ".cache" / "rendezvous-env" / "demo"
    assert found[0] != found[1] and all(folder.is_dir() for folder in found)
    ancient = found[0].parent / "kernels-of-old"
    ancient.mkdir()
    os.utime(ancient, (0, 0))
    kernel_cache._remove_unused.cache_clear()
    folder_for.cache_clear()
    folder_for(tmp_path / "two" / "demo" / "inner.py")
    assert not ancient.exists() and all(folder.is_dir() for folder in found)


@pytest.mark.parametrize("chosen", [False, True], ids=["folder and home", "NUMBA_CACHE_DIR"])
def test_a_cache_that_cannot_be_written_to_gives_one_warning(tmp_path, chosen):
    package(tmp_path, 0.5)
    (tmp_path / "demo" / "__pycache__").write_text("in the way of the folder")
    (tmp_path / "file").write_text("in the way, too")
    (tmp_path / "tmp").mkdir()
    places = {"HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path / "tmp")}
    if chosen:
        places["NUMBA_CACHE_DIR"] = str(tmp_path / "file")
    script = "from demo import outer, inner; print(outer.f(10.0))"
    for _ in range(2):
        found = python(script, tmp_path, **places)
        assert found.stdout.split() == ["6.0"]
        assert found.stderr.count("RuntimeWarning") == 1 and str(tmp_path / "tmp") in found.stderr
    assert list((tmp_path / "tmp").rglob("*.nbc"))
    places["TMPDIR"] = str(tmp_path / "file")  # no place at all
    script = "import tempfile; tempfile.tempdir = '/dev/null'; " + script
    assert python(script, tmp_path, **places).stdout.split() == ["6.0"]


def test_a_temporary_folder_of_somebody_else_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    own = kernel_cache._temporary_place()
    assert own.parent == tmp_path and own == kernel_cache._temporary_place()
    own.chmod(0o777)
    other = kernel_cache._temporary_place()
    assert other != own and other.parent == tmp_path and not other.stat().st_mode & 0o77


def test_without_any_place_kernels_are_compiled_all_the_same(tmp_path, monkeypatch):
    def nowhere():
        raise FileNotFoundError("no usable temporary directory")

    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "file")
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    (tmp_path / "file").write_text("in the way")
    package(tmp_path, 0.5)
    (tmp_path / "demo" / "__pycache__").write_text("in the way of the folder")
    kernel_cache._warn_once.cache_clear()
    with pytest.warns(RuntimeWarning, match="no place for compiled code.*made anew each time"):
        assert folder_for(tmp_path / "demo" / "inner.py") is None


@pytest.mark.parametrize("suffix", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("damage", ["empty", "truncated", "random"])
def test_damaged_files_of_the_cache_are_compiled_anew(tmp_path, suffix, damage):
    package(tmp_path, 0.5)
    call(tmp_path)
    for file in (tmp_path / "demo" / "__pycache__").rglob(suffix):
        content = file.read_bytes()
        random = np.random.default_rng(0).bytes(len(content))
        file.write_bytes(
            {"empty": b"", "truncated": content[: len(content) // 2]}.get(damage, random)
        )
    assert call(tmp_path) == (6.0, 0, 1)
    assert call(tmp_path) == (6.0, 1, 0)  # and kept


def test_bounds_checked_code_is_kept_apart(tmp_path):
    package(tmp_path, 0.5)
    call(tmp_path, NUMBA_BOUNDSCHECK="0")
    assert call(tmp_path, NUMBA_BOUNDSCHECK="1") == (6.0, 0, 1)
    assert call(tmp_path, NUMBA_BOUNDSCHECK="0") == (6.0, 1, 0)


def test_bounds_are_checked_in_inlined_kernels_too(tmp_path):
    """Which count no references: an error has to get through them all the same."""
    (tmp_path / "reading.py").write_text(
        "import numpy as np\nfrom rendezvous_env.compilation import inlined_kernel, kernel\n"
        "@inlined_kernel\ndef at(arrays, k):\n    return arrays[0][k]\n"
        "@kernel\ndef read(x, k):\n    return at((x, x), k)\n"
        "try:\n    read(np.zeros(3), 3)\nexcept IndexError as error:\n    print(error)\n"
    )
    found = python("import reading", tmp_path, NUMBA_BOUNDSCHECK="1")
    assert found.stdout == "index is out of bounds\n"


def test_kernels_are_serial_release_the_lock_and_divide_like_ieee():
    options = step.step_blocks.targetoptions
    assert options["nogil"] and options["error_model"] == "numpy"
    assert not options.get("fastmath") and not options.get("parallel")

    @compilation.kernel
    def inverse(x):
        return 1.0 / x

    assert inverse(0.0) == float("inf")


@pytest.mark.parametrize(
    "decorate", ["kernel", "inlined_kernel", "inlined_entry", "unfolded_kernel"]
)
def test_a_kernel_may_not_allocate(decorate):
    @getattr(compilation, decorate)
    def zeros(n):
        return np.zeros(n).sum()

    @compilation.kernel
    def caller(n):
        return zeros(n)

    with pytest.raises(numba.core.errors.NumbaError, match=r"(?i)nrt|allocat|zeros"):
        caller(3)


def test_an_allocating_kernel_may_allocate_and_return_arrays():
    @compilation.allocating_kernel
    def zeros(n):
        return np.zeros(n)

    assert zeros(3).tolist() == [0.0, 0.0, 0.0]


def all_kernels():
    """Every kernel of the three packages, by the module and name it was written under."""
    found = {}
    for package in (rendezvous_env, baselines, train):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".adapters." in module.name:  # needs a learning library each, and has no kernels
                continue
            for function in vars(importlib.import_module(module.name)).values():
                if hasattr(function, "py_func"):
                    found[f"{function.__module__}.{function.__qualname__}"] = function
    return found


def test_no_kernel_that_counts_no_references_returns_an_array():
    """Nobody would have counted that reference: the array would be freed while it is in use. It is
    refused when it is compiled, so that this holds whether or not code was found on disk.
    """

    @compilation.inlined_entry
    def itself(x):
        return x

    @compilation.inlined_entry
    def within(x):
        return 1, (2.0, x)

    @compilation.kernel
    def caller(x):
        return within(x)[0]

    @compilation.kernel
    def lonely(x):
        return x

    ones = np.ones(3)
    assert itself(2.0) == 2.0
    for function in (itself, within, caller, lonely):
        with pytest.raises(numba.core.errors.TypingError, match="may return no array"):
            function(ones)
    kernels = all_kernels()
    assert all("_nrt" in kernel.targetoptions for kernel in kernels.values())
    uncounted = {name: k for name, k in kernels.items() if not k.targetoptions["_nrt"]}
    unchecked = {
        name
        for name, kernel in uncounted.items()
        if kernel._compiler.compile.__name__ != "compile_checked"
    }
    assert not unchecked
    folders = {name.rpartition(".")[0].rpartition(".")[0] for name in uncounted}
    assert {f"rendezvous_env.{name}" for name in ("equations", "engine", "guarantee")} <= folders
    assert len(uncounted) > 100


def test_the_setting_of_numba_is_left_as_it_was():
    before = numba.config.CACHE_DIR
    with pytest.raises(RuntimeError), kernel_cache.cache_in("/tmp/somewhere"):
        raise RuntimeError
    assert before == numba.config.CACHE_DIR


@pytest.mark.skipif(bool(numba.config.CACHE_DIR), reason="another place was chosen")
def test_this_package_keeps_its_kernels_beside_its_sources():
    here = Path(step.__file__)
    if os.access(here.parent, os.W_OK):
        assert Path(folder_for(here)).parent == here.parent / "__pycache__"


# ---- what only kernels call ---------------------------------------------------------------------


@compilation.inner_kernel
def halved(x):
    return 0.5 * x


@compilation.inlined_kernel
def doubled(x):
    return 2.0 * x


@compilation.unfolded_kernel
def squared(x):
    return x * x


@compilation.kernel
def through_all(x):
    return squared(doubled(halved(x)) + 1.0)


@pytest.mark.skipif(not compilation.compiled(), reason="plain Python calls what it likes")
def test_what_only_kernels_call_refuses_python():
    for inner in (halved, doubled, squared):
        with pytest.raises(TypeError, match="by other kernels only"):
            inner(3.0)
    assert through_all(3.0) == 16.0
    for inner in (halved, doubled, squared):  # compiled by now, most of them, and still no entry
        with pytest.raises(TypeError, match=inner.py_func.__name__):
            inner(3.0)
    assert not squared.overloads


@pytest.mark.skipif(not compilation.compiled(), reason="nothing is compiled")
@pytest.mark.parametrize("at_work", [True, False])
def test_the_collector_rests_while_compiling_and_no_longer(at_work, monkeypatch):
    seen = []
    monkeypatch.setattr(compilation, "keep", lambda dispatcher: None)  # else it is found again

    @compilation.kernel
    def doubled_again(x):
        return 2.0 * x

    @compilation.kernel
    def around(x):
        return doubled_again(x)

    for kernel in (doubled_again, around):  # the inner one ends first
        # beneath what lets the collector rest, which stands where numba would call this
        inner = kernel._compiler
        monkeypatch.setattr(
            inner,
            "_compile_cached",
            lambda *a, real=inner._compile_cached: (seen.append(gc.isenabled()), real(*a))[1],
        )
    was_at_work = gc.isenabled()
    (gc.enable if at_work else gc.disable)()
    try:
        assert around(3.0) == 6.0
        assert seen == [False, False] and gc.isenabled() == at_work
        with pytest.raises(numba.core.errors.NumbaError):
            around("three")
        assert gc.isenabled() == at_work
    finally:
        (gc.enable if was_at_work else gc.disable)()
