"""Compilation of kernels: permitted operations and callers."""

import gc
import importlib
import operator
import pkgutil
import textwrap
from typing import NamedTuple

import numba
import numpy as np
import pytest
from test_kernel_cache import python

import baselines
import rendezvous_env
import train
from rendezvous_env import compilation, inner_code, kernel_cache


@pytest.mark.slow
def test_kernel_inlined_checks_bounds(tmp_path):
    """Inlined kernels count no references, but errors must still propagate."""
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
def test_kernel_refuses_to_allocate(decorate, inline):
    @getattr(compilation, decorate)(inline=inline)
    def zeros(n):
        return np.zeros(n).sum()

    @compilation.kernel
    def caller(n):
        return zeros(n)

    with pytest.raises(numba.core.errors.NumbaError, match=r"(?i)nrt|allocat|zeros"):
        caller(3)


def test_kernel_refuses_to_allocate_what_another_kernel_may():
    """Signatures of numba's functions are remembered for either; a leak would go unnoticed."""
    assert compilation.kernel(allocates=True)(lambda n: np.ones(n).sum())(3) == 3.0
    with pytest.raises(numba.core.errors.NumbaError, match=r"(?i)nrt|allocat|ones"):
        compilation.kernel(lambda n: np.ones(n).sum())(3)


def test_compilation_leaves_the_typing_of_numba_alone():
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    context = numba.core.registry.cpu_target.typing_context
    before = {*vars(context)}
    assert compilation.kernel(lambda x: x * 2.0 + x)(3.0) == 9.0
    assert type(context) is numba.core.typing.Context and {*vars(context)} == before
    for function in (operator.add, operator.mul, operator.getitem):
        assert type(context.resolve_value_type(function)) is numba.types.Function


def test_kernel_keeps_loops_unless_unrolled(monkeypatch):
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(kernel_cache, "_folder", lambda: None)  # else code has no text

    def product(x):
        found = 1.0
        for k in range(len(x)):
            found *= x[k]
        return found

    def multiplications(unroll):
        kernel = compilation.kernel(product, unroll=unroll)
        assert kernel(np.arange(1.0, 7.0)) == 720.0
        (made,) = kernel.overloads.values()
        return made.library.get_llvm_str().count("fmul")

    assert multiplications(unroll=False) < multiplications(unroll=True)


def branching(values, limit):
    """Variables of all lifetimes: across branches, around loops, and after them."""
    pair = values, values[1:]
    total, last, found = 0.0, -1.0, False
    for k in range(len(pair[1])):
        step = pair[1][k] - pair[0][k]
        if step > limit:
            last = step
            continue
        if found:
            total += last
        found = step < 0.0
        total += step
    after = total + last
    return after if found else -after


@pytest.mark.kernels
def test_kernel_keeps_variables_across_branches_and_loops():
    compiled = compilation.kernel(branching)
    for values in ([1.0, 4.0, 2.0, 2.5, 9.0], [3.0, 2.0, 1.0], [0.0, 5.0], [7.0]):
        assert compiled(np.array(values), 1.0) == branching(np.array(values), 1.0)


def test_assigned_once_leaves_out_variables_with_several_assignments_or_earlier_uses():
    blocks = numba.core.compiler.run_frontend(branching).blocks
    found = inner_code.assigned_once(blocks)
    assert {"values", "limit", "pair", "after"} <= found
    assert not {"total", "last", "found"} & found


def test_kernel_with_allocates_returns_arrays():
    assert compilation.kernel(allocates=True)(lambda n: np.zeros(n))(3).tolist() == [0.0] * 3


def all_kernels():
    """All kernels of the three packages, by module and name."""
    found = {}
    for package in (rendezvous_env, baselines, train):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if {"adapters", "pixels"} & {*module.name.split(".")}:
                continue  # without kernels, and each needs a library of its own
            for function in vars(importlib.import_module(module.name)).values():
                if hasattr(function, "py_func"):
                    found[f"{function.__module__}.{function.__qualname__}"] = function
    return found


def test_kernel_without_reference_counts_refuses_to_return_arrays():
    """The array would be freed while in use, as its reference is not counted.

    Compilation rejects it, so the check does not depend on cached code.
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


def test_inner_kernel_is_plain_python_for_python():
    @compilation.inner_kernel
    def halved(x, share=0.5):
        return share * x

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
        assert halved(share=2.0, x=3.0) == halved(3.0, 2.0) == 6.0
        assert through_all(3.0) == 16.0
    assert not compilation.compiled() or not squared.overloads


@pytest.mark.parametrize("enabled", [True, False])
def test_kernel_sets_options_and_pauses_the_collector_while_it_is_compiled(enabled, monkeypatch):
    """Nested compilations pause it until the outermost ends, also after a failure."""
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(kernel_cache, "_folder", lambda: None)  # else they are found again

    @compilation.inner_kernel(slp=True)
    def inner(x):
        return 2.0 * x

    @compilation.kernel(unroll=False)
    def outer(x):
        return inner(x) + 1.0

    seen = {}
    for kernel in (inner, outer):

        def compiling(*a, real=kernel._compiler.compile, name=kernel.__name__):
            made = real(*a)
            unrolls = inner_code.KernelLibrary.unrolls
            seen[name] = gc.isenabled(), numba.config.SLP_VECTORIZE, unrolls
            return made

        monkeypatch.setattr(kernel._compiler, "compile", compiling)
    before = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        assert outer(3.0) == 7.0
        assert seen == {"inner": (False, True, True), "outer": (False, False, False)}
        assert gc.isenabled() == enabled and numba.config.SLP_VECTORIZE == 0
        assert inner_code.KernelLibrary.unrolls
        with pytest.raises(numba.core.errors.NumbaError):
            outer("three")
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()


def test_kernel_called_by_a_wrong_kernel_still_has_an_entry():
    @compilation.kernel
    def successor(x):
        return x + 1.0

    @compilation.kernel
    def wrong(x):
        return successor(x, x)

    with pytest.raises(TypeError if not compilation.compiled() else numba.TypingError):
        wrong(1.0)
    assert successor(1.0) == 2.0


def test_kernel_compiled_for_a_kernel_gets_an_entry_when_python_calls_it():
    @compilation.kernel
    def successor(x):
        return x + 1.0

    @compilation.kernel
    def twice(x):
        return successor(successor(x))

    assert twice(1.0) == 3.0 and successor(1.0) == 2.0 and twice(2.0) == 4.0
    assert not compilation.compiled() or len(successor.overloads) == 1


@pytest.mark.slow
def test_compilation_changes_nothing_of_numba_for_others(tmp_path):
    """Function numbers and settings are kept, and a user's kernels are unaffected."""
    script = """
        import numba
        from numba.core.bytecode import FunctionIdentity
        kept = {name: value for name, value in vars(numba.config).items() if name.isupper()}
        import rendezvous_env
        from rendezvous_env.physics.vectors import norm
        norm((3.0, 4.0))
        first, second = (FunctionIdentity.from_function(lambda: None).unique_id for _ in range(2))
        assert second == first + 1 < 10_000
        assert kept == {name: value for name, value in vars(numba.config).items() if name.isupper()}
        assert type(numba.njit(lambda x: x)) is numba.core.registry.CPUDispatcher
        print("unchanged")
    """
    assert python(textwrap.dedent(script), tmp_path).stdout == "unchanged\n"


def test_kernel_is_compiled_once_for_writable_and_read_only_arrays():
    if not compilation.compiled():
        pytest.skip("nothing is compiled")

    class Pair(NamedTuple):
        values: np.ndarray
        factor: float

    @compilation.kernel
    def total(x, pair):
        return x.sum() + pair.values[0] * pair.factor

    writable = np.arange(4.0)
    frozen = writable.copy()
    frozen.flags.writeable = False
    for x in (writable, frozen):
        for values in (writable, frozen):
            assert total(x, Pair(values, 2.0)) == 6.0
    assert total(frozen, Pair(frozen + 1.0, 1.0)) == 7.0
    assert len(total.signatures) == 1


def test_learned_policy_compiles_nothing_for_read_only_observations():
    """Read-only arrays, as from JAX and pandas."""
    if not compilation.compiled():
        pytest.skip("nothing is compiled")
    scenario = rendezvous_env.scenarios.get("clutter-4")
    observations = rendezvous_env.Simulator(scenario, 2).reset(seed=0)
    frozen = observations.copy()
    frozen.flags.writeable = False
    actions = {}
    for name, given in (("writable", observations), ("read-only", frozen)):
        policy = baselines.make("learned", scenario)
        before = sum(len(kernel.overloads) for kernel in all_kernels().values())
        actions[name] = policy(given, np.zeros(2))
        compiled = sum(len(kernel.overloads) for kernel in all_kernels().values()) - before
    np.testing.assert_array_equal(actions["writable"], actions["read-only"])
    assert compiled == 0
