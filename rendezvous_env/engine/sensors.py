"""What a sensor makes of exact observations: the seam at which a sensor enters the step.

A sensor is a NamedTuple of constants and arrays, whose type says what it gets wrong; None is the
exact one. Compiled code chooses by that type while it is compiled, so that the step of robots with
exact sensors has nothing of others in it, and need not be compiled anew when those change.
"""

from collections.abc import Callable
from typing import Any

from ..compilation import chosen_by_type, inlined_kernel
from ..kernel_cache import depends_on

_ERRORS: dict[type, Callable[..., Any]] = {}


def describe(sensor: type, errors: Callable[..., Any]) -> None:
    """Say what sensors of this type (a NamedTuple class) make of exact observations.

    Args:
        sensor: their type.
        errors: a kernel with the arguments of ``err``.
    """
    depends_on(sensor, (errors,))
    _ERRORS[sensor] = errors


def err(sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand):
    """Replace the exact observations of a block by what its robots see.

    It may be done again for the same step: what is drawn follows from the number of the step.

    Args:
        sensor: of a type that has been described, or None.
        block: index.
        count: its teams.
        layout: of the memory.
        constants: the fields of Constants.
        moves: whether a step is being done, which its teams have not counted yet.
        teams: the fields of Teams.
        links: of a kind of ``link_kinds``.
        obstacles: with a leading axis B, or None.
        results: whose observations are exact.
        hand: working memory.
    """
    if sensor is not None:
        errors = _ERRORS[type(sensor)]
        errors(
            sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand
        )


@inlined_kernel
def _nothing(
    sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand
):
    pass


@chosen_by_type(err)
def _compiled_err(
    sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand
):
    made = getattr(sensor, "instance_class", None)
    chosen = _nothing if made is None else _ERRORS[made]

    def implementation(
        sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand
    ):
        return chosen(
            sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand
        )

    return implementation
