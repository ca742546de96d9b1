"""Kernel cache: location and invalidation."""

import os
import shutil
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from conftest import ROOT, run_python
from parameters import first_fast, slow

from rendezvous_env import compilation, kernel_cache
from rendezvous_env.engine.memory import transposition
from rendezvous_env.engine.stages.apply_noise import apply_noise
from rendezvous_env.engine.stages.write_observations import write_observations
from rendezvous_env.physics import crossings, random_streams, vectors

KERNEL = "from rendezvous_env.compilation import by_type, kernel\n"
OUTER = KERNEL + "from .inner import half\n@kernel\ndef f(x):\n    return half(x) + 1.0\n"
INNER = KERNEL + "@kernel\ndef half(x):\n    return {factor} * x\n"
CONSTANT = "FACTOR = {factor}\n"
HELD = "def made():\n    return {factor}\n"
WAYS = {
    "attribute": ("import demo.found as found", CONSTANT, "found.FACTOR"),
    "closure": (
        "from demo.found import made\ndef around(factor):\n    @kernel\n    def g(x):\n"
        "        return factor * x\n    return g\ng = around(made())",
        HELD,
        "g(1.0)",
    ),
    "plain": ("import numba\nfrom demo.found import made\nmade = numba.njit(made)", HELD, "made()"),
    "by_type": (
        "from typing import NamedTuple\nfrom demo import found\n"
        "class Kind(NamedTuple):\n    x: float\n"
        "@kernel\ndef ours(kind):\n    return found.FACTOR * kind.x\n"
        "@by_type('kind', {Kind: ours}.__getitem__)\ndef ask(kind):\n    pass",
        CONSTANT,
        "ask(Kind(1.0))",
    ),
    "constant_by_type": (
        "from demo import found\n@by_type('y', lambda kind: found.FACTOR)\ndef ask(y):\n    pass",
        CONSTANT,
        "ask(None)",
    ),
}
"""Ways in which a kernel freezes a number of another file: imports and accesses."""
BARE = (
    "import sys, types; bare = sys.modules['rendezvous_env'] = types.ModuleType('rendezvous_env'); "
    f"bare.__path__ = [{str(ROOT / 'rendezvous_env')!r}]; "
)
"""Import only the necessary part of the package, to save time."""


def package(folder: Path, factor: float) -> None:
    (folder / "demo").mkdir(exist_ok=True)
    (folder / "demo" / "__init__.py").touch()
    (folder / "demo" / "outer.py").write_text(OUTER)
    (folder / "demo" / "inner.py").write_text(INNER.format(factor=factor))


def call(folder: Path, **environment: str) -> tuple[float, int, int]:
    """f(10) in a new process, and the numbers of cache hits and misses."""
    script = (
        f"{BARE}from demo.outer import f; print(f(10.0), "
        "sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))"
    )
    value, hits, misses = python(script, folder, **environment).stdout.split()
    return float(value), int(hits), int(misses)


def python(script: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A new process with the packages of the folder and of this project, and an empty cache."""
    ours = {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "NUMBA_CACHE_DIR": str(folder)}
    return run_python(folder, "-c", script, **ours | environment)


@pytest.mark.nightly
def test_cache_keeps_code_by_its_source_and_removes_what_is_long_unused(tmp_path):
    """An edit of an inlined kernel is noticed, an edit of a docstring is not."""
    package(tmp_path, 0.5)
    assert call(tmp_path) == (6.0, 0, 1)
    text = OUTER.replace("    return", '    """Half and one."""  # more lines\n\n    return')
    (tmp_path / "demo" / "outer.py").write_text(text)
    assert call(tmp_path) == (6.0, 1, 0)  # from disk
    package(tmp_path, 0.25)  # outer.py, which inlines it, stays as it is
    assert call(tmp_path) == (3.5, 0, 1)
    package(tmp_path, 0.5)  # as another version beside this one, whose code is still there
    assert call(tmp_path) == (6.0, 1, 0)
    assert call(tmp_path, NUMBA_BOUNDSCHECK="1") == (6.0, 0, 1)  # kept apart
    for file in (tmp_path / "demo" / name for name in ("inner.py", "outer.py")):
        before = file.read_text()
        file.write_text(before.replace("@kernel", "@kernel(allocates=True)"))
        assert call(tmp_path) == (6.0, 0, 1)
        file.write_text(before)
        assert call(tmp_path) == (6.0, 1, 0)
    (ancient, *_) = (tmp_path / "kernels").glob("half-*")
    os.utime(ancient, (0, 0))  # nobody has used it for long
    assert call(tmp_path) == (6.0, 1, 0)
    assert not ancient.exists()


def test_cache_notices_an_edit_of_what_a_kernel_freezes(tmp_path):
    """Also in a separate cache."""
    package(tmp_path, 0.5)
    for way, (importing, _, asked) in WAYS.items():
        lines = f"{KERNEL}{importing}\n@kernel\ndef f(x):\n    return {asked} * x\n"
        (tmp_path / "demo" / f"{way}.py").write_text(lines.replace("found", f"found_{way}"))
    script = BARE + "; ".join(
        f"from demo.{way} import f; print(f(10.0), sum(f.stats.cache_misses.values()))"
        for way in WAYS
    )
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "elsewhere")}
    for factor in (2.0, 3.0):
        for way, (_, text, _) in WAYS.items():  # as long, in the same second
            (tmp_path / "demo" / f"found_{way}.py").write_text(text.format(factor=factor))
        for misses in (1, 0):
            found = python(script, tmp_path, **place).stdout.splitlines()
            assert found == [f"{10.0 * factor} {misses}"] * len(WAYS)
    assert list((tmp_path / "elsewhere").rglob("f-*.code"))


def test_cache_recompiles_only_dependants_of_an_edit(monkeypatch):
    def contents():
        kernels = random_streams.word_of, apply_noise, vectors.dot, crossings.first_crossing
        return ["".join(kernel_cache.content(kernel)) for kernel in kernels]

    before = contents()
    monkeypatch.setattr(random_streams, "_INCREMENT", np.uint64(1))
    changed = [old != new for old, new in zip(before, contents(), strict=True)]
    assert changed == [True, True, False, False]


def test_cache_key_covers_the_code_that_an_intrinsic_generates(monkeypatch):
    before = list(kernel_cache.content(write_observations))
    assert list(kernel_cache.content(write_observations)) == before
    monkeypatch.setattr(transposition, "_HIGH", (3, 2, 7, 6))
    assert list(kernel_cache.content(write_observations)) != before


@pytest.mark.slow
def test_cache_tells_apart_functions_of_one_name_from_two_processes(tmp_path):
    """Each caller contains a different f, the first function compiled by its process."""
    (tmp_path / "closures.py").write_text(
        f"import math\n{KERNEL}def made(k):\n"
        "    @kernel\n    def f(x):\n        for _ in range(int(x)):\n"
        "            x = math.sin(x + k) + math.exp(-x * k) + math.atan2(x, k) + math.cos(k * x)\n"
        "        return x\n    return f\nf, g = made(1.0), made(2.0)\n"
        "@kernel\ndef one(x):\n    return f(x) + f(x + 1.0) + f(x + 2.0)\n"
        "@kernel\ndef two(x):\n    return g(x) + g(x + 1.0) + g(x + 2.0)\n"
    )
    one, two, both = (
        python(f"{BARE}from closures import one, two; print({asked})", tmp_path).stdout.split()
        for asked in ("one(5.0)", "two(5.0)", "one(5.0), two(5.0)")
    )
    assert both == one + two and one != two


@pytest.mark.slow
def test_cache_key_of_the_step_covers_all_that_is_compiled(tmp_path):
    """All code that numba compiles for a step and a reset is part of its key."""
    script = """
        import numpy as np
        from numba.core.bytecode import FunctionIdentity
        import rendezvous_env as rv
        from rendezvous_env import kernel_cache
        from rendezvous_env.engine.step import first_not_finite
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
        stages, starts = teams._runner._stages, teams._episodes
        called = [*stages._entries, *(kernel for kernel, _ in starts._entries), first_not_finite]
        for kernel in called:
            kinds = [kind for a in kernel.signatures[0] for kind in kernel_cache.named_tuples(a)]
            texts |= set(kernel_cache.content(kernel, *kinds))
        ours = {name for name in compiled if name.startswith("rendezvous_env")}
        print(len(ours), sorted(n for n in ours - texts if not n.endswith("<lambda>")))
    """
    count, _, left = python(textwrap.dedent(script), tmp_path).stdout.partition(" ")
    assert int(count) > 100 and left.strip() == "[]"


class Own(NamedTuple):
    """Constants of a kind used in function dispatch elsewhere."""

    factor: float


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """Empty kernel cache of this process."""
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.usefixtures("own_folder")
def test_cache_key_of_a_type_covers_the_functions_that_it_chooses(monkeypatch):
    def misses():
        @compilation.kernel
        def first(x):
            return x[0].factor

        assert first((Own(3.0),)) == 3.0
        return sum(first.stats.cache_misses.values())

    found = []
    for chosen in (lambda: 1, lambda: 1, lambda: 2):
        kernel_cache.depends_on(Own, (chosen,))
        found += [misses(), misses()]
    assert found == [1, 0, 1, 0, 1, 0] or found == [1, 0, 0, 0, 1, 0]
    monkeypatch.setattr(Own, "__module__", "__main__")
    assert misses() == misses() == 1  # no later process finds a type of the script that is run


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [slow(False), True], ids=["folder and home", "NUMBA_CACHE_DIR"])
def test_cache_without_a_writable_folder_warns_once(tmp_path, chosen):
    package(tmp_path, 0.5)
    file = tmp_path / "file"
    file.write_text("in the way")
    (tmp_path / "tmp").mkdir()
    places = {"HOME": str(file), "TMPDIR": str(tmp_path / "tmp")}
    places["NUMBA_CACHE_DIR"] = str(file) if chosen else ""
    script = (
        f"{BARE}import pathlib; from rendezvous_env import kernel_cache as k; k._PACKAGE = "
        f"pathlib.Path({str(file)!r}); from demo import outer, inner; print(outer.f(10.0))"
    )
    for _ in range(2):
        found = python(script, tmp_path, **places)
        assert found.stdout.split() == ["6.0"]
        assert found.stderr.count("RuntimeWarning") == 1 and str(tmp_path / "tmp") in found.stderr
    assert list((tmp_path / "tmp").rglob("*.code"))
    script = "import tempfile; tempfile.tempdir = '/dev/null'; " + script  # no place at all
    found = python(script, tmp_path, **places)
    assert found.stdout.split() == ["6.0"] and "compiled in every process" in found.stderr


def test_cache_does_not_use_a_temporary_folder_that_others_can_write_to(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    temporary = kernel_cache._temporary
    own = temporary().parent
    assert own.parent == tmp_path and own == temporary().parent
    own.chmod(0o777)
    other = temporary().parent
    assert other != own and other.parent == tmp_path and not other.stat().st_mode & 0o77


def test_cache_recompiles_damaged_code(own_folder):
    """Machine code with a flipped bit would end the process, so it is not loaded."""

    def misses():
        @compilation.kernel
        def half(x):
            return 0.5 * x

        assert half(10.0) == 5.0
        return sum(half.stats.cache_misses.values())

    assert misses() == 1
    for damage in ("empty", "truncated", "one bit", "its digest"):
        (file,) = own_folder.iterdir()
        content = bytearray(file.read_bytes())
        content[0 if damage == "its digest" else len(content) // 2] ^= 4
        kinds = {"empty": b"", "truncated": content[: len(content) // 2]}
        file.write_bytes(kinds.get(damage, bytes(content)))
        assert misses() == 1
    assert misses() == 0  # and kept


@pytest.mark.slow
def test_cache_compiles_once_in_processes_that_start_together(tmp_path):
    """The other processes wait for the code of the first."""
    package(tmp_path, 0.5)
    slow = (
        "def half(x):\n    for k in range(3):\n        x = x + k\n    return {factor} * (x - 3.0)\n"
    )
    (tmp_path / "demo" / "inner.py").write_text(KERNEL + "@kernel\n" + slow.format(factor=0.5))
    script = (
        f"{BARE}import sys; from demo.outer import f; from demo.inner import half; print('ready', "
        "flush=True); sys.stdin.readline(); print(f(10.0), sum(f.stats.cache_misses.values()), "
        "sum(half.stats.cache_misses.values()))"
    )
    ours = {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "NUMBA_CACHE_DIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", script]
    started = [subprocess.Popen(command, env=os.environ | ours, **pipes) for _ in range(3)]
    for process in started:
        assert process.stdout.readline() == "ready\n"
    for process in started:
        process.stdin.write("go\n")
        process.stdin.flush()
    found = [process.communicate(timeout=120)[0].split() for process in started]
    assert {value for value, *_ in found} == {"6.0"}
    assert sum(int(misses) for _, misses, _ in found) == 1
    assert sum(int(misses) for *_, misses in found) == 1
    assert not list((tmp_path / "kernels").glob("*.lock"))


EDITS = {
    "physics": (
        "physics/potential.py",
        "return gain / distance if",
        "return 1.01 * gain / distance if",
        "{}",
    ),
    "robot model": (
        "robots/unicycle.py",
        "return distance * mean_cos, distance * mean_sin",
        "return 0.9 * distance * mean_cos, distance * mean_sin",
        "{'robot_model': 'unicycle'}",
    ),
    "reward term": (
        "rewards/terms.py",
        "reward = weights[0] * progress - weights[1]",
        "reward = 2.0 * weights[0] * progress - weights[1]",
        "{}",
    ),
    "sensor": (
        "sensors/chance.py",
        "return -z if word & _ONE_BIT else z",
        "return z if word & _ONE_BIT else -z",
        "{'sensing': rv.Sensing(noise=0.1)}",
    ),
    "graph": (
        "graphs/random_graphs.py",
        "weights[e] *= low + (high - low) * share",
        "weights[e] *= high - (high - low) * share",
        "{'graph': {'kind': 'random_tree', 'weight_range': [0.5, 2.0]}}",
    ),
    "shape": (
        "obstacles/disc.py",
        "return c * x - s * y, s * x + c * y, c * x + s * y",
        "return c * x + s * y, s * x + c * y, c * x + s * y",
        "{'obstacles': [rv.Disc((2.0, 2.0), 0.5)], 'spawn_size': 4.0}",
    ),
}
"""File, text, edited text, and scenario fields that reveal the edit."""


SCRIPT = """
    import hashlib, sys
    import numpy as np
    from rendezvous_env.kernel_cache import KernelCache
    load, found = KernelCache.load_overload, []
    def noted(cache, *arguments):
        code = load(cache, *arguments)
        found.append(code is not None)
        return code
    KernelCache.load_overload = noted
    import rendezvous_env as rv
    for fields in sys.argv[1:]:
        simulator = rv.Simulator(rv.Scenario(n_robots=4, **eval(fields)), 2)
        seen = [simulator.reset(seed=0)]
        for _ in range(3):
            step = simulator.step(np.full((2, 4, simulator.scenario.action_size), 0.3, np.float32))
            seen += [step.observations, step.rewards, simulator.positions]
        text = b"".join(np.ascontiguousarray(array).tobytes() for array in seen)
        print(hashlib.sha256(text).hexdigest())
    print(len(found), found.count(False))
"""


def stepped(folder: Path, *fields: str) -> tuple[list[str], int, int]:
    """Digests of a few steps in scenarios, and the numbers of kernels in use and of those compiled.

    A new process runs the package in the folder.
    """
    ours = {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", "")}
    found = run_python(folder, "-c", textwrap.dedent(SCRIPT), *fields, **ours)
    *digests, kernels, misses = found.stdout.split()
    return digests, int(kernels), int(misses)


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """Folder of a copy of the package, with kernels on the disk, and the digests of all kinds."""
    folder = tmp_path_factory.mktemp("copied")
    shutil.copytree(ROOT / "rendezvous_env", folder / "rendezvous_env")
    fields = [fields for *_, fields in EDITS.values()]
    before, _, _ = stepped(folder, *fields)
    again, _, misses = stepped(folder, *fields)
    assert again == before and misses == 0
    return folder, dict(zip(EDITS, before, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("kind", first_fast(EDITS))
def test_cache_notices_an_edit_of_each_kind(kind, copied):
    """The numbers change; most kernels in use are loaded from disk."""
    file, text, edited, fields = EDITS[kind]
    folder, before = copied
    source = folder / "rendezvous_env" / file
    kept = source.read_text()
    assert kept.count(text) == 1
    source.write_text(kept.replace(text, edited))
    try:
        (after,), kernels, misses = stepped(folder, fields)
    finally:
        source.write_text(kept)
    assert after != before[kind]
    wide = kind in ("physics", "shape")  # contact, sensing and resets of obstacles use their shapes
    assert misses < (kernels if wide else 0.5 * kernels)  # none if an earlier run left the code
