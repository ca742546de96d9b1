"""How a robot moves while its action is held: the seam at which a robot model enters the step.

A robot model is a NamedTuple of constants, whose type says which equations hold, and a ``Motion``
of functions of numbers and small tuples. ``describe`` joins the two. The functions are chosen by
that type while the step is compiled.

``action`` is the robot's action in its own frame, a tuple of numbers as given, to which the model
applies its limits; ``frame`` its rotation to the global frame, row by row; ``memory`` what the
model keeps from step to step (angles, a velocity), a tuple that may be empty. A model that keeps
nothing moves straight, and is asked neither ``displacement_at`` nor ``chord_error_bound``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

from ..checks import raise_invalid, short_repr
from ..compilation import by_type, kernel
from ..kernel_cache import depends_on
from ..physics.vectors import scaled

FREE, SLID, STOPPED = range(3)
"""A robot touched no obstacle in a step, slid along one, or rests where it touched it."""


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
    """(model, action, frame, memory) → displacement over the step in the global frame, m, a pair or
    triple, and the length of the way, m, without obstacles."""
    displacement_at: Callable[..., Any] = _evenly
    """(model, action, frame, memory, time) → displacement after so much of the step, m."""
    chord_error_bound: Callable[..., Any] = _straight
    """(model, action, memory) → β, m/s²: in a time h the way is never farther than β h² from its
    chord; 0 for straight ways."""
    update: Callable[..., Any] = _as_before
    """(model, action, frame, memory, displacement, contact) → memory after the step, from the
    displacement executed, m, and FREE, SLID or STOPPED."""
    frame: Callable[..., Any] = _fixed
    """(model, frame, memory) → frame that goes with a memory."""
    sense: Callable[..., Any] = _nothing
    """(model, frame, memory) → what the robot observes of itself in its own frame, a pair or
    triple, or () for nothing."""
    init: Callable[..., Any] = _start_with_nothing
    """(model, key, counter) → memory at the start of an episode, drawn from at most three numbers
    of the stream ``key`` from ``counter`` on."""
    closes: Callable[..., Any] = _never
    """(model, action, memory) → period of the way, s, inf if it never closes; contacts are looked
    for no longer than that."""
    drifts: bool = True
    """Whether a robot may move while its action is zero; False saves a look at every robot."""


_RENAMED = {  # names of equations in version 0.2
    "along": "displacement_at",
    "bend": "chord_error_bound",
    "remember": "update",
    "begin": "init",
}


class Motion(_Equations):
    """The equations of one robot model; by default those of a robot that moves straight at an even
    speed, keeps nothing, has a fixed frame and senses nothing of itself.
    """

    __slots__ = ()

    def __new__(cls, *equations: Any, **named: Any) -> Motion:
        """Equations in order or by name; their names in version 0.2 are taken with a warning."""
        for old in _RENAMED.keys() & named.keys():
            warnings.warn(f"{old} is called {_RENAMED[old]} now", DeprecationWarning, stacklevel=2)
            named[_RENAMED[old]] = named.pop(old)
        return super().__new__(cls, *equations, **named)


_MOTIONS: dict[type, Motion] = {}


def check_function(field: str, value: Any) -> Any:
    """Refuse what cannot be called, with a TypeError."""
    if not callable(value):
        raise TypeError(f"{field} is {short_repr(value)}; it must be a function")
    return value


def describe(model: type, motion: Motion) -> None:
    """Say how robots move whose constants are of this type, a NamedTuple class.

    Raises:
        ValueError: if something else has been said of this type before, or it is no NamedTuple.
        TypeError: if one of the equations is no function.
    """
    if not isinstance(motion, Motion):
        raise TypeError(f"motion is {short_repr(motion)}; it must be a Motion")
    if not (isinstance(model, type) and issubclass(model, tuple) and hasattr(model, "_fields")):
        raise_invalid("model", model, "a NamedTuple class, of its constants")
    if _MOTIONS.get(model, motion) != motion:
        raise ValueError(f"how a {model.__name__} moves has been described before")
    for name, equation in zip(Motion._fields[:-1], motion, strict=False):
        check_function(f"{name} of a {model.__name__}", equation)
    depends_on(model, motion)
    _MOTIONS[model] = motion


def motion_of(model: type) -> Motion | None:
    """What ``describe`` has said of robots whose constants are of this type."""
    return _MOTIONS.get(model)


def frame_turns(model: type) -> bool:
    """Whether frames of robots whose constants are of this type may turn: ``Motion.frame``."""
    return _MOTIONS[model].frame is not _fixed


@by_type("model", lambda kind: _MOTIONS[kind].drifts)
def drifts(model):
    """Whether a robot may move while its action is zero, ‖Δ‖ > 0 m: ``Motion.drifts``."""


# Equations of the model that the constants are of, as ``Motion`` says of each.


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
    """β, m/s², with ‖p(t) − chord‖ ≤ β h² within any time h of the step; 0 for straight ways."""


@_equation("closes")
def closes(model, action, memory):
    """T, s, with p(t + T) = p(t) while the action is held; inf if there is none."""


@_equation("update")
def update_memory(model, action, frame, memory, displacement, contact):
    """What a model keeps after a step, from the displacement executed, m, in the global frame."""


@_equation("frame")
def frame_of(model, frame, memory):
    """R(memory), row by row, 4 or 9 numbers; ``frame`` is the one before."""


@_equation("sense")
def proprioception(model, frame, memory):
    """What a robot observes of itself in its own frame, a pair or triple, or () for nothing."""


@_equation("init")
def init_memory(model, key, counter):
    """What a model keeps at the start of an episode, a tuple of numbers, rad or m/s."""
