"""Robot models of an experiment: actions, limits, memory and proprioception.

The type of its constants selects the equations, see ``motion``. Contacts and merging rely on their
properties, so the equations of a custom model are validated numerically before use.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    Registry,
    check_int,
    counted,
    floats,
    format_limit,
    is_int,
    raise_invalid,
    short_repr,
    to_float,
)
from ..field_checks import check_fields
from .motion import FREE, STOPPED, Motion, check_function, is_number, motion_of

MAX_ANGLES = 4  # of a robot model
MAX_KEPT = 5  # maximum size of the memory of a robot model
_SAMPLES = 12
_ROUNDING = 1e-9


def _check_dims(field: str, value: Any) -> tuple[int, ...]:
    known = isinstance(value, tuple) and all(is_int(dim) and dim in (2, 3) for dim in value)
    if not known or not value:
        raise_invalid(field, value, "a tuple of 2 and 3, or of one of them")
    return value


@dataclass(frozen=True)
class RobotModel:
    """Robot model.

    Raises:
        ValueError: naming the field, its value and the remedy.
        TypeError: if a field that must be a function is not callable.
    """

    name: str
    dims: Annotated[tuple[int, ...], _check_dims]
    """Supported dimensions."""
    constants: Annotated[Callable[[Any], Any], check_function]
    """Scenario → NamedTuple of constants for the equations, with fields ``duration`` (τ, s) and
    ``speed_limit`` (m/s, never exceeded)."""
    bounds: Annotated[Callable[[Any], list[float]], check_function]
    """Scenario → symmetric bound of each action component."""
    n_angles: Annotated[int, partial(check_int, least=0, most=MAX_ANGLES)] = 0
    """Number of attitude angles, the first entries of the memory; 0 for a fixed frame."""
    n_kept: Annotated[Callable[[int], int], check_function] | None = None
    """Dimension → size of the memory; None is ``n_angles``."""
    keeps_velocity: bool = False
    """True if the memory after the angles is the velocity in the global frame, m/s, within the
    speed limit."""
    senses: Literal["gravity", "velocity"] | None = None
    """Last row of an observation: "gravity", "velocity", or nothing."""
    action: str = "velocity, m/s"
    """Description of the action."""
    theorem: str | None = None
    """Theorem that covers its law in continuous time, for example "theorem 3"."""
    bounded: bool = False
    """True if the action is the velocity with bounds v_max, as assumed by theorems 1, 2, A and C
    and the bounds of theory 3."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise_invalid("name of a robot model", self.name, "a word of letters, digits and _")
        check_fields(self, f"{{}} of robot model {self.name!r}")
        for dim in self.dims:
            size = self.memory_size(dim)
            wanted = f"from {self.n_angles}, its angles, to {MAX_KEPT}"
            right = is_int(size) and self.n_angles <= size <= MAX_KEPT
            if right and self.keeps_velocity:
                right, wanted = size == self.n_angles + dim, f"{self.n_angles + dim} with velocity"
            if not right:
                kept = f"{short_repr(size)} numbers in {dim}-D; it must be {wanted}"
                raise ValueError(f"robot model {self.name!r} keeps {kept}")

    def memory_size(self, dim: int) -> int:
        """Size of the memory."""
        return self.n_angles if self.n_kept is None else self.n_kept(dim)

    @property
    def nonholonomic(self) -> bool:
        """True if the robot moves along its body axis only; a ``bounded`` one is holonomic."""
        return self.n_angles > 0 and not self.bounded


ROBOT_MODELS = Registry("robot model", "rv.register_robot_model")
_EXAMPLES: list[Callable[[str, int], Any]] = []


def try_with(example: Callable[[str, int], Any]) -> None:
    """Set the factory of scenarios (model name, dimension) used to validate models."""
    _EXAMPLES.append(example)


def register_robot_model(model: RobotModel, *, replace: bool = False) -> None:
    """Register a robot model by name; ``replace`` overwrites an existing one.

    Its equations, described by ``motion.describe``, are validated numerically.

    Raises:
        ValueError: if it is not a RobotModel or its name is taken; or if its equations give values
            that are not finite, exceed the speed limit, or are inconsistent.
    """
    if not isinstance(model, RobotModel):
        raise_invalid("model", model, "a RobotModel")
    known = ROBOT_MODELS.get(model.name)
    if known is not None and replace is not True:
        remedy = "replace=True overwrites it"
        raise ValueError(f"robot model {model.name!r} is already registered; {remedy}")
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


def is_custom(model: RobotModel) -> bool:
    """True if a robot model is custom."""
    return not getattr(model.constants, "__module__", "").startswith(__package__)


def constants_of(scenario: Any, early: bool = False) -> Any:
    """Constants for the equations of a scenario's robot model, validated with sampled calls.

    At registration (``early``) a model need not be described yet, nor fit the time step.
    """
    model, tau = scenario.model, scenario.tau
    who = f"robot model {model.name!r}"
    constants = _called(f"constants of {who}", model.constants, scenario)
    given = _called(f"bounds of {who}", model.bounds, scenario)
    kind = type(constants)
    motion = motion_of(kind)
    if motion is None:
        if early and hasattr(kind, "_fields"):
            return constants
        remedy = "register its equations with describe_motion"
        raise ValueError(f"the constants of {who} are a {kind.__name__}; {remedy}")
    duration, limit = (getattr(constants, name, None) for name in ("duration", "speed_limit"))
    if not isinstance(duration, float) or duration != tau:
        if early:
            return constants
        raise_invalid(
            f"duration in the constants of {who}", duration, f"the step, {format_limit(tau)} s"
        )
    if not isinstance(limit, float) or not 0.0 <= limit < math.inf:
        raise_invalid(f"speed_limit in the constants of {who}", limit, "a float of 0 m/s or more")
    fastest = f"the scenario's {format_limit(scenario.speed_limit)} m/s, since the model is bounded"
    if model.bounded and limit != scenario.speed_limit:
        raise_invalid(f"speed_limit in the constants of {who}", limit, fastest)
    bounds = floats(f"bounds of {who}", given)
    if bounds.ndim != 1 or not bounds.size:
        raise_invalid(f"bounds of {who}", given, "a list of numbers")
    for k, bound in enumerate(bounds.tolist()):
        if not 0.0 <= bound < math.inf:  # 0: robots without links and without a given speed
            raise_invalid(f"bounds[{k}] of {who}", bound, "finite, and 0 or more")
        if model.bounded and bound != scenario.speed_limit:
            raise_invalid(f"bounds[{k}] of {who}", bound, fastest)
    # the package's own equations are tested, but not as those of another model
    if (early and model.bounded) or not kind.__module__.startswith(f"{__package__}."):
        try_equations(model, motion, constants, bounds, scenario.dim)
    return constants


def limits_of(scenario: Any) -> NDArray[np.float64] | None:
    """Constants of each robot, (n, constants), for ``constants_of_robot``; None if all are equal.

    Raises:
        ValueError: for a custom model whose constants differ in something other than a float.
    """
    if not scenario.per_robot:
        return None
    found: dict[Any, Any] = {}
    rows, alike = [], constants_of(scenario.of_robot(0))
    for robot in range(scenario.n_robots):
        own = tuple(getattr(scenario, name)[robot] for name in scenario.per_robot)
        if own not in found:
            found[own] = constants_of(scenario.of_robot(robot))
        made = found[own]
        for name in made._fields:
            if not is_number(type(made), name) and getattr(made, name) != getattr(alike, name):
                raise ValueError(
                    f"{', '.join(scenario.per_robot)}: robots differ in the constant {name!r} of "
                    f"robot model {scenario.robot_model!r}; annotate it as float in its class"
                )
        rows.append(
            [
                value if is_number(type(made), name) else math.nan
                for name, value in zip(made._fields, made, strict=True)
            ]
        )
    return np.array(rows, dtype=np.float64)


def _called(what: str, function: Any, *arguments: Any) -> Any:
    """Result of a custom function, as plain Python."""
    try:
        return getattr(function, "py_func", function)(*arguments)
    except ZeroDivisionError:
        raise
    except Exception as error:
        if str(error) == "math domain error":
            return math.nan
        raise ValueError(f"{what} fails: {type(error).__name__}: {error}") from error


def try_equations(
    model: RobotModel, motion: Motion, constants: Any, bounds: NDArray[np.float64], dim: int
) -> None:
    """Validate all equations with sampled calls; raises for the first invalid one."""
    random, used = np.random.default_rng(0), np.zeros(len(bounds), bool)
    for sample in range(_SAMPLES):
        drawn = random.uniform(-1.0, 1.0, len(bounds)) * bounds * 0.1 ** (sample % 4)
        action = (-bounds, bounds)[sample] if sample < 2 else drawn  # the limits are fastest
        asked = _Asked(model, motion, constants, tuple(action.tolist()), dim)
        try:
            # overflow is rejected as not finite; random streams overflow by design
            with np.errstate(over="ignore", invalid="ignore"):
                used |= asked.step(sample)
        except ZeroDivisionError:  # which compiled code treats as infinite
            continue
    if not used.all():
        raise ValueError(
            f"bounds of robot model {model.name!r} are {counted(len(bounds), 'number')}, but its "
            f"equations do not use action[{int(np.argmin(used))}]; give one bound for each "
            "component of an action"
        )


class _Asked(NamedTuple):
    """Validation of the equations of a robot model for one action."""

    model: RobotModel
    motion: Motion
    constants: Any
    action: tuple[float, ...]
    dim: int

    def ask(self, name: str, *arguments: Any) -> Any:
        """Result of an equation."""
        what = f"{name} of robot model {self.model.name!r}"
        return _called(what, getattr(self.motion, name), self.constants, *arguments)

    def numbers(self, name: str, count: int, *arguments: Any) -> tuple[float, ...]:
        """Result of an equation, validated to be the given number of finite values."""
        return self.check(name, count, self.ask(name, *arguments))

    def check(self, name: str, count: int, found: Any) -> tuple[float, ...]:
        """Raise unless a value is the given number of finite values."""
        finite = isinstance(found, tuple) and all(
            math.isfinite(to_float(number)) for number in found
        )
        if not finite or len(found) != count:
            self.refuse(name, found, f"a tuple of {count} finite numbers")
        return found

    def refuse(self, name: str, found: Any, wanted: str) -> NoReturn:
        """Raise an error that names the remedy."""
        raise ValueError(
            f"{name} of robot model {self.model.name!r} gives {short_repr(found)} for the action "
            f"{short_repr(self.action)}; it must be {wanted}"
        )

    def step(self, seed: int) -> NDArray[np.bool_]:
        """Validate all equations of a step in order; returns which action components they use."""
        action, dim, size = self.action, self.dim, self.model.memory_size(self.dim)
        tau, limit = self.constants.duration, self.constants.speed_limit
        memory = self.numbers("init", size, np.uint64(seed), 0)
        c, s = math.cos(0.5 * seed), math.sin(0.5 * seed)
        start = (c, -s, s, c) if dim == 2 else (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        frame = self.numbers("frame", dim * dim, start, memory)
        rotation = np.reshape(frame, (dim, dim))
        if not np.allclose(rotation @ rotation.T, np.eye(dim), atol=1e-6):
            self.refuse("frame", frame, "a rotation, row by row")
        proposed = self.ask("propose", action, frame, memory)
        if not isinstance(proposed, tuple) or len(proposed) != 2:
            self.refuse("propose", proposed, "a displacement and the path length")
        displacement = np.array(self.check("propose", dim, proposed[0]))
        way, far = to_float(proposed[1]), float(np.linalg.norm(displacement))
        slack = _ROUNDING * (1.0 + limit * tau)
        if not far - slack <= way < math.inf:
            self.refuse(
                "propose", proposed, f"a path length of {far:g} m, its displacement, or longer"
            )
        if far > limit * tau + slack:
            wanted = f"a displacement of speed_limit times {format_limit(tau)} s at most"
            self.refuse("propose", proposed, wanted)
        if self.model.bounded:
            self._check_velocity(rotation, displacement)
        self.numbers("update", size, action, frame, memory, (0.0,) * dim, STOPPED)
        kept = self.numbers("update", size, action, frame, memory, proposed[0], FREE)
        if size:
            self._check_curve(frame, memory, displacement)
        self.numbers("sense", dim if self.model.senses else 0, frame, memory)
        looks = np.zeros(len(action), bool)
        for k in range(len(action)):
            other = (*action[:k], 0.5 * action[k], *action[k + 1 :])
            looks[k] = (
                self.ask("propose", other, frame, memory) != proposed
                or self.ask("update", other, frame, memory, proposed[0], FREE) != kept
            )
        return looks

    def _check_velocity(self, rotation: Any, displacement: NDArray[np.float64]) -> None:
        """Check that a ``bounded`` model moves by τ R a, limited to the speed limit."""
        tau, limit, action = self.constants.duration, self.constants.speed_limit, self.action
        slowed = tau * min(1.0, limit / max(math.hypot(*action), 1e-300))
        wanted = slowed * rotation @ action if len(action) == self.dim else np.inf
        if np.abs(displacement - wanted).max() > _ROUNDING * (1.0 + limit * tau):
            held = f"τ R a, of {self.dim} numbers, limited to {format_limit(limit)} m/s at most"
            self.refuse("propose", displacement.tolist(), f"{held}, since the model is bounded")

    def _check_curve(self, frame: Any, memory: Any, displacement: NDArray[np.float64]) -> None:
        """Check that ``displacement_at`` ends as ``propose``, within β τ² of its chord."""
        tau = self.constants.duration
        bent = to_float(self.ask("chord_error_bound", self.action, memory))
        if not 0.0 <= bent < math.inf:
            self.refuse("chord_error_bound", bent, "a finite number, 0 or more")
        period = self.ask("period", self.action, memory)
        if not to_float(period) > 0.0:
            self.refuse("period", period, "a positive number, inf for never")
        slack = 1e-6 * (1.0 + float(np.linalg.norm(displacement)))
        for share in (0.0, 0.3, 0.5, 1.0):
            given = self.action, frame, memory, share * tau
            found = self.numbers("displacement_at", self.dim, *given)
            aside = float(np.linalg.norm(found - share * displacement))
            if share in (0.0, 1.0) and aside > slack:
                wanted = f"{share:g} of the result of propose, after {share:g} of the step"
                self.refuse("displacement_at", found, wanted)
            if aside > bent * tau * tau * (1.0 + 1e-6) + slack:
                wanted = f"at least the curvature of the path, {aside / tau**2:g} m/s² or more"
                self.refuse("chord_error_bound", bent, wanted)
