"""How every kernel of this project is compiled: serial, cached on disk, IEEE arithmetic."""

import gc
import inspect
import os
import sys
import time
from collections.abc import Callable
from functools import cache, partial, wraps
from types import FunctionType
from typing import Any, Literal

import numba
from numba.core.bytecode import FunctionIdentity
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import TypingError
from numba.core.options import DefaultOptions
from numba.core.registry import CPUDispatcher
from numba.extending import overload

from .kernel_cache import KernelCache

_CONFIG: Any = numba.config
_DISPATCHER: Any = CPUDispatcher  # numba's types leave out what is overridden here
# numba tells functions of one name apart by a number, from 1 on in every process: kept code of two
# processes would be taken for one and the same
_IDENTITY: Any = FunctionIdentity
_IDENTITY._unique_ids = iter(lambda: int.from_bytes(os.urandom(7)), None)
_PATIENCE = 2.0  # s; compilation that is over sooner is not worth a word

Inline = Literal["never", "code", "text"]
"""Whether a kernel becomes part of whoever calls it.

"code": its machine code does, while that is optimised. "text": its text takes the place of its call
before anything is compiled, which costs no compiling of its own; for long ones with a single
caller. In it no branch may hang on whether an argument is None, nor on the length of a tuple: its
types are not known yet.
"""


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    inline: Inline = "never",
    allocates: bool = False,
    slp: bool = False,
) -> Any:
    """Compile a function on first use: nogil, IEEE division, no fastmath; cached on disk.

    It counts no references to arrays, which would take longer than a small team's arithmetic. So it
    must neither allocate arrays nor return any; the compiler refuses both.

    Args:
        function: of numbers, arrays and tuples of these; None to give options first.
        inline: whether it becomes part of whoever calls it.
        allocates: whether it may allocate and return arrays after all, and counts references.
        slp: whether numbers that lie side by side become SIMD outside of loops over lanes too
            (LLVM's superword-level parallelism): for rows of a robot; loops over lanes get slower.
    """
    return _made(function, _options(inline, allocates=allocates), slp)


def inner_kernel(
    function: Callable[..., Any] | None = None, *, inline: Inline = "never", slp: bool = False
) -> Any:
    """A kernel for other kernels: no entry for Python is compiled, which takes tuples of arrays
    apart and is longer than many a kernel. Called from Python it is the function that it was.
    """
    return _made(function, _options(inline, within=True), slp)


def _made(function: Callable[..., Any] | None, options: dict[str, Any], slp: bool) -> Any:
    if function is None:
        return partial(_made, options=options, slp=slp)
    if not compiled():
        return function
    made = _Kernel(function, targetoptions=options)
    made.slp = slp
    return made


def _options(inline: Inline, *, allocates: bool = False, within: bool = False) -> dict[str, Any]:
    """Options of numba; what is not said here would be as whoever calls first has it.

    Three are not documented: ``_nrt`` (count references), and two that leave out entries for
    callers in C and in Python, a third of all compiling. With a numba that knows them no longer
    everything works, slower (decision 11).
    """
    undocumented = {"_nrt": allocates, "no_cfunc_wrapper": True, "no_cpython_wrapper": within}
    return {
        **({"inline": "always"} if inline == "text" else {}),
        **{"nopython": True, "nogil": True, "boundscheck": None, "error_model": "numpy"},
        "forceinline": inline == "code",
        **{name: value for name, value in undocumented.items() if hasattr(DefaultOptions, name)},
    }


OVERLOADED: Any = _options("code", within=True)
"""Options of numba's ``overload``, for what becomes part of a kernel."""
del OVERLOADED["nopython"]


class _Kernel(_DISPATCHER):
    """numba's dispatcher, with the rules of this project."""

    slp = False
    """Whether it is compiled with ``kernel(slp=True)``."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals, targetoptions)
        self._cache = KernelCache(self)
        self._within = targetoptions.get("no_cpython_wrapper", False)

    def compile(self, sig: Any) -> Any:
        """The entry point for a signature, from disk or compiled anew.

        Python's collector of cycles rests meanwhile: it would look, again and again, through a
        million objects that are all still in use, for an eighth of the time.
        """
        with global_compiler_lock:
            collects = gc.isenabled()
            gc.disable()
            _began.append(time.monotonic())
            slp, _CONFIG.SLP_VECTORIZE = _CONFIG.SLP_VECTORIZE, self.slp
            try:
                entry = super().compile(sig)
                if self._cache_misses and time.monotonic() - _began[0] > _PATIENCE:
                    _say_once()
                return entry
            finally:
                _CONFIG.SLP_VECTORIZE = slp
                _began.pop()
                if collects:  # not within another function's compiling
                    gc.enable()

    def add_overload(self, cres: Any) -> None:
        """Take compiled code in, with an entry for Python only if it has one; unless it returns an
        array whose reference nobody counted, which would be freed while in use.
        """
        returned = cres.signature.return_type
        if not self.targetoptions.get("_nrt", True) and _holds_array(returned):
            raise TypingError(
                f"kernel {self.py_func.__qualname__} returns {returned}; it may return no array"
            )
        if self._within:
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if self._within:  # what there is no entry for would end the process
            return self.py_func
        return super()._compile_for_args(*args, **kws)


_began: list[float] = []
"""When each function that is being compiled was begun, s, the outermost first."""


@cache
def _say_once() -> None:
    print(
        "rendezvous_env: compiling for this kind of team, which is done once and kept on disk; "
        "`rendezvous warmup` does it beforehand",
        file=sys.stderr,
    )


def _holds_array(kind: Any) -> bool:
    parts = getattr(kind, "types", ())
    return isinstance(kind, numba.types.Array) or any(map(_holds_array, parts))


def by_type(argument: str, choose: Callable[[type], Any]) -> Any:
    """Make a function the one that is chosen by the type of one of its arguments.

    What this decorates gives name, arguments and docstring. Compiled code chooses while it is being
    compiled: what is not chosen is not compiled.

    Args:
        argument: name of the one that decides.
        choose: its class, NoneType for None → a function of the same arguments, a kernel or plain;
            or a value, which is a constant of the compiled code.
    """

    def decorate(described: Callable[..., Any]) -> Callable[..., Any]:
        names = list(inspect.signature(described).parameters)
        place, listed = names.index(argument), ", ".join(names)
        # numba compares the names of arguments, so each kernel has to be called by its own
        calling = eval(f"lambda chosen: lambda {listed}: chosen({listed})")
        giving = eval(f"lambda chosen: lambda {listed}: chosen")

        @wraps(described)
        def called(*arguments: Any) -> Any:
            chosen = choose(type(arguments[place]))
            return chosen(*arguments) if callable(chosen) else chosen

        def typed(*types: Any) -> Any:
            chosen = choose(getattr(types[place], "instance_class", type(None)))
            if isinstance(chosen, FunctionType):
                return chosen
            return calling(chosen) if callable(chosen) else giving(chosen)

        overload(called, jit_options=OVERLOADED, strict=False)(typed)
        return called

    return decorate


def entry_point(function: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """What a kernel runs for arguments of these types, without numba's look at all types in each
    call, which takes as long as a small team's step. Later arguments must have the same types, but
    for arrays that may not be written to.
    """
    if not compiled():
        return function
    types = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(types)
    return function.overloads[types].entry_point


def is_kernel(function: Any) -> bool:
    """Whether this is a kernel, and compiled."""
    return isinstance(function, _Kernel)


def compiled() -> bool:
    """Whether kernels are compiled; ``NUMBA_DISABLE_JIT=1`` leaves them plain Python."""
    return not _CONFIG.DISABLE_JIT
