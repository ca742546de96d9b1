"""Failures and disturbances of robots: settings, draws and constants.

Times and robots are given, or sampled for every episode. Random numbers depend on seed, episode,
step and robot, so an episode is the same in any batch.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks, field_checks
from ..compilation import inner_kernel, kernel
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..limits import LARGEST, MAX_ROBOTS
from ..physics.random_streams import EVENTS, stream_key, uniform

CRASH, BLIND, SIGHTED, ADVERSARY = range(4)
"""Columns of the steps in which events begin or end."""
NEVER = 2**62  # step of an event that does not happen
DRAWS = 10
"""Words of the stream ACTUATION for a robot in a step: slip, the bounded disturbance (3), the
Gaussian one (4), the turn of its frame (2)."""
_WANTED = {2: "a list of pairs [robot, time in s]", 3: "a list of [robot, start in s, end in s]"}


def _check_times(field: str, value: Any, columns: int) -> tuple[tuple[float, ...], ...]:
    """Validated rows of a robot and one or two times."""
    if not checks.is_sequence(value):
        checks.raise_invalid(field, value, _WANTED[columns])
    rows: list[tuple[float, ...]] = []
    for k, row in enumerate(value):
        if not checks.is_sequence(row) or len(row) != columns:
            checks.raise_invalid(f"{field}[{k}]", row, _WANTED[columns])
        robot = checks.check_int(f"{field}[{k}][0]", row[0], 0, MAX_ROBOTS - 1)
        times = [checks.number(f"{field}[{k}]", time, least=0.0, unit="s") for time in row[1:]]
        if columns == 3 and times[1] <= times[0]:
            checks.raise_invalid(f"{field}[{k}][2]", times[1], f"later than {times[0]} s")
        rows.append((robot, *times))
    if len({row[0] for row in rows}) < len(rows):
        checks.raise_invalid(field, value, "a list with each robot once")
    return tuple(rows)


def _check_rates(field: str, value: Any) -> float | tuple[float, ...]:
    """Validated rate of all robots, or one for each."""
    one = partial(checks.number, least=-LARGEST, most=LARGEST, unit="rad/s")
    if not checks.is_sequence(value):
        return one(field, value)
    return tuple(one(f"{field}[{robot}]", rate) for robot, rate in enumerate(value))


_Times = tuple[tuple[float, ...], ...]
_Count = Annotated[int, partial(checks.check_int, least=0, most=MAX_ROBOTS)]
_Speed = Annotated[float, partial(checks.number, least=0.0, unit="m/s")]


@lists_fields
@field_checks.names_unknown_fields("events")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Events:
    """Failures and disturbances of robots; none by default.

    A robot that merges with a crashed one has crashed, too; the same holds for adversaries. Robots
    are sampled without given events, for each kind, and times uniformly within the time limit.

    Raises:
        ValueError: naming the field, its value and the allowed values.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    crashes: Annotated[_Times, partial(_check_times, columns=2)] = ()
    """Crashes as pairs [robot, time in s]: the robot does not move from then on. It still observes
    and is observed."""
    sensor_failures: Annotated[_Times, partial(_check_times, columns=3)] = ()
    """Sensor failures as rows [robot, start, end], s: all rows of neighbours and obstacles are zero
    in between."""
    adversaries: Annotated[_Times, partial(_check_times, columns=2)] = ()
    """Adversarial robots as pairs [robot, time in s]: from then on the robot moves at full speed in
    the direction of steepest increase of V. For robots whose action is their velocity."""
    n_crashed: _Count = 0
    """Number of robots that crash at random times, in addition to the given ones."""
    n_blind: _Count = 0
    """Number of robots whose sensor fails between two random times."""
    n_adversarial: _Count = 0
    """Number of robots that become adversarial at a random time."""
    compass_drift: Annotated[float | tuple[float, ...], _check_rates] = 0.0
    """Rate at which the local frame of each robot turns about the vertical, rad/s; one number, or a
    list with one for each robot. For single and double integrators."""
    compass_walk: Annotated[float, partial(checks.number, least=0.0, unit="rad/√s")] = 0.0
    """Random walk of the local frames: the standard deviation of their angle after one second,
    rad/√s."""
    slip: Annotated[float, partial(checks.number, least=0.0, most=1.0)] = 0.0
    """Maximum relative loss by slip: each robot executes its command times 1 − slip·u, u uniform in
    [0, 1] in every step."""
    disturbance: _Speed = 0.0
    """Bound w on a velocity disturbance, m/s: uniform in the disc or ball of this radius for each
    robot and step. The speed limit holds for command and disturbance together. For robots whose
    action is their velocity, as the next one."""
    disturbance_noise: _Speed = 0.0
    """Standard deviation of each component of a Gaussian velocity disturbance, m/s."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        field_checks.check_fields(self, "events.{}")

    @property
    def none(self) -> bool:
        """True if there are no failures and no disturbances."""
        return self == _NOTHING

    @property
    def fails(self) -> bool:
        """True if robots may crash, lose their sensor or become adversarial."""
        given = self.crashes or self.sensor_failures or self.adversaries
        return bool(given) or self.n_crashed + self.n_blind + self.n_adversarial > 0

    @property
    def drives(self) -> bool:
        """True if commands are changed: by crashes, adversaries, slip or disturbances."""
        found = self.slip + self.disturbance + self.disturbance_noise
        return found > 0.0 or bool(self.kinds & {"crash", "adversary"})

    @property
    def turns_frames(self) -> bool:
        """True if local frames rotate."""
        rates = self.compass_drift
        drifts = any(rates) if isinstance(rates, tuple) else rates != 0.0
        return drifts or self.compass_walk > 0.0

    @property
    def is_random(self) -> bool:
        """True if episodes of one initial condition differ."""
        drawn = self.n_crashed + self.n_blind + self.n_adversarial
        found = self.compass_walk + self.slip + self.disturbance + self.disturbance_noise
        return drawn > 0 or found > 0.0

    @property
    def kinds(self) -> set[str]:
        """Kinds of events: crash, blind, adversary, compass, slip, disturbance, noise."""
        found = {
            "crash": bool(self.crashes) or self.n_crashed > 0,
            "blind": bool(self.sensor_failures) or self.n_blind > 0,
            "adversary": bool(self.adversaries) or self.n_adversarial > 0,
            "compass": self.turns_frames,
            "slip": self.slip > 0.0,
            "disturbance": self.disturbance > 0.0,
            "noise": self.disturbance_noise > 0.0,
        }
        return {kind for kind, present in found.items() if present}

    def check_fits(self, scenario: Any) -> None:
        """Reject values that do not fit the robots of a scenario."""
        n, model = scenario.n_robots, scenario.model
        for field in ("crashes", "sensor_failures", "adversaries"):
            for k, (robot, *_) in enumerate(getattr(self, field)):
                if robot >= n:
                    checks.raise_invalid(f"events.{field}[{k}][0]", robot, f"below n_robots = {n}")
        for field, given in _DRAWN.items():
            count, free = getattr(self, field), n - len(getattr(self, given))
            if count > free:
                checks.raise_invalid(f"events.{field}", count, f"at most {free}, the other robots")
        if isinstance(self.compass_drift, tuple) and len(self.compass_drift) != n:
            wanted = f"{n} numbers, one for each robot, or a single one for all of them"
            checks.raise_invalid("events.compass_drift", list(self.compass_drift), wanted)
        if self.turns_frames and model.n_angles > 0:
            self._refuse(
                "compass_drift",
                "compass_walk",
                why="bodies, not compasses, turn frames of",
                by=scenario.robot_model,
            )
        if not model.bounded:
            velocity = "adversaries", "n_adversarial", "disturbance", "disturbance_noise"
            self._refuse(
                *velocity, why="the action is not the velocity of", by=scenario.robot_model
            )
        if model.keeps_velocity:
            self._refuse(
                "crashes", "n_crashed", "slip", why="inertia moves", by=scenario.robot_model
            )

    def _refuse(self, *fields: str, why: str, by: Any) -> None:
        """Reject fields that a robot model does not support."""
        for field in fields:
            value, usual = getattr(self, field), getattr(_NOTHING, field)
            if value != usual:
                wanted = f"{usual!r} with robot_model={by!r}: {why} such robots"
                checks.raise_invalid(f"events.{field}", value, wanted)

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML or JSON, without fields at their defaults."""
        plain = dataclasses.asdict(self)
        changed = {name: v for name, v in plain.items() if v != getattr(_NOTHING, name)}
        return {
            name: [[*row] if isinstance(row, tuple) else row for row in v]
            if isinstance(v, tuple)
            else v
            for name, v in changed.items()
        }

    def __str__(self) -> str:
        """Fields that differ from their defaults, as text."""
        return ", ".join(f"{name} = {value}" for name, value in self.to_plain().items())


_DRAWN = {"n_crashed": "crashes", "n_blind": "sensor_failures", "n_adversarial": "adversaries"}
"""Fields of given robots by the field of the number of drawn ones."""
_NOTHING = Events()


class EventRules(NamedTuple):
    """Constants of disturbances for kernels."""

    fails: bool
    crashes: bool  # whether robots may crash
    opposes: bool  # whether robots may be adversarial
    draws: bool  # whether commands change randomly
    slip: float
    disturbance: float  # m/s
    noise: float  # m/s
    speed_limit: float  # m/s, of adversaries
    turns: NDArray[np.float64]  # (n, 2), cosine and sine of the drift of frames in a step
    walk: float  # rad, standard deviation of a step


class FaultRules(NamedTuple):
    """Rules for sampling an episode's failures."""

    given: NDArray[np.int64]  # (n, 4), steps of given events, NEVER without one
    crashed: int  # numbers of sampled robots
    blind: int
    adversarial: int
    steps: int  # from which times are sampled


def rules_of(scenario: Any) -> EventRules:
    """Constants of a scenario's disturbances."""
    events, tau = scenario.events, scenario.tau
    drifts = np.broadcast_to(np.asarray(events.compass_drift) * tau, scenario.n_robots)
    return EventRules(
        fails=events.fails,
        crashes="crash" in events.kinds,
        opposes="adversary" in events.kinds,
        draws=events.slip + events.disturbance + events.disturbance_noise > 0.0,
        slip=events.slip,
        disturbance=events.disturbance,
        noise=events.disturbance_noise,
        speed_limit=float(scenario.speed_limit),
        turns=np.stack([np.cos(drifts), np.sin(drifts)], axis=-1),
        walk=events.compass_walk * math.sqrt(tau),
    )


def fault_rules(scenario: Any) -> FaultRules:
    """Rules of a scenario's failures; a time counts from the first step at or after it."""
    events, given = scenario.events, np.full((scenario.n_robots, 4), NEVER)

    def step_of(time: float) -> int:
        return min(math.ceil(time / scenario.tau - 1e-9), NEVER)

    for robot, time in events.crashes:
        given[robot, CRASH] = step_of(time)
    for robot, start, end in events.sensor_failures:
        given[robot, BLIND], given[robot, SIGHTED] = step_of(start), step_of(end)
    for robot, time in events.adversaries:
        given[robot, ADVERSARY] = step_of(time)
    numbers = events.n_crashed, events.n_blind, events.n_adversarial
    return FaultRules(given, *numbers, scenario.max_steps)


@kernel
def draw_faults(which, rules, seeds, episodes, faults):
    """Write the steps of all events of new episodes, (B, 4, n), given and sampled.

    For each kind, those with the lowest random numbers of the robots without a given event are
    selected.
    """
    n = faults.shape[2]
    for place in range(len(which)):
        b = which[place]
        key = stream_key(seeds[b], episodes[b], EVENTS)
        for i in range(n):
            for column in range(4):
                faults[b, column, i] = rules.given[i, column]
        _draw_kind(key, 0, rules.crashed, CRASH, rules, faults[b])
        _draw_kind(key, 1, rules.blind, BLIND, rules, faults[b])
        _draw_kind(key, 2, rules.adversarial, ADVERSARY, rules, faults[b])


@inner_kernel
def _draw_kind(key, kind, count, column, rules, faults):
    """Sample ``count`` robots for one kind of event, and their times."""
    n = faults.shape[1]
    for i in range(n if count > 0 else 0):
        if rules.given[i, column] != NEVER:
            continue
        rank, own = 0, uniform(key, (kind * n + i) * 3)
        for j in range(n):
            other = uniform(key, (kind * n + j) * 3)
            lower = other < own or (other == own and j < i)
            rank += 1 if lower and rules.given[j, column] == NEVER else 0
        if rank < count:
            one = int(uniform(key, (kind * n + i) * 3 + 1) * rules.steps)
            two = int(uniform(key, (kind * n + i) * 3 + 2) * rules.steps)
            faults[column, i] = min(one, two) if column == BLIND else one
            if column == BLIND:
                faults[SIGHTED, i] = max(one, two) + 1


@inner_kernel(inline="code")
def unit_pair(x, y):
    """Normalise a pair of nearly unit length by a Newton step: an error e becomes 3 e²/2."""
    factor = 1.5 - 0.5 * (x * x + y * y)
    return x * factor, y * factor
