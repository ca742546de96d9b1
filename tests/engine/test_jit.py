"""Where compiled kernels are kept, and when they are compiled anew."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numba
import numpy as np
import pytest
from conftest import ROOT

import rendezvous_env
import rendezvous_env as rv
from rendezvous_env import compilation as jit
from rendezvous_env.engine import concluding, observing, sharing
from rendezvous_env.engine import step as kernels
from rendezvous_env.engine.step import step_blocks
from rendezvous_env.guarantee import steering
from rendezvous_env.vector import HeadingVectorWrapper

OUTER = """
from rendezvous_env.jit import kernel
from .inner import half

@kernel
def f(x):
    return half(x) + 1.0
"""
INNER = """
from rendezvous_env.jit import kernel

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
        stats = getattr(f, "stats", None)
        print(value, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
    """
    found = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        check=True,
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", **environment},
        timeout=200,
    )
    value, hits, misses = found.stdout.split()
    return float(value), int(hits), int(misses)


def test_an_edit_of_an_inlined_kernel_is_noticed(tmp_path):
    package(tmp_path, 0.5)
    assert call(tmp_path) == (6.0, 0, 1)
    assert call(tmp_path) == (6.0, 1, 0)  # from disk
    folders = list((tmp_path / "demo" / "__pycache__").glob("kernels-*"))
    package(tmp_path, 0.25)  # outer.py, which inlines it, stays as it is
    assert call(tmp_path) == (3.5, 0, 1)
    now = list((tmp_path / "demo" / "__pycache__").glob("kernels-*"))
    assert len(folders) == len(now) == 1 and folders != now  # and the old code is gone


def test_numba_cache_dir_is_respected(tmp_path):
    package(tmp_path, 0.5)
    cache = tmp_path / "elsewhere"
    assert call(tmp_path, NUMBA_CACHE_DIR=str(cache))[0] == 6.0
    assert list(cache.rglob("*.nbi"))


def test_a_package_that_cannot_be_written_to_is_cached_at_home(tmp_path, monkeypatch):
    package(tmp_path, 0.5)
    (tmp_path / "demo" / "__pycache__").write_text("in the way of the folder")
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    found = jit._cache_folder.__wrapped__(tmp_path / "demo")
    assert Path(found).parent == tmp_path / "home" / ".cache" / "rendezvous-env" / "demo"
    shutil.rmtree(tmp_path / "home")
    (tmp_path / "home").write_text("in the way, too")
    assert jit._cache_folder.__wrapped__(tmp_path / "demo") is None


def test_kernels_are_serial_release_the_lock_and_divide_like_ieee():
    options = step_blocks.targetoptions
    assert options["nogil"] and options["error_model"] == "numpy"
    assert not options.get("fastmath") and not options.get("parallel")

    @jit.kernel
    def inverse(x):
        return 1.0 / x

    assert inverse(0.0) == float("inf")


def test_an_inlined_kernel_may_not_allocate():
    @jit.inlined_kernel
    def zeros(n):
        return np.zeros(n).sum()

    with pytest.raises(numba.core.errors.NumbaError):
        zeros(3)


def test_no_inlined_kernel_returns_an_array():
    """Nobody would have counted that reference: the array would be freed while it is in use."""
    discs = (rv.Disc(centre=(3.0, 0.0), radius=1.0),)
    for model in ("single_integrator", "unicycle"):
        venv = rv.make_vec("fig3", 2, robot_model=model, obstacles=discs)
        venv = HeadingVectorWrapper(venv)
        venv.reset(seed=0)
        venv.step(np.zeros(venv.action_space.shape, np.float32))
    found = 0
    for module in (concluding, kernels, observing, sharing, steering):
        for function in vars(module).values():
            if getattr(function, "targetoptions", {}).get("forceinline"):
                for compiled in function.overloads.values():
                    found += 1
                    assert not _holds_array(compiled.signature.return_type), function
    assert found > 15


def _holds_array(kind):
    return isinstance(kind, numba.types.Array) or any(
        _holds_array(part) for part in getattr(kind, "types", ())
    )


def test_the_setting_of_numba_is_left_as_it_was():
    before = numba.config.CACHE_DIR
    with pytest.raises(RuntimeError), jit._cache_in("/tmp/somewhere"):
        raise RuntimeError
    assert before == numba.config.CACHE_DIR


def test_this_package_keeps_its_kernels_beside_its_sources():
    here = Path(rendezvous_env.__file__).parent
    if os.access(here, os.W_OK):
        assert Path(jit._cache_folder(here)).parent == here / "__pycache__"
