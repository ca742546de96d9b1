"""Sensor imperfections of a scenario; none by default."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .. import checks, field_checks
from ..field_checks import known_arguments
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..limits import MAX_DELAY, MAX_SECTORS
from .custom_sensors import as_custom

_FULL_CIRCLE = 2.0 * math.pi
PER_ROBOT = (
    "range", "field_of_view", "noise", "dropout", "min_range", "observer_bias", "outliers", "bias",
    "delay", "delay_time", "detection", "persistence", "noise_correlation", "sample_period",
    "view_falloff", "error", "sectors", "occlusion", "outlier_kind",
)  # fmt: skip
"""Fields with one value for all robots, or a list with one for each: all but ``custom``.

A custom imperfection is a function of the observations of all robots, and may treat each in its own
way."""
_ABSENT = {"range": ("unlimited", math.inf), "sectors": ("none", 0.0)}
"""Fields that are None in a robot without them: in plain data a word, and in ``each`` a number."""
_Each = float | tuple[float, ...]
_Occlusion = Literal["none", "obstacles", "robots", "both"]
_Outlier = Literal["uniform", "robot"]
_Table = tuple[tuple[float, float], ...]


def _check_view(field: str, value: Any) -> float:
    if not 0.0 < checks.to_float(value) <= _FULL_CIRCLE:
        checks.raise_invalid(
            field, value, "a positive number of at most 2π = 6.283185307179586 rad"
        )
    return checks.to_float(value)


def _each(check: Any, unit: str = "") -> Any:
    """Check of one value for all robots, or a list with one for each."""
    return partial(checks.one_or_each, check=check, unit=unit, keeps_lists=True)


_angle = partial(checks.number, least=0.0, most=_FULL_CIRCLE, unit="rad")
_time = partial(checks.number, least=0.0, unit="s")
_Deviations = Annotated[_Each, _each(_angle, "rad")]
_Times = Annotated[_Each, _each(_time, "s")]


def _check_ranges(field: str, value: Any) -> Any:
    """Maximum distance, m, or one for each robot, None for those without a limit."""
    one = _or_none("range", partial(checks.positive, unit="m"), "no limit")
    return checks.one_or_each(field, value, one, "m", keeps_lists=True)


def _check_sectors(field: str, value: Any) -> Any:
    """Number of sectors, or one for each robot, None for those with exact bearings."""
    one = _or_none(
        "sectors", partial(checks.check_int, least=2, most=MAX_SECTORS), "exact bearings"
    )
    return checks.one_or_each(field, value, one, keeps_lists=True)


def _or_none(name: str, check: Any, meaning: str) -> Any:
    """Check of one value of a field of ``_ABSENT``, which may be None or its word."""

    def one(field: str, value: Any) -> Any:
        if value is None or (isinstance(value, str) and value == _ABSENT[name][0]):
            return None
        try:
            return check(field, value)
        except ValueError as error:
            raise ValueError(f"{error}, or None for {meaning}") from None

    return one


def _words(choices: Any) -> Any:
    """Check of one word for all robots, or a list with one for each."""
    return _each(partial(checks.choice, choices=get_args(choices)))


def _check_tables(field: str, value: Any) -> _Table | tuple[_Table, ...]:
    """Table of all robots, or a list with one for each; an empty one always detects."""
    if not (checks.is_sequence(value) and any(map(_may_be_table, value))):
        return _check_table(field, value)
    return tuple(_check_table(f"{field}[{robot}]", own) for robot, own in enumerate(value))


def _may_be_table(value: Any) -> bool:
    """True if a value is a list of lists, or empty; a row of a table is neither."""
    return checks.is_sequence(value) and (len(value) == 0 or checks.is_sequence(value[0]))


def _check_table(field: str, value: Any) -> _Table:
    """Pairs of a distance, m, and a probability, by increasing distance."""
    wanted = "a list of pairs [distance in m, probability], such as [[1.0, 0.5], [6.0, 0.2]]"
    if not checks.is_sequence(value):
        checks.raise_invalid(field, value, wanted)
    table: list[tuple[float, float]] = []
    for row, pair in enumerate(value):
        if not checks.is_sequence(pair) or len(pair) != 2:
            checks.raise_invalid(f"{field}[{row}]", pair, wanted)
        distance = checks.number(f"{field}[{row}][0]", pair[0], least=0.0, unit="m")
        chance = checks.number(f"{field}[{row}][1]", pair[1], least=0.0, most=1.0)
        if table and distance <= table[-1][0]:
            beyond = f"more than the distance before it, {checks.format_limit(table[-1][0])} m"
            checks.raise_invalid(f"{field}[{row}][0]", distance, beyond)
        table.append((distance, chance))
    return tuple(table)


@lists_fields
@field_checks.names_unknown_fields("sensing")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensing:
    """Sensor model: differences from exact sensors, which measure the bearing of every neighbour.

    Links, merges and V follow the graph, regardless of missed detections. A missing row is zero;
    all others keep their length. Random numbers depend on seed, episode, step and ordered pair, so
    an episode is the same in any batch.

    There is no constant compass error: it would rotate measurements and commands alike, and cancels
    for laws without memory of directions. Random ``Scenario.local_frames`` have the same effect.

    Raises:
        ValueError: naming the field, its value and the allowed values.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    range: Annotated[float | tuple[float | None, ...] | None, _check_ranges] = None
    """Maximum distance of detected neighbours, m, of all robots or a list with one for each; None
    is unlimited."""
    field_of_view: Annotated[_Each, _each(_check_view, "rad")] = _FULL_CIRCLE
    """Full angle of the field of view around the body or local x axis, rad, of all robots or a list
    with one for each. An obstacle is visible while one of its edge points is inside."""
    noise: _Deviations = 0.0
    """Standard deviation of angular noise per ordered pair and step, rad, of all robots or a list
    with one for each; in 3-D about a random axis perpendicular to the bearing. White unless
    noise_correlation is given."""
    bias: _Deviations = 0.0
    """Standard deviation of a constant error of each bearing, sampled for every ordered pair and
    episode, rad, of all robots or a list with one for each. Pairs differ, so unlike a compass error
    it does not cancel."""
    error: Annotated[
        _Each, _each(partial(checks.number, least=0.0, most=math.pi, unit="rad"), "rad")
    ] = 0.0
    """Adversarial error: bearings are rotated by this angle in the direction that increases L most,
    rad, of all robots or a list with one for each (theorem N; guarantees, section 11)."""
    dropout: Annotated[_Each, _each(partial(checks.number, least=0.0, most=1.0))] = 0.0
    """Probability that a neighbour is not detected in a step, of all robots or a list with one for
    each."""
    delay: Annotated[
        int | tuple[int, ...], _each(partial(checks.check_int, least=0, most=MAX_DELAY), "steps")
    ] = 0
    """Delay of observations, steps, of all robots or a list with one for each; the first
    observation is held until then."""
    sectors: Annotated[int | tuple[int | None, ...] | None, _check_sectors] = None
    """Number of sectors to which bearings are quantised, in 3-D in yaw and elevation (± π/2), of
    all robots or a list with one for each; None disables quantisation."""
    occlusion: Annotated[_Occlusion | tuple[_Occlusion, ...], _words(_Occlusion)] = "none"
    """Occluding objects: none, obstacles, robots (discs or spheres of radius r/2) or both; for all
    robots or a list with one for each."""
    custom: Annotated[tuple[str, ...], as_custom] = ()
    """Names of custom imperfections (``sensor_imperfection``), applied last in this order, to the
    observations of all robots."""
    min_range: Annotated[_Each, _each(partial(checks.number, least=0.0, unit="m"), "m")] = 0.0
    """Blind zone, m, of all robots or a list with one for each: nearer neighbours are not detected.
    Links of a proximity graph stay."""
    sample_period: _Times = 0.0
    """Time between two samples, s, of all robots or a list with one for each: rows are refreshed at
    the first step at or after each multiple of it, and held until then; 0 is every step."""
    delay_time: _Times = 0.0
    """Delay of observations, s, of all robots or a list with one for each: rounded to whole steps,
    half a step upwards. Each robot has either this or ``delay``."""
    observer_bias: _Deviations = 0.0
    """Standard deviation of a constant rotation of a robot's sensor in an episode, rad, of all
    robots or a list with one for each. It affects all bearings, of obstacles too, but not commands.
    In 3-D the axis is random, and this is the root mean square rotation of any bearing."""
    noise_correlation: _Times = 0.0
    """Time constant of noise, s, of all robots or a list with one for each: errors at two times t
    apart have correlation exp(−t/T); their distribution is that of white noise, which 0 gives. In
    3-D the axis is constant for each pair and episode."""
    detection: Annotated[_Table | tuple[_Table, ...], _check_tables] = ()
    """Probability of detecting a neighbour by its distance, a list of pairs (m, probability):
    linear in between, constant beyond the first and the last; of all robots, or a list with one
    such list for each. It is multiplied by 1 − dropout."""
    view_falloff: _Deviations = 0.0
    """Width of the border of the field of view, rad, of all robots or a list with one for each. In
    it the probability of detection falls linearly to zero at the edge. A full field of view has no
    edge."""
    persistence: _Times = 0.0
    """Time constant of detection, s, of all robots or a list with one for each: a two-state Markov
    chain for each ordered pair. After a time t, with detection probability p, a detected robot is
    detected with probability p + (1 − p) exp(−t/T) and a missed one with p (1 − exp(−t/T)); 0 makes
    steps independent."""
    outliers: Annotated[_Each, _each(partial(checks.number, least=0.0, most=1.0))] = 0.0
    """Probability that a detected neighbour's bearing is replaced in a step by an outlier, of all
    robots or a list with one for each."""
    outlier_kind: Annotated[_Outlier | tuple[_Outlier, ...], _words(_Outlier)] = "uniform"
    """Outlier: a uniform direction, or the bearing of another active robot, sampled uniformly;
    without another one, the bearing is unchanged. For all robots or a list with one for each."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        field_checks.check_fields(self, "sensing.{}")
        if any(steps > 0 and seconds > 0.0 for steps, seconds in self._of("delay", "delay_time")):
            steps = self._in_words("delay", "steps")
            raise ValueError(
                f"sensing.delay is {steps} and sensing.delay_time is "
                f"{self._in_words('delay_time', 's')}; it must be one of the two: omit the other"
            )
        borders = [view for falloff, view in self._of("view_falloff", "field_of_view") if falloff]
        if borders and min(borders) >= _FULL_CIRCLE:
            raise ValueError(
                f"sensing.view_falloff is {self._in_words('view_falloff', 'rad')} and "
                "sensing.field_of_view is the full circle, which has no edge; it must be 0, or "
                "give a field_of_view below 2π rad"
            )

    @classmethod
    def camera(cls) -> Sensing:
        """Errors of four rendered 64 × 64 pixel cameras and a lamp detector (docs/worlds.md)."""
        return cls(noise=0.0075, dropout=0.03, occlusion="both")

    @classmethod
    def mrclam(cls) -> Sensing:
        """Forward camera of an iRobot Create that reads bar codes on other robots.

        Measured on five robots of UTIAS MRCLAM data set 6 (Leung, Halpern, Barfoot and Liu, IJRR
        30(8), 2011; docs/measured-sensors.md).
        """
        detection = (
            (0.9, 0.11), (1.1, 0.40), (1.35, 0.52), (1.75, 0.55), (2.5, 0.47), (3.5, 0.39),
            (4.5, 0.21), (5.5, 0.24), (7.0, 0.16),
        )  # fmt: skip
        return cls(
            min_range=0.8, field_of_view=1.16, view_falloff=0.14, detection=detection,
            persistence=0.21, noise=0.0066, noise_correlation=0.36, bias=0.004,
            observer_bias=0.0057, outliers=0.0013, outlier_kind="robot", sample_period=0.237,
            delay_time=0.04,
        )  # fmt: skip

    @classmethod
    def wifi(cls, line_of_sight: bool = True) -> Sensing:
        """Angle of arrival of WiFi packets between robots that use their own odometry.

        Measured on the Harvard-REACT WSR toolbox data set, in line of sight or without it, where
        reflections give outliers (docs/measured-sensors.md).
        """
        return cls(noise=0.145) if line_of_sight else cls(noise=0.15, outliers=0.18)

    @classmethod
    @known_arguments
    def fit(cls, bearings: Any, poses: Any, *, per_robot: bool = False, seed: int = 0) -> Sensing:
        """Sensor model of a log of bearings with ground truth.

        ``rendezvous sensor fit`` reads files and reports intervals, a prediction error and figures;
        ``rendezvous_env.calibration`` has the estimates (docs/measured-sensors.md).

        Args:
            bearings: columns ``time`` s, ``observer``, ``target``, ``bearing`` rad,
                counter-clockwise from the observer's x axis, and optionally ``elevation`` rad: a
                mapping of names to arrays, a DataFrame, or rows in this order. An empty target
                marks a frame without detections.
            poses: columns ``time`` s, ``robot``, ``x``, ``y``, optionally ``z``, m, and ``heading``
                rad, likewise. A robot with one pose is a landmark.
            per_robot: one noise level for each robot, in the order of their identifiers.
            seed: of the bootstrap.

        Raises:
            ValueError: naming the column or row and the remedy, also for clocks or units that do
                not match, and if too few bearings have ground truth.
        """
        from ..calibration import fit_sensor, from_tables

        return cls(
            **fit_sensor(from_tables(bearings, poses), per_robot=per_robot, seed=seed).fields
        )

    @property
    def exact(self) -> bool:
        """True if the sensor has no imperfection."""
        return self._united() == _EXACT

    @property
    def built_in_exact(self) -> bool:
        """True if the sensor has no built-in imperfection."""
        return dataclasses.replace(self, custom=()).exact

    @property
    def per_robot(self) -> tuple[str, ...]:
        """Names of the fields that are lists with one value for each robot."""
        return tuple(name for name in PER_ROBOT if self.list_given(name) is not None)

    def list_given(self, field: str) -> list[Any] | None:
        """List given for a field of ``PER_ROBOT``; None if it is one value for all robots."""
        own = getattr(self, field)
        if field == "detection" and not any(map(_may_be_table, own)):
            return None
        return [*own] if isinstance(own, tuple) else None

    def each(self, field: str, n_robots: int) -> NDArray[np.float64]:
        """A field of numbers for each robot, (n,), in its unit.

        Unlimited ranges are inf, and 0 sectors are exact.
        """
        given = self.list_given(field) or [getattr(self, field)]
        values = [_ABSENT[field][1] if value is None else value for value in given]
        return np.array(np.broadcast_to(np.array(values, np.float64), (n_robots,)))

    def among(self, field: str, n_robots: int, *words: str) -> NDArray[np.bool_]:
        """Mask of the robots whose value of a field is one of these words, (n,)."""
        given = self.list_given(field) or [getattr(self, field)]
        return np.broadcast_to(np.isin(given, words), (n_robots,))

    def tables(self, n_robots: int) -> list[_Table]:
        """Table of ``detection`` of each robot; empty for one that always detects."""
        return self.list_given("detection") or [self.detection] * n_robots

    def smallest(self, field: str) -> float:
        """Least value of a field of numbers among the robots; inf for unlimited ranges."""
        return float(self.each(field, len(self.list_given(field) or [0])).min())

    def largest(self, field: str) -> float:
        """Largest value of a field of numbers among the robots."""
        return float(self.each(field, len(self.list_given(field) or [0])).max())

    def delays(self, n_robots: int, tau: float) -> NDArray[np.int64]:
        """Delay of each robot in whole steps of tau, s, (n,)."""
        seconds = np.floor(self.each("delay_time", n_robots) / tau + 0.5)
        return np.maximum(self.each("delay", n_robots), seconds).astype(np.int64)

    def of_team(self, n_robots: int) -> Sensing:
        """Sensor of a team, in which a list of equal values is one value.

        Raises:
            ValueError: for lists of another length.
        """
        for name in self.per_robot:
            given = self.list_given(name)
            if given is not None and len(given) != n_robots:
                what = _ENTRIES.get(name, "numbers")
                remedy = f"{n_robots} {what}, one for each robot, or a single one for all of them"
                checks.raise_invalid(f"sensing.{name}", given, remedy)
        return self._united()

    def check_delay(self, tau: float) -> None:
        """Reject a delay of too many steps of tau, s."""
        if math.floor(self.largest("delay_time") / tau + 0.5) > MAX_DELAY:
            most = f"at most {MAX_DELAY} steps of {checks.format_limit(tau)} s: make it shorter"
            checks.raise_invalid(
                "sensing.delay_time", self.delay_time, f"{most}, or time_step longer"
            )

    def _united(self) -> Sensing:
        """Sensor with one value for each list of equal values."""
        lists = {name: self.list_given(name) or [] for name in self.per_robot}
        equal = {name: own[0] for name, own in lists.items() if len(set(own)) == 1}
        return dataclasses.replace(self, **equal) if equal else self

    def _of(self, *fields: str) -> list[tuple[Any, ...]]:
        """Values of some fields, for each robot; one tuple without lists."""
        lists = [self.list_given(field) for field in fields]
        count = max(len(given or [0]) for given in lists)
        own = zip(fields, lists, strict=True)
        columns = [given or [getattr(self, field)] * count for field, given in own]
        return [*zip(*columns, strict=False)]  # ``of_team`` refuses unequal lengths

    def _in_words(self, field: str, unit: str) -> str:
        """Value or values of a field with their unit."""
        given = self.list_given(field)
        one = getattr(self, field)
        return f"{checks.format_limit(one) if given is None else given} {unit}"

    def departures(self) -> str:
        """Names and values of the imperfections, as text."""
        own, ideal = dataclasses.asdict(self._united()), dataclasses.asdict(_EXACT)
        return ", ".join(f"{field} = {own[field]}" for field in own if own[field] != ideal[field])

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML or JSON; None is an absent key."""
        plain = {**dataclasses.asdict(self), "custom": list(self.custom) or None}
        for field in _YOUNGER:
            plain[field] = None if plain[field] == getattr(_EXACT, field) else plain[field]
        for field in self.per_robot:
            word = _ABSENT.get(field, ("",))[0]
            plain[field] = [word if one is None else one for one in plain[field]]
        plain["detection"] = plain["detection"] and _as_lists(plain["detection"])
        return {field: value for field, value in plain.items() if value is not None}


def _as_lists(value: Any) -> Any:
    """Nested tuples as lists."""
    return [*map(_as_lists, value)] if isinstance(value, tuple | list) else value


_ENTRIES = {"detection": "tables", "occlusion": "words", "outlier_kind": "words"}
"""Names of the entries of lists, "numbers" in other fields."""
_EXACT = Sensing()
_YOUNGER = (
    "min_range", "sample_period", "delay_time", "observer_bias", "noise_correlation", "detection",
    "view_falloff", "persistence", "outliers", "outlier_kind",
)  # fmt: skip
"""Fields added after the file format, absent from plain data at their defaults."""
