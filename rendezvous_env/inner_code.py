"""Compiled code of kernels that only other kernels call.

numba makes machine code of each function and an entry for Python. A kernel called by kernels alone
needs neither: its optimised bitcode is linked into its callers, which become machine code.
"""

from typing import Any

import llvmlite.binding as llvm
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import config, ir, lowering, typed_passes, untyped_passes
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult, _LowerResult, compile_result
from numba.core.compiler_machinery import PassManager, register_pass

_CONFIG: Any = config
_LOWERING: Any = typed_passes.NativeLowering
_LOWER: Any = lowering.Lower
_LIBRARY: Any = JITCodeLibrary


class KernelLibrary(_LIBRARY):
    """Machine code of a kernel."""

    unrolls = True
    """False while a kernel without unrolled loops is compiled."""

    def _optimize_final_module(self) -> None:
        """Optimise, without unrolling of loops if so set; numba always unrolls."""
        if self.unrolls:
            super()._optimize_final_module()
            return
        options = llvm.create_pipeline_tuning_options(_CONFIG.OPT)
        options.loop_vectorization = _CONFIG.LOOP_VECTORIZE
        options.slp_vectorization = _CONFIG.SLP_VECTORIZE
        options.loop_unrolling = False
        builder = llvm.create_pass_builder(self._codegen._tm, options)
        builder.getModulePassManager().run(self._final_module, builder)


class InnerLibrary(KernelLibrary):
    """Bitcode to link into other libraries; it never becomes machine code."""

    unrolls = False

    is_inlined = False
    """True for code that its callers inline: they optimise it, with their constants in it."""

    def finalize(self) -> None:
        """Link the libraries of all callees; optimise unless callers inline the code."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        if not self.is_inlined:
            self._optimize_final_module()
        self._finalized = True

    def serialize_using_object_code(self) -> Any:
        """Bitcode, since there is no object code."""
        return self.serialize_using_bitcode()


class ValueLower(_LOWER):
    """Lowering of variables to values instead of memory, where each use has one assignment.

    numba does so within a basic block. It keeps all other variables on the stack, and reads a whole
    tuple of arrays from there for one of its numbers.
    """

    def _find_singly_assigned_variable(self) -> None:
        super()._find_singly_assigned_variable()
        if not (self.context.enable_nrt or self.func_ir.is_generator):
            self._singly_assigned_vars |= assigned_once(self.func_ir.blocks)

    def storevar(self, value: Any, name: str, argidx: int | None = None) -> None:
        """Assign a variable; without counted references, its old value needs no release."""
        if self.context.enable_nrt or name in self._singly_assigned_vars:
            super().storevar(value, name, argidx)
        else:
            self.builder.store(value, self.getvar(name))


def assigned_once(blocks: Any) -> set[str]:
    """Variables of numba blocks with one assignment, which precedes every use.

    Blocks are lowered by number, so the assignment must also have the lower one.
    """
    assigned: dict[str, int] = {}
    several: set[str] = set()
    for block, content in blocks.items():
        for statement in content.find_insts(ir.Assign):
            name = statement.target.name
            several |= {name} & assigned.keys()
            assigned[name] = block
    dominators = compute_cfg_from_blocks(blocks).dominators()
    for block, used in compute_use_defs(blocks).usemap.items():
        before = {other for other in dominators.get(block, ()) if other < block}
        several |= {name for name in used if assigned.get(name) not in before}
    return assigned.keys() - several


@register_pass(mutates_CFG=True, analysis_only=False)
class InnerLowering(_LOWERING):
    """Lowering of a function into an ``InnerLibrary`` if it gets no entry for Python."""

    _name = "inner_lowering"
    lowering_class = ValueLower

    def run_pass(self, state: Any) -> bool:
        """Lower a function; numba's own way if Python may call it."""
        inner = state.flags.no_cpython_wrapper
        library = InnerLibrary if inner else KernelLibrary
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        if not inner:
            return bool(super().run_pass(state))
        state.library.is_inlined = state.flags.forceinline
        state.flags.no_compile = True
        super().run_pass(state)
        made = state["cr"]
        mark = _mark(state.targetctx, made.fndesc, made.env, state.library)
        state["cr"] = _LowerResult(made.fndesc, made.call_helper, cfunc=mark, env=made.env)
        return True


_PASSES: tuple[Any, ...] = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables,
    untyped_passes.DeadBranchPrune,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.InlineOverloads,
    typed_passes.IRLegalization,
    InnerLowering,
    typed_passes.NoPythonBackend,
)
"""Passes of numba that kernels need, in its order.

Left out are those for comprehensions, array expressions, ``with``, ``literal_unroll``, parallel
loops and annotated sources.
"""


def passes_of_kernels(counts_references: bool) -> PassManager:
    """Passes that compile a kernel; without counted references, none that ends lifetimes."""
    manager = PassManager("kernel")
    for one in _PASSES:
        if counts_references or one is not typed_passes.IRLegalization:
            manager.add_pass(one, one.name())
    manager.finalize()
    return manager


def rebuild(context: Any, library: Any, *parts: Any) -> Any:
    """Compiled function from the parts that ``CompileResult._reduce`` gave.

    Args:
        context: numba's target context.
        library: (name, kind, code); kind "bitcode" is an ``InnerLibrary``.
        parts: all others.
    """
    name, kind, code = library
    if kind != "bitcode":
        found = CompileResult._rebuild(context, library, *parts)
        context.insert_user_function(found.entry_point, found.fndesc, [found.library])
        return found
    made = InnerLibrary(context.codegen(), name)
    made._final_module, made._finalized = llvm.parse_bitcode(code), True
    fndesc, environment, signature, _, lifted, annotation, reload_init, referenced = parts
    return compile_result(
        target_context=context,
        typing_context=context.typing_context,
        library=made,
        environment=environment,
        entry_point=_mark(context, fndesc, environment, made),
        fndesc=fndesc,
        type_annotation=annotation,
        signature=signature,
        objectmode=False,
        lifted=lifted,
        reload_init=reload_init,
        referenced_envs=referenced,
    )


def load_environments(compiled: Any) -> None:
    """Give the callees within compiled code their environments, as numba does for each function."""
    for environment in compiled._find_referenced_environments():
        compiled.codegen.set_env(environment.env_name, environment)


def _mark(context: Any, fndesc: Any, environment: Any, library: Any) -> Any:
    """Placeholder of a function in numba's tables, which Python cannot call."""
    name = fndesc.qualname.split(".")[-1]
    mark = _dynfunc.make_function(
        fndesc.lookup_module(), name, "kernel without entry", 0, environment, (library,)
    )
    context.insert_user_function(mark, fndesc, [library])
    return mark
