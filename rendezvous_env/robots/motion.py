"""Motion of a robot with zero-order hold: the interface of robot models to the step.

A robot model is a NamedTuple of constants, and a ``Motion`` of functions of numbers and small
tuples. ``describe`` associates the two by type. The functions are selected by that type while the
step is compiled.

``action`` is the robot's action in its own frame, a tuple of raw numbers to which the model applies
its limits. ``frame`` is its rotation to the global frame, row by row. ``memory`` is the model's
state between steps (angles, a velocity), a tuple that may be empty. A model without memory moves
straight; its ``displacement_at`` and ``chord_error_bound`` are not called.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ..checks import raise_invalid, short_repr
from ..compilation import by_type, kernel
from ..deprecation import renamed_arguments
from ..kernel_cache import depends_on
from ..physics.vectors import scaled

FREE, SLID, STOPPED = range(3)
"""Contact of a robot in a step: none, slid along an obstacle, or stopped at it."""


@kernel(inline="code")
def _evenly(model, action, frame, memory, time):
    way, _ = propose(model, action, frame, memory)
    return scaled(way, time / model.duration)


@kernel(inline="code")
def _straight(model, action, memory):
    return 0.0


@kernel(inline="code")
def _as_before(model, action, frame, memory, displacement, contact):
    return memory


@kernel(inline="code")
def _fixed(model, frame, memory):
    return frame


@kernel(inline="code")
def _nothing(model, frame, memory):
    return ()


@kernel(inline="code")
def _never(model, action, memory):
    return math.inf


@kernel
def _start_with_nothing(model, key, counter):
    return ()


class _Equations(NamedTuple):
    propose: Callable[..., Any]
    """(model, action, frame, memory) → displacement over the step in the global frame, m, a pair
    or triple, and the path length, m, without obstacles."""
    displacement_at: Callable[..., Any] = _evenly
    """(model, action, frame, memory, time) → displacement after a time within the step, m."""
    chord_error_bound: Callable[..., Any] = _straight
    """(model, action, memory) → β, m/s²: within a time h the path is never farther than β h²
    from its chord; 0 for straight paths."""
    update: Callable[..., Any] = _as_before
    """(model, action, frame, memory, displacement, contact) → memory after the step, from the
    executed displacement, m, and FREE, SLID or STOPPED."""
    frame: Callable[..., Any] = _fixed
    """(model, frame, memory) → frame that corresponds to a memory."""
    sense: Callable[..., Any] = _nothing
    """(model, frame, memory) → proprioception in the robot's frame, a pair or triple, or () for
    none."""
    init: Callable[..., Any] = _start_with_nothing
    """(model, key, counter) → memory at the start of an episode, sampled from at most three
    numbers of the stream ``key`` from ``counter`` on."""
    period: Callable[..., Any] = _never
    """(model, action, memory) → period of the path, s, inf if it never closes; the contact
    search is limited to it."""
    drifts: bool = True
    """True if a robot may move under zero action; False allows skipping resting robots."""


_RENAMED = {  # names of equations in version 0.2
    "along": "displacement_at",
    "bend": "chord_error_bound",
    "remember": "update",
    "begin": "init",
    "closes": "period",
}


class Motion(_Equations):
    """Equations of one robot model.

    The defaults are those of a robot that moves straight at constant speed, without memory or
    proprioception, in a fixed frame.
    """

    __slots__ = ()

    @renamed_arguments(**_RENAMED)
    def __new__(cls, *equations: Any, **named: Any) -> Motion:
        """Equations in order or by name; names of version 0.2 are accepted with a warning."""
        return super().__new__(cls, *equations, **named)


_MOTIONS: dict[type, Motion] = {}
_OF_ROBOT: dict[type, Callable[..., Any]] = {}
"""Functions that replace ``constants_of_robot`` for some classes."""
_IS_STEADY: dict[type, Callable[..., Any]] = {}
"""Functions for ``is_steady`` of some classes."""
_FOR_MEMBER: dict[type, Callable[..., Any]] = {}
"""Functions for ``for_member`` of some classes."""


def check_function(field: str, value: Any) -> Any:
    """Reject a value that is not callable, with a TypeError."""
    if not callable(value):
        raise TypeError(f"{field} is {short_repr(value)}; it must be a function")
    return value


def describe(
    model: type,
    motion: Motion,
    *,
    of_robot: Callable[..., Any] | None = None,
    is_steady: Callable[..., Any] | None = None,
    for_member: Callable[..., Any] | None = None,
) -> None:
    """Register the equations of robots whose constants are of this type, a NamedTuple class.

    ``of_robot`` replaces ``constants_of_robot`` for classes whose constants are nested, and
    ``is_steady`` and ``for_member`` the functions of these names for teams of several models.

    Raises:
        ValueError: if this type has other equations already, or is not a NamedTuple.
        TypeError: if one of the equations is not a function.
    """
    if not isinstance(motion, Motion):
        raise TypeError(f"motion is {short_repr(motion)}; it must be a Motion")
    if not (isinstance(model, type) and issubclass(model, tuple) and hasattr(model, "_fields")):
        raise_invalid("model", model, "a NamedTuple class, of its constants")
    if _MOTIONS.get(model, motion) != motion:
        raise ValueError(f"how a {model.__name__} moves has been described before")
    for name, equation in zip(Motion._fields[:-1], motion, strict=False):
        check_function(f"{name} of a {model.__name__}", equation)
    own = [made for made in (of_robot, is_steady, for_member) if made is not None]
    depends_on(model, (*motion, *own) if own else motion)
    _MOTIONS[model] = motion
    if of_robot is not None:
        _OF_ROBOT[model] = of_robot
    if is_steady is not None:
        _IS_STEADY[model] = is_steady
    if for_member is not None:
        _FOR_MEMBER[model] = for_member


def motion_of(model: type) -> Motion | None:
    """Registered equations of robots whose constants are of this type."""
    return _MOTIONS.get(model)


def frame_turns(model: type) -> bool:
    """True if frames of robots whose constants are of this type may rotate: ``Motion.frame``."""
    return _MOTIONS[model].frame is not _fixed


def keeps_memory(model: type) -> bool:
    """True if no step changes the memory and frame of robots whose constants are of this type."""
    return _MOTIONS[model].update is _as_before and not frame_turns(model)


@by_type("model", lambda kind: _IS_STEADY.get(kind, False))
def is_steady(model):
    """True if no step changes memory and frame of this robot; False if that is unknown."""


@kernel(inline="code")
def _alone(model, run, given):
    return run(model, given)


@by_type("model", lambda kind: _FOR_MEMBER.get(kind, _alone))
def for_member(model, run, given):
    """run(model, given), with the constants of one model where a team has several.

    ``run`` is a kernel with a loop over lanes, which has no branch by model then.
    """


@by_type("model", lambda kind: _MOTIONS[kind].drifts)
def drifts(model):
    """True if a robot may move under zero action, ‖Δ‖ > 0 m: ``Motion.drifts``."""


def is_number(kind: type, field: str) -> bool:
    """True if a constant is annotated as a float, so that robots of a team may differ in it."""
    return getattr(kind, "__annotations__", {}).get(field) in (float, "float")


def _constants_of_kind(kind: Any) -> Any:
    """Function that makes constants of this type from a row of a table."""
    if kind in _OF_ROBOT:
        return _OF_ROBOT[kind]
    parts = ", ".join(
        f"table[i, {column}]" if is_number(kind, field) else f"model.{field}"
        for column, field in enumerate(kind._fields)
    )
    text = f"lambda model, table, i: model if table is None else kind({parts})"
    return eval(text, {"kind": kind, "__name__": __name__})


@by_type("model", _constants_of_kind)
def constants_of_robot(model, table, i):
    """Constants of robot i: ``model``, or of a row of a table (n, constants) where robots differ.

    The table has a column for each constant; only numbers are read from it.
    """


# Equations of the model with these constants; see ``Motion``.


def _equation(name: str) -> Any:
    return by_type("model", lambda kind: getattr(_MOTIONS[kind], name))


@_equation("propose")
def propose(model, action, frame, memory):
    """∫₀^τ ṗ dt without obstacles, in the global frame, a pair or triple, and ∫₀^τ ‖ṗ‖ dt, m."""


@_equation("displacement_at")
def displacement_at(model, action, frame, memory, time):
    """∫₀ᵗ ṗ dt: displacement after ``time`` t, s, a pair or triple, m, in the global frame."""


@_equation("chord_error_bound")
def chord_error_bound(model, action, memory):
    """β, m/s², with ‖p(t) − chord‖ ≤ β h² within any time h of the step; 0 for straight paths."""


@_equation("period")
def period(model, action, memory):
    """Period T, s, with p(t + T) = p(t) under a constant action; inf if there is none."""


@_equation("update")
def update_memory(model, action, frame, memory, displacement, contact):
    """Memory of a model after a step, from the executed displacement, m, in the global frame."""


@_equation("frame")
def frame_of(model, frame, memory):
    """R(memory), row by row, 4 or 9 numbers; ``frame`` is the previous one."""


@_equation("sense")
def proprioception(model, frame, memory):
    """Proprioception of a robot in its own frame, a pair or triple, or () for none."""


@_equation("init")
def init_memory(model, key, counter):
    """Memory of a model at the start of an episode, a tuple of numbers, rad or m/s."""
