"""What a sensor makes of exact observations: the seam at which a sensor enters the step.

A sensor is a NamedTuple of constants and arrays, whose type says what it gets wrong; None is the
exact one. Compiled code chooses by that type while it is compiled, so that the step of robots with
exact sensors has nothing of others in it, and need not be compiled anew when those change.
"""

from collections.abc import Callable
from typing import Any

from ...compilation import chosen_by_type, inner_kernel
from ...kernel_cache import depends_on

_ERRORS: dict[type, Callable[..., Any]] = {}


def describe(sensor: type, errors: Callable[..., Any]) -> None:
    """Say what sensors of this type (a NamedTuple class) make of exact observations.

    Args:
        sensor: their type.
        errors: a kernel with the arguments of ``err``.
    """
    depends_on(sensor, (errors,))
    _ERRORS[sensor] = errors


def err(
    sensor: Any, block: Any, setup: Any, moves: Any, state: Any, output: Any, scratch: Any
) -> None:
    """Replace the exact observations of a block by what its robots see.

    It may be done again for the same step: what is drawn follows from the number of the step.

    Args:
        sensor: of a type that has been described, or None.
        block: which teams, see ``engine.memory.Block``.
        setup: of the batch.
        moves: whether a step is being done, which its teams have not counted yet.
        state: of the batch.
        output: whose observations are exact.
        scratch: working memory for a team.
    """
    if sensor is not None:
        _ERRORS[type(sensor)](sensor, block, setup, moves, state, output, scratch)


@inner_kernel(inline="code")
def _nothing(sensor, block, setup, moves, state, output, scratch):
    pass


@chosen_by_type(err)
def _compiled_err(sensor, block, setup, moves, state, output, scratch):
    made = getattr(sensor, "instance_class", None)
    chosen = _nothing if made is None else _ERRORS[made]
    return lambda sensor, block, setup, moves, state, output, scratch: chosen(
        sensor, block, setup, moves, state, output, scratch
    )
