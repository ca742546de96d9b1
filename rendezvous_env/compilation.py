"""Compilation of all kernels: serial, cached on disk, IEEE arithmetic."""

import gc
import inspect
import operator
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial, wraps
from types import BuiltinFunctionType, FunctionType
from typing import Any, Literal

import numba
from numba.core import event, sigutils, types
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import OmittedArg
from numba.core.errors import TypingError
from numba.core.options import DefaultOptions
from numba.core.registry import CPUDispatcher
from numba.core.typing.context import Context
from numba.extending import overload

from .inner_code import KernelLibrary, load_environments, passes_of_kernels
from .kernel_cache import KernelCache, digest_of

_CONFIG: Any = numba.config
_DISPATCHER: Any = CPUDispatcher  # numba's types omit overridden methods
_COMPILER: Any = Compiler
_CONTEXT: Any = Context
_FUNCTION: Any = types.Function
_PATIENCE = 2.0  # s; longer total compilation is announced

Inline = Literal["never", "code", "text"]
"""Inlining of a kernel into its callers.

"code": the optimiser inlines its machine code. "text": its source replaces the call before
compilation, without a compilation of its own; for long kernels with a single caller. In a "text"
kernel no branch may depend on whether an argument is None, or on the length of a tuple: types
are not known yet."""


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    inline: Inline = "never",
    allocates: bool = False,
    slp: bool = False,
    unroll: bool = True,
) -> Any:
    """Compile a function on first use: nogil, IEEE division, no fastmath; cached on disk.

    It does not count references to arrays, which would take longer than the arithmetic of a few
    robots. It can therefore neither allocate nor return arrays; the compiler rejects both.

    Args:
        function: a function of numbers, arrays and tuples of these; None to give options first.
        inline: inlining into callers.
        allocates: whether it may allocate and return arrays, and counts references.
        slp: whether adjacent numbers outside of loops over lanes also become SIMD (superword-level
            parallelism). For rows of one robot; loops over lanes get slower.
        unroll: whether loops with few iterations become straight code. Without, a long kernel
            compiles up to a third faster, and is as fast if it has little work in such loops.
    """
    return _decorated(function, _options(inline, allocates=allocates), slp, unroll)


def inner_kernel(
    function: Callable[..., Any] | None = None, *, inline: Inline = "never", slp: bool = False
) -> Any:
    """Compile a kernel for use by other kernels only.

    It has no Python entry, whose argument conversion may take longer than the kernel. Python calls
    the decorated function instead.
    """
    return _decorated(function, _options(inline, inner=True), slp)


def _decorated(
    function: Callable[..., Any] | None, options: dict[str, Any], slp: bool, unroll: bool = True
) -> Any:
    if function is None:
        return partial(_decorated, options=options, slp=slp, unroll=unroll)
    if not compiled():
        return function
    made = _Kernel(function, targetoptions=options)
    made.slp, made.unroll = slp, unroll
    return made


def _options(inline: Inline, *, allocates: bool = False, inner: bool = False) -> dict[str, Any]:
    """Options of numba; a missing option would be inherited from the first caller.

    Three are undocumented: ``_nrt`` (count references), and two that omit the entries for callers
    in C and in Python. Without them everything works, slower (decision 11).
    """
    undocumented = {"_nrt": allocates, "no_cfunc_wrapper": True, "no_cpython_wrapper": inner}
    return {
        **({"inline": "always"} if inline == "text" else {}),
        **{"nopython": True, "nogil": True, "boundscheck": None, "error_model": "numpy"},
        "forceinline": inline == "code",
        **{name: value for name, value in undocumented.items() if hasattr(DefaultOptions, name)},
    }


class _Operator(_FUNCTION):
    """Type of an operator, which remembers its signatures."""

    def __init__(self, function: Any) -> None:
        self.__dict__ = function.__dict__ | {"_known": {}}

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Signature for arguments."""
        if (found := self._known.get(args)) is None:
            found = self._known[args] = super().get_call_type(context, args, kws)
        return found


class _TypingContext(_CONTEXT):
    """Numba's typing context, which remembers the signatures of operators and of its functions.

    Otherwise each ``a + b`` would be matched with all implementations of ``+``, several times.
    """

    __slots__ = ("_known", "_operators")  # all else is shared

    def __init__(self, context: Any) -> None:
        self.__dict__ = context.__dict__  # type: ignore[misc]
        self._known: dict[Any, Any] = {}
        self._operators: dict[Any, Any] = {}

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Signature of a call."""
        resolve = super().resolve_function_type
        if kws or not isinstance(func, types.Function | BuiltinFunctionType):
            return resolve(func, args, kws)
        if (found := self._known.get((func, args))) is None:
            found = self._known[func, args] = resolve(func, args, kws)
        return found

    def resolve_value_type(self, val: Any) -> Any:
        """Type of a constant."""
        if not isinstance(val, BuiltinFunctionType) or val.__module__ != operator.add.__module__:
            return super().resolve_value_type(val)
        if (found := self._operators.get(val)) is None:
            found = self._operators[val] = _Operator(super().resolve_value_type(val))
        return found


@cache
def _typing_context(context: Any, counts_references: bool) -> Any:
    """Context for kernels that count references, or for those that do not.

    numba compiles its functions separately for either.
    """
    return _TypingContext(context)


class _KernelCompiler(_COMPILER):
    """Compiler of numba with symbol names derived from the content of a function.

    numba itself numbers functions from 1 in every process. Cached machine code of two processes,
    linked together, could then contain two functions of one name.
    """

    with_entry = True
    """False while a kernel is compiled for another one only: it gets no Python entry."""

    def __init__(self, typing_context: Any, *given: Any) -> None:
        super().__init__(typing_context, *given)
        context = _typing_context(typing_context, self.state.flags.nrt)
        # the target context is a copy for this compilation
        self.state.typingctx = self.state.targetctx.typing_context = context

    def define_pipelines(self) -> Any:
        identity = self.state.func_id
        identity.unique_id = digest_of(identity.func, self.state.args)[:16]
        identity.unique_name = f"{identity.func_qualname}${identity.unique_id}"
        self.state.flags.no_cpython_wrapper |= not _KernelCompiler.with_entry
        return [passes_of_kernels(self.state.flags.nrt)]


OVERLOADED: Any = _options("code", inner=True) | {"pipeline_class": _KernelCompiler}
"""Options of numba's ``overload`` for functions inlined into kernels."""
del OVERLOADED["nopython"]


class _Kernel(_DISPATCHER):
    """Dispatcher of numba with the rules of this project."""

    slp = False
    """True if it is compiled with ``kernel(slp=True)``."""

    unroll = True
    """False if it is compiled with ``kernel(unroll=False)``."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals, targetoptions, _KernelCompiler)
        self._cache = KernelCache(self)
        self._inner = targetoptions.get("no_cpython_wrapper", False)
        self._with_entry: set[Any] = set()
        self._caller_is_kernel = False

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Signature for a call by another kernel, which needs no Python entry.

        Constant arguments make no signatures of their own.
        """
        named = {name: types.unliteral(kind) for name, kind in kws.items()}
        self._caller_is_kernel = True
        try:
            return super().get_call_template(tuple(map(types.unliteral, args)), named)
        finally:  # invalid arguments never reach ``compile``
            self._caller_is_kernel = False

    def compile(self, sig: Any) -> Any:
        """Entry point for a signature, from disk or newly compiled."""
        arguments = tuple(sigutils.normalize_signature(sig)[0])
        with global_compiler_lock:
            entry = not (self._inner or self._caller_is_kernel)
            self._caller_is_kernel = False
            known = self.overloads.get(arguments)
            if known is None or (entry and arguments not in self._with_entry):
                with (
                    self._cache.exclusive(arguments, entry),
                    _announced(self),
                    _compiling(self, entry),
                    self._compiling_counter,
                ):
                    known = self._load(arguments) or self._compile(arguments)
                    self._add(arguments, known, entry)
            return known.entry_point

    def _load(self, arguments: Any) -> Any:
        """Compiled code from disk; None if it has to be compiled."""
        if (found := self._cache.load_overload(arguments, self.targetctx)) is not None:
            self._cache_hits[arguments] += 1
        return found

    def _compile(self, arguments: Any) -> Any:
        """Code compiled now, and stored on disk.

        An error if it returns an array: no reference is counted, so the array would be freed while
        in use.
        """
        self._cache_misses[arguments] += 1
        details = {"dispatcher": self, "args": arguments, "return_type": None}
        with event.trigger_event("numba:compile", data=details):
            made = self._compiler.compile(arguments, None)
        returned = made.signature.return_type
        if not self.targetoptions.get("_nrt", True) and _holds_array(returned):
            raise TypingError(
                f"kernel {self.py_func.__qualname__} returns {returned}; it may return no array"
            )
        self._cache.save_overload(arguments, made)
        return made

    def _add(self, arguments: Any, made: Any, entry: bool) -> None:
        if entry:
            load_environments(made)
            self.add_overload(made)
            self._with_entry.add(arguments)
        else:
            self.overloads[arguments] = made

    def typeof_pyval(self, val: Any) -> Any:
        """Type of an argument; a read-only array has that of a writable one."""
        return _writable(super().typeof_pyval(val))

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if self._inner:  # calling a kernel without entry would crash the process
            given = [arg.value if isinstance(arg, OmittedArg) else arg for arg in args]
            return lambda *_, **__: self.py_func(*given, **kws)
        return super()._compile_for_args(*args, **kws)


def _writable(kind: Any) -> Any:
    """Type with all arrays writable.

    JAX and pandas return read-only arrays. Kernels write only to memory of the package, so the same
    compiled code is used for both.
    """
    if isinstance(kind, types.Array):
        return kind.copy(readonly=False)
    if not (_holds_array(kind) and isinstance(kind, types.BaseTuple)):
        return kind
    parts = tuple(map(_writable, getattr(kind, "types", ())))
    return types.BaseTuple.from_types(parts, getattr(kind, "instance_class", None))


@contextmanager
def _compiling(function: _Kernel, entry: bool) -> Iterator[None]:
    """Set the options of this compilation, and pause Python's cyclic garbage collector.

    The collector would traverse a million objects in use repeatedly.
    """
    collects = gc.isenabled()
    before = _CONFIG.SLP_VECTORIZE, _KernelCompiler.with_entry, KernelLibrary.unrolls
    gc.disable()
    _CONFIG.SLP_VECTORIZE, _KernelCompiler.with_entry = function.slp, entry
    KernelLibrary.unrolls = function.unroll
    try:
        yield
    finally:
        _CONFIG.SLP_VECTORIZE, _KernelCompiler.with_entry, KernelLibrary.unrolls = before
        if collects:  # not within the compilation of another kernel
            gc.enable()


class _Wait:
    """Time spent compiling in this process, s, and the number of compilations within each other."""

    seconds = 0.0
    depth = 0


@contextmanager
def _announced(function: _Kernel) -> Iterator[None]:
    """Log once if the total compilation time is long."""
    begun = time.monotonic()
    _Wait.depth += 1
    try:
        yield
    finally:
        _Wait.depth -= 1
    if function._cache_misses and _Wait.depth == 0:
        _Wait.seconds += time.monotonic() - begun
        if _Wait.seconds > _PATIENCE:
            _say_once()


@cache
def _say_once() -> None:
    print(
        "rendezvous_env: compiling kernels for this scenario, once; they are cached on disk. "
        "`rendezvous warmup` compiles them in advance",
        file=sys.stderr,
    )


def _holds_array(kind: Any) -> bool:
    parts = getattr(kind, "types", ())
    return isinstance(kind, types.Array) or any(map(_holds_array, parts))


def by_type(argument: str, choose: Callable[[type], Any]) -> Any:
    """Decorate a function to dispatch on the type of one of its arguments.

    The decorated function provides name, arguments and docstring. Compiled code dispatches during
    compilation: other branches are not compiled.

    Args:
        argument: name of the argument to dispatch on.
        choose: maps its class, NoneType for None, to a function of the same arguments, a kernel or
            plain; or to a value, which is a constant of the compiled code.
    """

    def decorate(described: Callable[..., Any]) -> Callable[..., Any]:
        names = list(inspect.signature(described).parameters)
        place, listed = names.index(argument), ", ".join(names)
        # numba compares names of arguments, so each kernel needs its own names
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
    """Entry point of a kernel for arguments of these types.

    It avoids numba's type lookup in each call, which takes as long as a step of a small
    environment. Later arguments must have the same types, except that arrays may be read-only.
    """
    if not compiled():
        return function
    types = tuple(numba.typeof(argument) for argument in arguments)
    function.compile(types)
    return function.overloads[types].entry_point


def is_kernel(function: Any) -> bool:
    """True if this is a compiled kernel."""
    return isinstance(function, _Kernel)


def compiled() -> bool:
    """True if kernels are compiled; ``NUMBA_DISABLE_JIT=1`` keeps them as plain Python."""
    return not _CONFIG.DISABLE_JIT
