"""How every kernel of this project is compiled: serial, cached on disk, IEEE arithmetic."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numba
from numba.core.errors import TypingError
from numba.core.options import DefaultOptions
from numba.extending import overload

from .kernel_cache import keep

_CONFIG: Any = numba.config


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function on first use: nogil, IEEE division, no fastmath; cached on disk.

    It counts no references to arrays: to hand tuples of arrays over, and to count who holds each
    array and each view of it, takes longer than a small team's arithmetic, and counters that two
    threads raise at the same time take longest. A kernel must therefore neither allocate arrays,
    nor return any, which would be counted too seldom; the compiler refuses both.
    """
    return _compile(function, allocates=False)


def inner_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that only kernels call: no entry for Python is compiled, which takes tuples of
    arrays apart and is longer than many a kernel.
    """
    return _compile(function, allocates=False, within=True)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that becomes part of whoever calls it; only kernels do."""
    return _compile(function, allocates=False, inlined=True, within=True)


def inlined_entry(function: Callable[..., Any]) -> Any:
    """A kernel that becomes part of whoever calls it, and that Python calls, too."""
    return _compile(function, allocates=False, inlined=True)


def unfolded_kernel(function: Callable[..., Any]) -> Any:
    """A kernel whose text takes the place of its call before anything is compiled.

    It costs no compiling of its own, whereas an inlined one is optimised by itself, and again as
    part of each kernel above it. For long ones with a single caller. In it no branch may hang on
    whether an argument is None, nor on the length of a tuple: its types are not known yet.
    """
    return _compile(function, allocates=False, unfolded=True, within=True)


def allocating_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that may allocate and return arrays."""
    return _compile(function, allocates=True)


def _compile(
    function: Callable[..., Any],
    *,
    allocates: bool,
    inlined: bool = False,
    unfolded: bool = False,
    within: bool = False,
) -> Any:
    options = _options(allocates=allocates, inlined=inlined, within=within)
    inline: dict[str, Any] = {"inline": "always"} if unfolded else {}
    dispatcher = numba.njit(nogil=True, **inline, **options)(function)
    if compiled():
        keep(dispatcher)
        _rest_the_collector(dispatcher)
        if within:
            _refuse_python(dispatcher)
        if not allocates:
            _refuse_arrays(dispatcher)
    return dispatcher


def _options(*, allocates: bool, inlined: bool, within: bool) -> dict[str, Any]:
    """Options of numba; what is not said here would be as whoever calls first has it.

    Three are not documented. ``_nrt`` leaves references uncounted; ``no_cfunc_wrapper`` leaves out
    an entry for callers in C, of whom there are none, and ``no_cpython_wrapper`` that for Python
    where only kernels call: the two take a third of all compiling. With a numba that knows them no
    longer everything works, slower.
    """
    undocumented = {
        "_nrt": allocates,
        "no_cfunc_wrapper": True,
        "no_cpython_wrapper": within,
    }
    known = {name: value for name, value in undocumented.items() if hasattr(DefaultOptions, name)}
    return {"error_model": "numpy", "forceinline": inlined, **known}


def _rest_the_collector(dispatcher: Any) -> None:
    """Let Python's collector of cycles rest while the function is compiled: it would look, again
    and again, through a million objects that are all still in use, for an eighth of the time.
    """
    compile_types = dispatcher._compiler.compile

    def compile_at_rest(arguments: Any, return_type: Any) -> Any:
        was_at_work = gc.isenabled()
        gc.disable()
        try:
            return compile_types(arguments, return_type)
        finally:
            if was_at_work:  # not within another function's compiling
                gc.enable()

    dispatcher._compiler.compile = compile_at_rest


def _refuse_python(dispatcher: Any) -> None:
    """Make a call from Python an error: what there is no entry for would end the process."""

    def add_overload(result: Any) -> None:
        dispatcher.overloads[tuple(result.signature.args)] = result

    def compile_for_args(*_: Any, **__: Any) -> Any:
        raise TypeError(
            f"kernel {dispatcher.py_func.__qualname__} can be called by other kernels only"
        )

    dispatcher.add_overload, dispatcher._compile_for_args = add_overload, compile_for_args


def _refuse_arrays(dispatcher: Any) -> None:
    """Make it an error of compilation that the function returns an array: nobody would have
    counted that reference, and the array would be freed while it is in use.
    """
    compile_types = dispatcher._compiler.compile

    def compile_checked(arguments: Any, return_type: Any) -> Any:
        result = compile_types(arguments, return_type)
        returned = result.signature.return_type
        if _holds_array(returned):
            raise TypingError(
                f"kernel {dispatcher.py_func.__qualname__} returns {returned}; it may return no "
                "array"
            )
        return result

    dispatcher._compiler.compile = compile_checked


def _holds_array(kind: Any) -> bool:
    parts = getattr(kind, "types", ())
    return isinstance(kind, numba.types.Array) or any(map(_holds_array, parts))


def chosen_by_type(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """How a plain function is compiled: what this decorates is called with the numba types of its
    arguments, and returns the function that compiled code runs in its place (numba's ``overload``).

    A choice by type is made while compiling: what is not chosen is not compiled.
    """
    options: Any = _options(allocates=False, inlined=True, within=True)
    return overload(function, jit_options=options)


def entry_point(function: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """What a kernel runs for arguments of these types.

    To call it leaves out numba's look at the types of all arguments, which takes as long as a small
    team's step. So later arguments must have the same types, but for arrays that may not be written
    to: compiled code for those would be the same again.
    """
    if not compiled():
        return function
    types = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(types)
    return function.overloads[types].entry_point


def compiled() -> bool:
    """Whether kernels are compiled; ``NUMBA_DISABLE_JIT=1`` leaves them plain Python."""
    return not _CONFIG.DISABLE_JIT
