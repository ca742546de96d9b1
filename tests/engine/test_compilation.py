"""How kernels are compiled: what they may do, and who may call them."""

import gc
import importlib
import pkgutil

import numba
import numpy as np
import pytest
from test_kernel_cache import python

import baselines
import rendezvous_env
import train
from rendezvous_env import compilation, kernel_cache


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
    assert compilation.kernel(allocates=True)(lambda n: np.zeros(n))(3).tolist() == [0.0] * 3


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


def test_what_only_kernels_call_is_plain_python_for_python():
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

    for _ in range(2):  # before any is compiled and after, when there is still no entry
        assert (halved(3.0), doubled(x=3.0), squared(3.0)) == (1.5, 6.0, 9.0)
        assert through_all(3.0) == 16.0
    assert not compilation.compiled() or not squared.overloads


@pytest.mark.parametrize("at_work", [True, False])
def test_the_collector_rests_while_compiling_and_slp_is_for_who_asks_for_it(at_work, monkeypatch):
    """However deep within each other they are compiled; and no longer."""
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(kernel_cache, "_folder", lambda: None)  # else they are found again

    @compilation.inner_kernel
    def loops(x):
        return 2.0 * x

    @compilation.inner_kernel(slp=True)
    def rows(x):
        return loops(x)

    @compilation.kernel
    def around(x):
        return rows(x) + loops(x)

    seen = {}
    for kernel in (loops, rows, around):

        def compiling(*a, real=kernel._compiler.compile, name=kernel.__name__):
            made = real(*a)
            seen[name] = gc.isenabled(), numba.config.SLP_VECTORIZE
            return made

        monkeypatch.setattr(kernel._compiler, "compile", compiling)
    was_at_work = gc.isenabled()
    (gc.enable if at_work else gc.disable)()
    try:
        assert around(3.0) == 12.0  # the inner ones end first
        assert seen == {"loops": (False, 0), "rows": (False, 1), "around": (False, 0)}
        assert gc.isenabled() == at_work and numba.config.SLP_VECTORIZE == 0
        with pytest.raises(numba.core.errors.NumbaError):
            around("three")
        assert gc.isenabled() == at_work
    finally:
        (gc.enable if was_at_work else gc.disable)()
