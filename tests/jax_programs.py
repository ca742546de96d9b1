"""Compilation of JAX programs that tests run for few steps."""

from collections.abc import Callable
from typing import Any


def quickly_compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function under ``jax.jit`` with XLA's older kernels for CPUs.

    They compile in half the time and are slower. Other tests run the default kernels.
    """
    import jax

    compiled: Callable[..., Any] = jax.jit(
        function, compiler_options={"xla_cpu_use_fusion_emitters": False}
    )
    return compiled
