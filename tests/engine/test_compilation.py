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
from typing import NamedTuple

import numba
import numpy as np
import pytest
from conftest import ROOT

import baselines
import rendezvous_env
import train
from rendezvous_env import compilation, kernel_cache
from rendezvous_env.engine.stages.step import step_blocks
from rendezvous_env.physics import crossings, random_streams, vectors

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
CONSTANTS = "FACTOR = {factor}\n"
HELD = "def made():\n    return {factor}\n"
WAYS = {
    "a module's attribute": ("import demo.deeper.found as found", CONSTANTS, "found.FACTOR"),
    "a closure": (
        "from demo.deeper.found import made\ndef around(factor):\n    @kernel\n    def g(x):\n"
        "        return factor * x\n    return g\ng = around(made())",
        HELD,
        "g(1.0)",
    ),
    "a plain function": (
        "import numba\nfrom demo.deeper.found import made\nmade = numba.njit(made)",
        HELD,
        "made()",
    ),
    "what is chosen by type": (
        "from typing import NamedTuple\nfrom rendezvous_env.compilation import by_type\n"
        "from demo.deeper import found\nclass Kind(NamedTuple):\n    x: float\n"
        "@kernel\ndef ours(kind):\n    return found.FACTOR * kind.x\n"
        "@by_type('kind', {Kind: ours}.__getitem__)\ndef ask(kind):\n    pass",
        CONSTANTS,
        "ask(Kind(1.0))",
    ),
    "what stands in for a plain function": (
        "from rendezvous_env.compilation import chosen_by_type\n"
        "from demo.deeper import found\ndef ask(y):\n    pass\n@chosen_by_type(ask)\n"
        "def stand_in(y):\n    factor = found.FACTOR\n    return lambda y: factor * y",
        CONSTANTS,
        "ask(1.0)",
    ),
    "in another package of ours": ("from baselines.found import FACTOR", CONSTANTS, "FACTOR"),
}


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
    """A fresh process that finds the packages in the folder, and ours, and no kernel of others."""
    path = f"{folder}{os.pathsep}{ROOT}"
    return subprocess.run(
        [sys.executable, "-c", script],
        check=True,
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder), **environment},
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


@pytest.mark.parametrize("way", WAYS)
def test_an_edit_of_whatever_a_kernel_freezes_is_noticed(tmp_path, way):
    """In a cache of one's own, too."""
    importing, text, asked = WAYS[way]
    where = tmp_path / ("baselines" if "baselines" in importing else "demo/deeper")
    package(tmp_path, 0.5)
    where.mkdir()
    (where / "__init__.py").touch()
    (tmp_path / "demo" / "outer.py").write_text(
        f"from rendezvous_env.compilation import kernel\n{importing}\n"
        f"@kernel\ndef f(x):\n    return {asked} * x\n"
    )
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "elsewhere")}
    for factor in (2.0, 3.0):
        (where / "found.py").write_text(text.format(factor=factor))  # as long, in the same second
        assert call(tmp_path, **place) == (10.0 * factor, 0, 1)
        assert call(tmp_path, **place) == (10.0 * factor, 1, 0)
    assert list((tmp_path / "elsewhere").rglob("f-*.code"))


def test_an_edit_of_the_environment_makes_only_what_depends_on_it_anew(monkeypatch):
    def contents():
        kernels = random_streams.uniform, step_blocks, vectors.dot, crossings.first_crossing
        return ["".join(kernel_cache._content(k, frozenset(), set())) for k in kernels]

    before = contents()
    monkeypatch.setattr(random_streams, "_INCREMENT", np.uint64(1))
    changed = [old != new for old, new in zip(before, contents(), strict=True)]
    assert changed == [True, True, False, False]


def test_an_edited_docstring_or_comment_makes_nothing_anew(tmp_path):
    package(tmp_path, 0.5)
    call(tmp_path)
    text = OUTER.replace("    return", '    """Half and one."""  # more lines\n\n    return')
    (tmp_path / "demo" / "outer.py").write_text(text)
    assert call(tmp_path) == (6.0, 1, 0)


def test_functions_of_one_name_from_two_processes_are_told_apart(tmp_path):
    """Each of these callers holds an f of its own, the first function that its process compiled."""
    (tmp_path / "closures.py").write_text(
        "import math\nfrom rendezvous_env.compilation import kernel\ndef made(k):\n"
        "    @kernel\n    def f(x):\n        for _ in range(int(x)):\n"
        "            x = math.sin(x + k) + math.exp(-x * k) + math.atan2(x, k) + math.cos(k * x)\n"
        "        return x\n    return f\nf, g = made(1.0), made(2.0)\n"
        "@kernel\ndef one(x):\n    return f(x) + f(x + 1.0) + f(x + 2.0)\n"
        "@kernel\ndef two(x):\n    return g(x) + g(x + 1.0) + g(x + 2.0)\n"
    )
    one, two, both = (
        python(f"from closures import one, two; print({asked})", tmp_path).stdout.split()
        for asked in ("one(5.0)", "two(5.0)", "one(5.0), two(5.0)")
    )
    assert both == one + two and one != two


@pytest.mark.slow
def test_the_step_is_made_from_nothing_else(tmp_path):
    """Whatever numba compiles for a step and a reset is among what their code is named after."""
    script = """
        import numpy as np
        from numba.core.bytecode import FunctionIdentity
        import rendezvous_env as rv
        from rendezvous_env import kernel_cache
        from rendezvous_env.engine.reset.starts import reset_teams
        from rendezvous_env.engine.stages.step import first_not_finite, step_blocks

        compiled, identify = set(), FunctionIdentity.from_function.__func__

        def noted(kind, function):
            found = identify(kind, function)
            compiled.add(f"{found.func.__module__} {found.func.__qualname__}")
            return found

        FunctionIdentity.from_function = classmethod(noted)
        field = rv.ObstacleField(count=1, radius=(0.3, 0.5), region=8.0, keep_out=0.5)
        sensing = rv.Sensing(noise=0.1, occlusion="both", delay=1)
        robots = {"n_robots": 3, "robot_model": "unicycle", "graph": rv.graphs.directed_cycle()}
        teams = rv.Simulator(rv.Scenario(**robots, obstacles=field, sensing=sensing))
        teams.reset(seed=0)
        teams.step(np.zeros((1, 3, 2)))
        texts = set()
        for kernel in (reset_teams, step_blocks, first_not_finite):
            kinds = [kind for a in kernel.signatures[0] for kind in kernel_cache._named_tuples(a)]
            texts |= set(kernel_cache._content((kernel, *kinds), frozenset(), set()))
        ours = {name for name in compiled if name.startswith("rendezvous_env")}
        print(len(ours), sorted(n for n in ours - texts if not n.endswith("<lambda>")))
    """
    count, _, left = python(textwrap.dedent(script), tmp_path).stdout.partition(" ")
    assert int(count) > 100 and left.strip() == "[]"


class Own(NamedTuple):
    """Constants of a kind that somebody else's functions are chosen by."""

    factor: float


@pytest.mark.skipif(not compilation.compiled(), reason="nothing is compiled")
def test_code_for_a_type_is_made_from_the_functions_that_it_chooses(tmp_path, monkeypatch):
    def misses():
        @compilation.kernel
        def first(x):
            return x[0].factor

        assert first((Own(3.0),)) == 3.0
        return sum(first.stats.cache_misses.values())

    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)
    found = []
    for chosen in (lambda: 1, lambda: 1, lambda: 2):
        kernel_cache.depends_on(Own, (chosen,))
        found.append(misses())
        found.append(misses())
    assert found == [1, 0, 1, 0, 1, 0] or found == [1, 0, 0, 0, 1, 0]
    monkeypatch.setattr(Own, "__module__", "__main__")
    assert misses() == misses() == 1  # no later process finds a type of the script that is run


def test_what_nobody_used_for_long_is_removed(tmp_path):
    package(tmp_path, 0.5)
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "place")}
    call(tmp_path, **place)
    (ancient,) = (tmp_path / "place" / "kernels").glob("half-*")
    os.utime(ancient, (0, 0))
    assert call(tmp_path, **place) == (6.0, 1, 0)
    assert not ancient.exists()


@pytest.mark.parametrize("chosen", [False, True], ids=["folder and home", "NUMBA_CACHE_DIR"])
def test_a_cache_that_cannot_be_written_to_gives_one_warning(tmp_path, chosen):
    package(tmp_path, 0.5)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "tmp").mkdir()
    places = {"HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path / "tmp")}
    script = "from demo import outer, inner; print(outer.f(10.0))"
    if chosen:
        places["NUMBA_CACHE_DIR"] = str(tmp_path / "file")
    else:
        script = (
            "import pathlib; from rendezvous_env import kernel_cache;"
            "kernel_cache._BESIDE = pathlib.Path(kernel_cache.__file__, 'file');" + script
        )
        places["NUMBA_CACHE_DIR"] = ""
    for _ in range(2):
        found = python(script, tmp_path, **places)
        assert found.stdout.split() == ["6.0"]
        assert found.stderr.count("RuntimeWarning") == 1 and str(tmp_path / "tmp") in found.stderr
    assert list((tmp_path / "tmp").rglob("*.code"))
    places["TMPDIR"] = str(tmp_path / "file")  # no place at all
    script = "import tempfile; tempfile.tempdir = '/dev/null'; " + script
    found = python(script, tmp_path, **places)
    assert found.stdout.split() == ["6.0"] and "made anew each time" in found.stderr


def test_a_temporary_folder_of_somebody_else_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    temporary = kernel_cache._temporary
    own = temporary().parent
    assert own.parent == tmp_path and own == temporary().parent
    own.chmod(0o777)
    other = temporary().parent
    assert other != own and other.parent == tmp_path and not other.stat().st_mode & 0o77


@pytest.mark.parametrize("damage", ["empty", "truncated", "one bit", "its digest"])
def test_damaged_code_is_compiled_anew(tmp_path, damage):
    """Machine code with one bit flipped would end the process, so it is not given to it."""
    package(tmp_path, 0.5)
    place = {"NUMBA_CACHE_DIR": str(tmp_path)}
    call(tmp_path, **place)
    for file in (tmp_path / "kernels").iterdir():
        content = bytearray(file.read_bytes())
        content[0 if damage == "its digest" else len(content) // 2] ^= 4
        kinds = {"empty": b"", "truncated": content[: len(content) // 2]}
        file.write_bytes(kinds.get(damage, bytes(content)))
    assert call(tmp_path, **place) == (6.0, 0, 1)
    assert call(tmp_path, **place) == (6.0, 1, 0)  # and kept


def test_bounds_checked_code_is_kept_apart(tmp_path):
    package(tmp_path, 0.5)
    call(tmp_path, NUMBA_BOUNDSCHECK="0")
    assert call(tmp_path, NUMBA_BOUNDSCHECK="1") == (6.0, 0, 1)
    assert call(tmp_path, NUMBA_BOUNDSCHECK="0") == (6.0, 1, 0)


def test_bounds_are_checked_in_inlined_kernels_too(tmp_path):
    """Which count no references: an error has to get through them all the same."""
    (tmp_path / "reading.py").write_text(
        "import numpy as np\nfrom rendezvous_env.compilation import inner_kernel, kernel\n"
        "@inner_kernel(inline='code')\ndef at(arrays, k):\n    return arrays[0][k]\n"
        "@kernel\ndef read(x, k):\n    return at((x, x), k)\n"
        "try:\n    read(np.zeros(3), 3)\nexcept IndexError as error:\n    print(error)\n"
    )
    found = python("import reading", tmp_path, NUMBA_BOUNDSCHECK="1")
    assert found.stdout == "index is out of bounds\n"


@pytest.mark.parametrize("inline", ["never", "code", "text"])
@pytest.mark.parametrize("decorate", ["kernel", "inner_kernel"])
def test_a_kernel_may_not_allocate(decorate, inline):
    @getattr(compilation, decorate)(inline=inline)
    def zeros(n):
        return np.zeros(n).sum()

    @compilation.kernel
    def caller(n):
        return zeros(n)

    with pytest.raises(numba.core.errors.NumbaError, match=r"(?i)nrt|allocat|zeros"):
        caller(3)


def test_an_allocating_kernel_may_allocate_and_return_arrays():
    @compilation.kernel(allocates=True)
    def zeros(n):
        return np.zeros(n)

    assert zeros(3).tolist() == [0.0, 0.0, 0.0]


def all_kernels():
    """Every kernel of the three packages, by the module and name it was written under."""
    found = {}
    for package in (rendezvous_env, baselines, train):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if {"adapters", "pixels"} & {*module.name.split(".")}:
                continue  # without kernels, and each needs a library of its own
            for function in vars(importlib.import_module(module.name)).values():
                if hasattr(function, "py_func"):
                    found[f"{function.__module__}.{function.__qualname__}"] = function
    return found


def test_no_kernel_that_counts_no_references_returns_an_array():
    """Nobody would have counted that reference: the array would be freed while it is in use. It is
    refused when it is compiled, so that this holds whether or not code was found on disk.
    """

    @compilation.kernel(inline="code")
    def itself(x):
        return x

    @compilation.kernel(inline="code")
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
    del kernels["train.bench.cases.bare_step"]  # numba's alone: what steps are measured against
    assert all("_nrt" in kernel.targetoptions for kernel in kernels.values())
    uncounted = {name: k for name, k in kernels.items() if not k.targetoptions["_nrt"]}
    folders = {name.rpartition(".")[0].rpartition(".")[0] for name in uncounted}
    assert {f"rendezvous_env.{name}" for name in ("physics", "engine", "safety")} <= folders
    assert len(uncounted) > 100


# ---- what only kernels call ---------------------------------------------------------------------


@compilation.inner_kernel
def halved(x):
    return 0.5 * x


@compilation.inner_kernel(inline="code")
def doubled(x):
    return 2.0 * x


@compilation.inner_kernel(inline="text")
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
    monkeypatch.setattr(kernel_cache, "_folder", lambda: None)  # else it is found again

    @compilation.kernel
    def doubled_again(x):
        return 2.0 * x

    @compilation.kernel
    def around(x):
        return doubled_again(x)

    for kernel in (doubled_again, around):  # the inner one ends first
        inner = kernel._compiler
        monkeypatch.setattr(
            inner,
            "compile",
            lambda *a, real=inner.compile: (seen.append(gc.isenabled()), real(*a))[1],
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
