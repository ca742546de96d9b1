"""What a robot model is to an experiment: actions, limits, what it keeps and senses.

Its equations are named by the type of its constants, see ``motion``. Contacts and merging rest on
what they promise, so a user's model is asked a few questions before robots move by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import is_whole, real, shown
from .motion import FREE, STOPPED, Motion, motion_of

MOST_KEPT = 4
"""Numbers that a robot model may keep from step to step."""
_SENSES = (None, "gravity", "velocity")
_SAMPLES = 12
_ROUNDING = 1e-9


@dataclass(frozen=True)
class RobotModel:
    """One robot model."""

    name: str
    dims: tuple[int, ...]
    """Dimensions of space it exists in."""
    constants: Callable[[Any], Any]
    """Scenario → the NamedTuple of constants that its equations take; it must have the fields
    ``duration``, s, and ``speed_limit``, m/s, which no motion exceeds."""
    bounds: Callable[[Any], list[float]]
    """Scenario → symmetric bound on each number of an action."""
    n_angles: int = 0
    """Angles that make up its attitude, the first numbers that it keeps; without any its frame is
    fixed."""
    n_kept: Callable[[int], int] | None = None
    """Dimension → numbers kept from step to step; None is ``n_angles``."""
    keeps_velocity: bool = False
    """Whether the numbers that it keeps after its angles are its velocity in the global frame, m/s,
    never longer than the speed limit."""
    senses: str | None = None
    """What the last row of an observation is: "gravity", "velocity", or nothing."""
    action: str = "velocity, m/s"
    """What an action is, in words."""
    theorem: str | None = None
    """Which theorem covers its own law in continuous time, e.g. "theorem 3"; None where none
    does."""
    bounded: bool = False
    """Whether theorems 1, 2, A and C with the time bounds of theory 3 hold for it: its action is
    its velocity."""

    def memory_size(self, dim: int) -> int:
        """Numbers that a robot keeps from step to step."""
        return self.n_angles if self.n_kept is None else self.n_kept(dim)

    @property
    def nonholonomic(self) -> bool:
        """Whether the robot can only move along its body axis."""
        return self.n_angles > 0

    @property
    def senses_gravity(self) -> bool:
        """Whether the observation has a gravity row: law (17) needs the pitch."""
        return self.senses == "gravity"

    @property
    def senses_velocity(self) -> bool:
        """Whether the observation has a row for the robot's own velocity."""
        return self.senses == "velocity"


ROBOT_MODELS: dict[str, RobotModel] = {}
_EXAMPLES: list[Callable[[str, int], Any]] = []


def try_with(example: Callable[[str, int], Any]) -> None:
    """Say how a scenario of a model's name and dimension is made, to try models with."""
    _EXAMPLES.append(example)


def register_robot_model(model: RobotModel, *, replace: bool = False) -> None:
    """Make a robot model known by its name; ``replace`` lets it take the place of another.

    Its equations must have been described by ``motion.describe``; a few sampled calls try them.

    Raises:
        ValueError: if it is no RobotModel, its name is taken or no word, it exists in no space,
            keeps too many numbers or senses what no robot can; or if its equations give what is not
            finite, go faster than its speed limit, or contradict one another.
        TypeError: if what must be a function is none.
    """
    if not isinstance(model, RobotModel):
        raise ValueError(f"model is {shown(model)}; it must be a RobotModel")
    _check_fields(model)
    known = ROBOT_MODELS.get(model.name)
    if known is not None and replace is not True:
        raise ValueError(
            f"robot model {model.name!r} is already registered; replace=True puts this one in its "
            "place"
        )
    ROBOT_MODELS[model.name] = model
    try:
        for make in _EXAMPLES:
            for dim in model.dims:
                constants_of(make(model.name, dim), early=True)
    except BaseException:
        del ROBOT_MODELS[model.name]
        if known is not None:
            ROBOT_MODELS[model.name] = known
        raise


_FIELDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "dims": (
        lambda dims: (
            isinstance(dims, tuple)
            and len(dims) > 0
            and all(is_whole(dim) and dim in (2, 3) for dim in dims)
        ),
        "has dims {}; they must be of 2 and 3",
    ),
    "constants": (callable, "has constants {}; it must be a function of the scenario"),
    "bounds": (callable, "has bounds {}; it must be a function of the scenario"),
    "n_angles": (
        lambda count: is_whole(count) and 0 <= count <= MOST_KEPT,
        f"has n_angles {{}}; it must be a whole number from 0 to {MOST_KEPT}",
    ),
    "n_kept": (
        lambda kept: kept is None or callable(kept),
        "has n_kept {}; it must be a function of the dimension, or None",
    ),
    "keeps_velocity": (
        lambda flag: isinstance(flag, bool),
        "has keeps_velocity {}; it must be True or False",
    ),
    "bounded": (lambda flag: isinstance(flag, bool), "has bounded {}; it must be True or False"),
    "senses": (
        lambda seen: seen is None or (isinstance(seen, str) and seen in _SENSES),
        f"senses {{}}; it must be one of {_SENSES}",
    ),
    "action": (lambda text: isinstance(text, str), "has action {}; it must be a text"),
    "theorem": (
        lambda text: text is None or isinstance(text, str),
        "has theorem {}; it must be a text, or None",
    ),
}
"""What makes a field of a RobotModel right, and what is said if it is not."""


def _check_fields(model: RobotModel) -> None:
    name = model.name
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(
            f"name of a robot model is {shown(name)}; it must be a word of letters, digits and _"
        )
    who = f"robot model {name!r}"
    for field, (is_right, message) in _FIELDS.items():
        if not is_right(value := getattr(model, field)):
            wrong = TypeError if "function" in message else ValueError
            raise wrong(f"{who} {message.format(shown(value))}")
    for dim in model.dims:
        size = model.memory_size(dim)
        if not is_whole(size) or not model.n_angles <= size <= MOST_KEPT:
            raise ValueError(
                f"{who} keeps {shown(size)} numbers; it must be from {model.n_angles}, its angles, "
                f"to {MOST_KEPT}"
            )
        if model.keeps_velocity and size != model.n_angles + dim:
            raise ValueError(
                f"{who} keeps {size} numbers; with its velocity in {dim}-D it must be "
                f"{model.n_angles + dim}"
            )


# ---- a few questions ----------------------------------------------------------------------------


def is_custom(model: RobotModel) -> bool:
    """Whether a robot model comes from outside the package."""
    return not getattr(model.constants, "__module__", "").startswith(__package__)


def constants_of(scenario: Any, early: bool = False) -> Any:
    """The constants that the equations of a scenario's robot model take; ``early`` at registration,
    when a model need not be described yet, nor fit a scenario's step.

    Raises:
        ValueError: if they are not what a step needs, or a few sampled calls of the equations give
            what no step can bear.
    """
    model, tau = scenario.model, scenario.tau
    who = f"robot model {model.name!r}"
    constants = _called(f"constants of {who}", model.constants, scenario)
    bounds = _called(f"bounds of {who}", model.bounds, scenario)
    kind = type(constants)
    motion = motion_of(kind)
    if motion is None:
        if early and hasattr(kind, "_fields"):
            return constants
        raise ValueError(
            f"the constants of {who} are a {kind.__name__}; describe_motion must have said how "
            "that moves"
        )
    for field, least in (("duration", tau), ("speed_limit", 0.0)):
        value = getattr(constants, field, None)
        if not isinstance(value, float) or not least <= value < math.inf:
            if early and field == "duration":
                return constants
            wanted = f"the step, {least:g} s" if field == "duration" else "a float of 0 m/s or more"
            raise ValueError(
                f"the constants of {who} have {field} = {shown(value)}; it must be {wanted}"
            )
    sequence = isinstance(bounds, list | tuple) or (
        isinstance(bounds, np.ndarray) and bounds.ndim == 1
    )
    if not sequence or not len(bounds):
        raise ValueError(f"bounds of {who} are {shown(bounds)}; they must be a list of numbers")
    for k, bound in enumerate(bounds):
        if not 0.0 <= real(bound) < math.inf:  # 0: robots without links that have no speed given
            raise ValueError(
                f"bounds[{k}] of {who} is {shown(bound)}; it must be finite, and 0 or more"
            )
    if not kind.__module__.startswith(f"{__package__}."):  # the package's own are tested
        _try(model, motion, constants, tuple(map(real, bounds)), scenario.dim)
    return constants


def _called(what: str, function: Any, *arguments: Any) -> Any:
    try:
        return getattr(function, "py_func", function)(*arguments)
    except ZeroDivisionError:
        raise
    except Exception as error:
        if str(error) == "math domain error":
            return math.nan
        raise ValueError(f"{what} fails: {type(error).__name__}: {error}") from error


def _try(
    model: RobotModel, motion: Motion, constants: Any, bounds: tuple[float, ...], dim: int
) -> None:
    """A few calls of all equations, as plain Python; the first that is wrong is refused."""
    random, used = np.random.default_rng(0), np.zeros(len(bounds), bool)
    for sample in range(_SAMPLES):
        action = tuple((random.uniform(-1.0, 1.0, len(bounds)) * bounds).tolist())
        if sample < 2:  # at its limits, where models go fastest
            action = bounds if sample else tuple(-bound for bound in bounds)
        try:
            # what overflows is refused as not finite; random streams are meant to
            with np.errstate(over="ignore", invalid="ignore"):
                used |= _tried(model, motion, constants, action, dim, sample)
        except ZeroDivisionError:  # which compiled code takes as infinite
            continue
    if not used.all():
        k = int(np.argmin(used))
        raise ValueError(
            f"bounds of robot model {model.name!r} are {len(bounds)} numbers, but its equations do "
            f"not look at action[{k}]; they must be as many as an action has"
        )


def _tried(
    model: RobotModel, motion: Motion, constants: Any, action: Any, dim: int, seed: int
) -> np.ndarray[Any, Any]:
    """One sample of all equations; which numbers of the action they look at."""
    who, tau, limit = f"robot model {model.name!r}", constants.duration, constants.speed_limit
    size = model.memory_size(dim)

    def asked(name: str, *arguments: Any) -> Any:
        return _called(f"{name} of {who}", getattr(motion, name), constants, *arguments)

    def numbers(name: str, found: Any, count: int) -> np.ndarray[Any, Any]:
        if not isinstance(found, tuple) or len(found) != count or not _finite(found):
            _refuse(name, found, f"a tuple of {count} finite numbers")
        return np.array(found, dtype=np.float64)

    def _refuse(name: str, found: Any, wanted: str) -> None:
        raise ValueError(
            f"{name} of {who} gives {shown(found)} for the action {shown(action)}; it must be "
            f"{wanted}"
        )

    memory = asked("init", np.uint64(seed), 0)
    numbers("init", memory, size)
    turn = 0.5 * seed
    c, s = math.cos(turn), math.sin(turn)
    frame: Any = (c, -s, s, c) if dim == 2 else (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
    frame = asked("frame", frame, memory)
    rotation = numbers("frame", frame, dim * dim).reshape(dim, dim)
    if not np.allclose(rotation @ rotation.T, np.eye(dim), atol=1e-6):
        _refuse("frame", frame, "a rotation, row by row")
    proposed = asked("propose", action, frame, memory)
    if not isinstance(proposed, tuple) or len(proposed) != 2:
        _refuse("propose", proposed, "a displacement and the length of the way")
    displacement, way = numbers("propose", proposed[0], dim), real(proposed[1])
    far = float(np.linalg.norm(displacement))
    slack = _ROUNDING * (1.0 + limit * tau)
    if not far - slack <= way < math.inf:
        _refuse("propose", proposed, f"a way of {far:g} m, its displacement, or longer")
    if far > limit * tau + slack:
        _refuse("propose", proposed, f"a displacement of speed_limit times {tau:g} s at most")
    for contact, moved in ((FREE, proposed[0]), (STOPPED, (0.0,) * dim)):
        after = asked("update", action, frame, memory, moved, contact)
        numbers("update", after, size)
    if size:
        _check_curve(asked, numbers, _refuse, (action, frame, memory), displacement, tau)
    seen = asked("sense", frame, memory)
    numbers("sense", seen, dim if model.senses else 0)
    looks = np.zeros(len(action), bool)
    remembered = asked("update", action, frame, memory, proposed[0], FREE)
    for k in range(len(action)):
        other = (*action[:k], 0.5 * action[k], *action[k + 1 :])
        changed = asked("propose", other, frame, memory)
        kept = asked("update", other, frame, memory, proposed[0], FREE)
        looks[k] = changed != proposed or kept != remembered
    return looks


def _check_curve(
    asked: Any, numbers: Any, refuse: Any, given: Any, displacement: Any, tau: float
) -> None:
    """``displacement_at`` ends where ``propose`` does, its chord within β τ² of it."""
    action, _, memory = given
    dim = len(displacement)
    bent = real(asked("chord_error_bound", action, memory))
    if not 0.0 <= bent < math.inf:
        refuse("chord_error_bound", bent, "a finite number, 0 or more")
    closes = asked("closes", action, memory)
    if not real(closes) > 0.0:
        refuse("closes", closes, "a positive number, inf for never")
    slack = 1e-6 * (1.0 + float(np.linalg.norm(displacement)))
    for share in (0.0, 0.3, 0.5, 1.0):
        found = asked("displacement_at", *given, share * tau)
        aside = np.linalg.norm(numbers("displacement_at", found, dim) - share * displacement)
        if share in (0.0, 1.0) and aside > slack:
            refuse(
                "displacement_at",
                found,
                f"{share:g} of what propose gives after {share:g} of the step",
            )
        if aside > bent * tau * tau * (1.0 + 1e-6) + slack:
            refuse(
                "chord_error_bound",
                bent,
                f"as large as the way is bent, {aside / tau**2:g} m/s² or more",
            )


def _finite(found: tuple[Any, ...]) -> bool:
    return all(math.isfinite(real(number)) for number in found)
