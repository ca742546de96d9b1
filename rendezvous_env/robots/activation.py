"""Activation: the steps in which each robot takes a new command.

A robot that is not active in a step repeats its last command or does not move (``Scenario.hold``).
Until its first activation it does not move.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks, field_checks
from ..compilation import inner_kernel
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..limits import MAX_STEPS
from ..physics.random_streams import uniform

ActivationLike = Any
"""An Activation, one of KINDS, or a table of its fields."""
KINDS = ("synchronous", "periodic", "random", "bounded")
_SYNCHRONOUS, _PERIODIC, _RANDOM, _BOUNDED = range(4)
_OWN = {"periodic": ("period", "phase"), "random": ("probability",), "bounded": ("max_wait",)}
"""Fields of each kind."""
_DEFAULTS = {"period": 2, "phase": None, "probability": 0.5, "max_wait": 2}


def _check_steps(field: str, value: Any, least: int) -> int | tuple[int, ...]:
    """Steps of all robots, or a list with one number for each."""
    one = partial(checks.check_int, least=least, most=MAX_STEPS)
    if not checks.is_sequence(value):
        return one(field, value)
    if len(value) == 0:
        checks.raise_invalid(field, value, "a whole number, or a list with one for each robot")
    return tuple(one(f"{field}[{robot}]", steps) for robot, steps in enumerate(value))


def _check_probability(field: str, value: Any) -> float:
    if not 0.0 < checks.to_float(value) <= 1.0:
        checks.raise_invalid(field, value, "in (0, 1]")
    return checks.to_float(value)


_Period = Annotated[int | tuple[int, ...], partial(_check_steps, least=1)]
_Phase = Annotated[int | tuple[int, ...], partial(_check_steps, least=0)]


@lists_fields
@field_checks.names_unknown_fields("activation")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Activation:
    """Clocks of the robots: the steps in which each one is active and takes a new command.

    Robots observe in every step; the actions of robots that are not active are ignored. Random
    draws depend on seed, episode, step and robot, so an episode is the same in any batch.

    Raises:
        ValueError: naming the field, its value and the allowed values.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    kind: Annotated[str, partial(checks.choice, choices=KINDS)] = "synchronous"
    """synchronous: every robot in every step. periodic: each by its own period and phase. random:
    each in each step with a probability. bounded: by an adversary that keeps V high, but each at
    least once in every ``max_wait`` steps."""
    period: _Period | None = None
    """Period of periodic clocks, steps, of all robots or a list with one for each; by default 2."""
    phase: _Phase | None = None
    """Step of the first activation of periodic clocks, below the period; one for all robots or a
    list. By default robot i has i modulo its period."""
    probability: Annotated[float, _check_probability] | None = None
    """Probability of random activation in a step; by default 0.5."""
    max_wait: Annotated[int, partial(checks.check_int, least=1, most=MAX_STEPS)] | None = None
    """Number of steps k of bounded activation; by default 2. Each robot is activated at least once
    in any k consecutive steps of an episode."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        field_checks.check_fields(self, "activation.{}")
        own = _OWN.get(self.kind, ())
        for field, default in _DEFAULTS.items():
            value = getattr(self, field)
            if field in own:
                object.__setattr__(self, field, default if value is None else value)
            elif value is not None:
                kinds = [kind for kind, fields in _OWN.items() if field in fields]
                remedy = f"omitted: it is a field of activation.kind = {kinds[0]!r}"
                checks.raise_invalid(f"activation.{field}", value, remedy)
        for robot, (period, phase) in enumerate(zip(*self._table(1), strict=False)):
            if self.kind == "periodic" and phase >= period:
                below = f"below its period of {period} steps"
                checks.raise_invalid(f"activation.phase of robot {robot}", phase, below)

    @property
    def synchronous(self) -> bool:
        """True if every robot is active in every step."""
        return self.kind == "synchronous"

    @property
    def longest_wait(self) -> float:
        """Number of steps k in which each robot is active at least once; inf without a bound."""
        if self.kind == "periodic":
            return max(self.period) if isinstance(self.period, tuple) else float(self.period or 1)
        if self.kind == "random":
            return 1.0 if self.probability == 1.0 else math.inf
        return float(self.max_wait or 1)

    def _table(self, n_robots: int) -> tuple[list[int], list[int]]:
        """Period and phase of each robot, for the longest list, at least n."""
        given = (self.period or 1, self.phase)
        n = max([n_robots, *(len(one) for one in given if isinstance(one, tuple))])
        periods = [*given[0]] if isinstance(given[0], tuple) else [given[0]] * n
        if given[1] is None:
            return periods, [i % period for i, period in enumerate(periods)]
        return periods, [*given[1]] if isinstance(given[1], tuple) else [given[1]] * n

    def check_fits(self, n_robots: int) -> None:
        """Reject lists that do not have one number for each robot."""
        for field in ("period", "phase"):
            value = getattr(self, field)
            if isinstance(value, tuple) and len(value) != n_robots:
                wanted = f"{n_robots} whole numbers, one for each robot, or a single one"
                checks.raise_invalid(f"activation.{field}", list(value), wanted)

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML or JSON; None is an absent key."""
        plain = {name: getattr(self, name) for name in ("kind", *_OWN.get(self.kind, ()))}
        listed = {name: [*v] if isinstance(v, tuple) else v for name, v in plain.items()}
        return {name: value for name, value in listed.items() if value is not None}

    def __str__(self) -> str:
        """Kind and fields, as text."""
        own = [f"{name} = {value}" for name, value in self.to_plain().items() if name != "kind"]
        return f"{self.kind!r}{' with ' * bool(own)}{', '.join(own)}"


def as_activation(field: str, value: Any) -> Activation:
    """Activation from its kind, a table of its fields, or itself."""
    if isinstance(value, str):
        return Activation(kind=checks.choice(field, value, KINDS))
    if isinstance(value, Mapping):
        return field_checks.from_plain(Activation, value, field)
    if not isinstance(value, Activation):
        words = ", ".join(map(repr, KINDS))
        checks.raise_invalid(
            field, value, f"one of {words}, an Activation or a table of its fields"
        )
    return value


class ActivationRules(NamedTuple):
    """Constants of the clocks for kernels; one type for all kinds."""

    kind: int
    stops: bool  # robots that are not active have zero action, instead of their last command
    periods: NDArray[np.float64]  # (n,), whole numbers of steps
    rates: NDArray[np.float64]  # (n,), their reciprocals
    phases: NDArray[np.float64]  # (n,), steps
    probability: float
    max_wait: int


def rules_of(activation: Activation, hold: str, n_robots: int) -> ActivationRules:
    """Constants for n robots."""
    periods, phases = activation._table(n_robots)
    of_robots = np.array(periods[:n_robots], np.float64)
    return ActivationRules(
        kind=KINDS.index(activation.kind),
        stops=hold == "stop",
        periods=of_robots,
        rates=1.0 / of_robots,
        phases=np.array(phases[:n_robots], np.float64),
        probability=float(activation.probability or 0.0),
        max_wait=int(activation.max_wait or 1),
    )


@inner_kernel(inline="code")
def is_scheduled(rules, step, i):
    """True if the deterministic clock of robot i activates it in a step; ``step`` is a float."""
    if rules.kind == _PERIODIC:
        since = step - rules.phases[i]
        # exact for integers, and faster than a remainder
        return since == rules.periods[i] * math.floor(since * rules.rates[i] + 0.5)
    return rules.kind == _SYNCHRONOUS


@inner_kernel(inline="code")
def is_drawn(rules, key, i):
    """True if robot i is active by chance; ``key`` is that of the stream ACTIVATION in a step."""
    return uniform(key, i) < rules.probability


@inner_kernel(inline="code")
def is_random(rules):
    """True if robots are active by chance."""
    return rules.kind == _RANDOM


@inner_kernel(inline="code")
def is_adversarial(rules):
    """True if an adversary activates robots, each at least once in ``max_wait`` steps."""
    return rules.kind == _BOUNDED
