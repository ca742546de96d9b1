"""Heading filter: certified headings from raw vectors, executed by law (4) (theorem C).

See docs/theory.md, section 3. Turn rates of nonholonomic robots are in ``turning.py``.
"""

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import flag, positive, raise_invalid, short_repr, to_float
from ..compilation import inner_kernel, kernel
from ..engine.memory import read, write
from ..engine.threads import Calls, Slice
from ..physics.neighbour_rows import degree_of, net_bearing_of
from ..physics.vectors import (
    combine,
    dot,
    load,
    load_pair,
    perpendicular,
    scaled,
    split,
    split_across,
    store,
    x_axis,
)
from ..scenario.scenario import Scenario
from .robot_lanes import (
    LANES,
    end_of_run,
    give_out,
    lanes_of,
    recall_sums,
    report,
    sum_rows,
    take_in,
    weigh_rows,
)
from .safety_filter import Float32, SafetyFilter, check_inputs, over_robots, register_filter
from .settings import MAX_TURN_RATE, check_gate_constants, check_margin, check_vectors
from .turning import Robot, desired_rates, gated_rates, pitch_of, robot_of, turn

NO_CAP = -2.0  # a minimum alignment that every heading satisfies
_NEARLY_PARALLEL = 1e-9
_NEARLY_ANTIPODAL = 1e-6  # component of a unit vector across another below which it has no side


def flexible_velocity(
    net_bearing: NDArray[np.float64], headings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Velocity of the flexible bearing-only law.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                                  (Zhao & Zheng, eq. 4)

    Args:
        net_bearing: fᵢ = Σⱼ aᵢⱼ gᵢⱼ, (..., d), m/s, in the robot's frame.
        headings: hᵢ, (..., d), unit vectors in the same frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    f, h = net_bearing, headings
    return h * np.sum(h * f, axis=-1, keepdims=True)


def step_scale(row_lengths_sum: Any, merge_radius: float, duration: float) -> Any:
    """Velocity factor min(1, r/(2 Dᵢ τ)) with which V cannot increase in a long step (theory 4).

    Dᵢ = Σⱼ aᵢⱼ is the sum of the neighbour rows' lengths, any shape, m/s; r in m, τ in s.
    """
    return merge_radius / np.maximum(2.0 * duration * row_lengths_sum, merge_radius)


scale_of_step = kernel(step_scale, inline="code")  # ``step_scale`` of a number, for kernels


@kernel
def turn_limit(max_turn):
    """Numbers cos γ, sin γ and squared chord c² = (2 sin(γ/2))² of a maximum turn γ, rad.

    The chord is inf from π on (no limit).
    """
    turn = min(max_turn, math.pi)
    chord = 2.0 * math.sin(0.5 * turn)
    square = chord * chord if max_turn < math.pi else math.inf
    return math.cos(turn), math.sin(turn), square


def certified_heading(
    raw: ArrayLike,
    net_bearing: ArrayLike,
    previous: ArrayLike,
    *,
    min_alignment: float,
    dead_zone: float,
    max_turn: float,
) -> NDArray[np.float64]:
    """Closest admissible heading to a raw vector, with guaranteed rendezvous under law (4).

        Cᵢ = {h : ‖h‖ = 1, hᵀfᵢ ≥ εᵢ ‖fᵢ‖},   εᵢ = ε clip(‖fᵢ‖/δ − 1, 0, 1)    (theorem C)

    1. Carry: the previous heading, flipped if hᵀfᵢ < 0, is projected onto the cap Cᵢ.
    2. Aim: the raw vector is projected onto the cap without flipping. A zero raw vector, or one
       along −fᵢ where that is outside the cap, aims at the carried heading.
    3. Turn from carried towards aim along the great circle, through fᵢ if they are antipodal, by at
       most ``max_turn``.

    Where fᵢ = 0 every heading is admissible, nothing is flipped, and antipodal headings turn
    counter-clockwise in the local xy plane.

    Args:
        raw: vectors, (..., d), d = 2 or 3, of any unit; only the direction is used.
        net_bearing: fᵢ, (..., d), m/s, in the same frame.
        previous: headings of the previous step, (..., d); zero for none, which carries fᵢ/‖fᵢ‖, or
            the local x axis where fᵢ = 0.
        min_alignment: ε, at least 10⁻⁶ and less than 1.
        dead_zone: δ = a*/(2n), m/s.
        max_turn: ω_max τ, rad; π or more (also inf) is no limit.

    Returns:
        Headings hᵢ, (..., d), unit vectors.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, dead_zone)
    if not to_float(max_turn) > 0:
        raise ValueError(f"max_turn is {short_repr(max_turn)}; it must be positive (rad)")
    f = check_vectors("net_bearing", net_bearing)
    q = check_vectors("raw", raw, like=f)
    h = check_vectors("previous", previous, like=f)
    out = np.empty_like(f)
    d = f.shape[-1]
    flat = (q.reshape(-1, d), f.reshape(-1, d), h.reshape(-1, d))
    turn = to_float(max_turn) if to_float(max_turn) < math.pi else math.inf
    certify(*flat, float(min_alignment), float(dead_zone), turn, out.reshape(-1, d))
    return out


@kernel
def certify(raw, net_bearing, previous, min_alignment, dead_zone, max_turn, out):
    """Unchecked, as ``certified_heading``, for arrays (N, d); ``out`` may be ``previous``."""
    limit = turn_limit(max_turn)
    for i in range(out.shape[0]):
        if out.shape[1] == 2:
            q, f, h = load_pair(raw[i]), load_pair(net_bearing[i]), load_pair(previous[i])
            out[i, 0], out[i, 1] = certify_one(q, f, h, min_alignment, dead_zone, limit)
        else:
            q3, f3, h3 = load(raw[i]), load(net_bearing[i]), load(previous[i])
            store(certify_one(q3, f3, h3, min_alignment, dead_zone, limit), out[i])


@inner_kernel(inline="code")
def certify_one(raw, net_bearing, previous, min_alignment, dead_zone, limit):
    """As ``certified_heading``, one robot, pairs or triples; ``limit`` from ``turn_limit``."""
    strength, towards = split(net_bearing)
    if strength == 0.0:
        towards = x_axis(net_bearing)
    cap = _cap(_margin(strength, min_alignment, dead_zone))
    carried = _carry(split(previous), towards, cap)
    return _follow(split(raw), carried, towards, cap, limit)


@inner_kernel(inline="code")
def _margin(strength, min_alignment, dead_zone):
    """ε_i = ε clip(‖f‖/δ − 1, 0, 1) of ``certified_heading``; NO_CAP where f is zero."""
    margin = min_alignment * min(max(strength / dead_zone - 1.0, 0.0), 1.0)
    return margin if strength > 0.0 else NO_CAP


@inner_kernel(inline="code")
def _cap(margin):
    """Parts ε and √(1 − ε²) along and across f of headings on the boundary of the cap.

    For NO_CAP, which no heading is projected to, the second is 0.
    """
    return margin, math.sqrt(max(1.0 - margin * margin, 0.0))


@inner_kernel(inline="code")
def _carry(previous, towards, cap):
    """Previous heading, as ``split``, flipped towards f and projected onto the cap."""
    length, heading = previous
    if length == 0.0:
        return towards
    if cap[0] != NO_CAP and dot(heading, towards) < 0.0:
        heading = scaled(heading, -1.0)
    return _project(heading, towards, cap, towards)


@inner_kernel(inline="code")
def _follow(raw, carried, towards, cap, limit):
    """Turn from the carried heading towards a raw vector, as ``split``, within the cap."""
    length, direction = raw
    aim = _project(direction, towards, cap, carried) if length > 0.0 else carried
    return _project(_turn(carried, aim, towards, limit), towards, cap, towards)


@kernel(inline="code")
def into_cap(direction, towards, margin, otherwise):
    """Nearest unit vector h, a pair or triple, with h·u ≥ ε: ε u + √(1 − ε²) w, w ⟂ u.

    For the direction −u all of the boundary is equally near, and h is ``otherwise``.
    """
    return _project(direction, towards, _cap(margin), otherwise)


@inner_kernel(inline="code")
def _project(direction, towards, cap, otherwise):
    """``into_cap`` for the parts of ``_cap``."""
    margin, rest = cap
    if dot(direction, towards) >= margin:
        return direction
    size, across = split_across(direction, towards)
    if size < _NEARLY_PARALLEL:
        return otherwise
    return combine(margin, towards, rest, across)


@inner_kernel(inline="code")
def _turn(carried, aim, towards, limit):
    """Turn from carried towards aim along the great circle by at most γ of ``turn_limit``.

    h cos γ + t sin γ, with t the unit tangent at h. An antipodal aim is reached via ``towards``.
    """
    cos_limit, sin_limit, square_chord = limit
    gap = combine(1.0, aim, -1.0, carried)
    if dot(gap, gap) <= square_chord:
        return aim
    through = aim
    if split_across(aim, carried)[0] < _NEARLY_ANTIPODAL and dot(aim, carried) < 0.0:
        through = towards
        if split_across(towards, carried)[0] < _NEARLY_ANTIPODAL:
            through = perpendicular(carried)
    return combine(cos_limit, carried, sin_limit, split_across(through, carried)[1])


@inner_kernel(inline="code")
def without_error(along, error):
    """Lower bound sgn(hᵀf) max(0, |hᵀf| − e), a number, m/s, for an error e of f (N1')."""
    return max(along - error, 0.0) + min(along + error, 0.0)


class _Constants(NamedTuple):
    robot: Robot
    speed_scaled: bool  # whether velocities are scaled to the step
    certified: bool
    max_turn: float  # of a heading, rad


@kernel(unroll=False)
def _steer(axes, robots, constants, arrays, work):
    """Actions min(1, r/(2Dτ)) h max(0, hᵀf − e), e = 2 sin(η/2) D (eq. 4, theorems C and N1')."""
    numbers, room, sums = work
    if numbers.shape[1] != LANES:  # always true; tells the compiler the row stride
        return
    observations, held, headings, actions, alignment, lyapunov_rate = arrays
    lanes, robot, limit = lanes_of(numbers), constants.robot, turn_limit(constants.max_turn)
    gate, weighs = robot.gate, constants.speed_scaled or robot.error_chord > 0.0
    lanes.degree[:], lanes.scale[:] = 0.0, 1.0
    for first in range(robots[0], robots[1], LANES):
        stop = min(first + LANES, robots[1])
        rows = observations[first:stop]
        if sums.shape[1] > 0:
            recall_sums(sums, first, stop, lanes)
        elif weighs:
            weigh_rows(axes, rows, robot.neighbour_slots, room, lanes.f, lanes.degree)
        else:
            sum_rows(axes, rows, robot.neighbour_slots, lanes.f)
        take_in(axes, held, first, stop, lanes.choice)
        take_in(axes, headings, first, stop, lanes.heading)
        _split_lanes(axes, lanes)
        if constants.certified:
            _certify_lanes(axes, lanes, gate, limit)
        else:
            for lane in range(LANES):
                write(read(lanes.choice, lane, axes), lanes.heading, lane)
        if constants.speed_scaled:
            for lane in range(LANES):
                degree = lanes.degree[lane]
                lanes.scale[lane] = scale_of_step(degree, robot.merge_radius, gate.duration)
        for lane in range(LANES):
            h, degree = read(lanes.heading, lane, axes), lanes.degree[lane]
            along = dot(h, read(lanes.f, lane, axes))
            sure = without_error(along, robot.error_chord * degree)
            write(scaled(h, sure * lanes.scale[lane]), lanes.sent, lane)
            aligned = abs(dot(h, read(lanes.towards, lane, axes)))
            lanes.alignment[lane] = aligned if lanes.strength[lane] > 0.0 else np.nan
            lanes.lyapunov_rate[lane] = -2.0 * along * sure
        give_out(axes, lanes.heading, first, stop, headings)
        report(axes, lanes, first, stop, actions, alignment, lyapunov_rate)


# Short loops: a long one has more operations that wait for each other than a processor looks ahead.


@inner_kernel(inline="text")
def _split_lanes(axes, lanes):
    """Lengths and directions of f and of choices."""
    for lane in range(LANES):
        f = read(lanes.f, lane, axes)
        strength, towards = split(f)
        if strength == 0.0:
            towards = x_axis(f)
        write(towards, lanes.towards, lane)
        lanes.strength[lane] = strength
    for lane in range(LANES):
        lanes.desired[lane], direction = split(read(lanes.choice, lane, axes))
        write(direction, lanes.choice, lane)


@inner_kernel(inline="text")
def _certify_lanes(axes, lanes, gate, limit):
    """``certify_one`` after ``_split_lanes``."""
    weak = 0
    for lane in range(LANES):
        lanes.carried[lane], heading = split(read(lanes.heading, lane, axes))
        write(heading, lanes.heading, lane)
        weak += lanes.strength[lane] < 2.0 * gate.dead_zone
    lanes.margin[:], lanes.rest[:] = _cap(gate.min_alignment)
    if weak > 0:  # rare: beyond 2δ the minimum alignment is ε
        for lane in range(LANES):
            margin = _margin(lanes.strength[lane], gate.min_alignment, gate.dead_zone)
            lanes.margin[lane], lanes.rest[lane] = _cap(margin)
    for lane in range(LANES):
        towards, cap = read(lanes.towards, lane, axes), (lanes.margin[lane], lanes.rest[lane])
        previous = lanes.carried[lane], read(lanes.heading, lane, axes)
        write(_carry(previous, towards, cap), lanes.heading, lane)
    for lane in range(LANES):
        towards, cap = read(lanes.towards, lane, axes), (lanes.margin[lane], lanes.rest[lane])
        raw = lanes.desired[lane], read(lanes.choice, lane, axes)
        carried = read(lanes.heading, lane, axes)
        write(_follow(raw, carried, towards, cap, limit), lanes.heading, lane)


@kernel(unroll=False)
def _turn_bodies(axes, robots, constants, arrays, work):
    """Gated turn rates, and speed v = s mᵀf along the mean body axis m, minus e (theory 4)."""
    observations, held, _, actions, alignment, lyapunov_rate = arrays
    robot, gate = constants.robot, constants.robot.gate
    duration = gate.duration if constants.speed_scaled else 0.0  # of 0 the scale is 1
    for i in range(robots[0], robots[1]):
        rows, action = observations[i], actions[i]
        action[:] = 0.0
        alignment[i], lyapunov_rate[i] = np.nan, 0.0
        degree = degree_of(rows, robot.neighbour_slots)
        if degree == 0.0:
            continue
        f = net_bearing_of(rows, robot.neighbour_slots)
        pitch = pitch_of(rows, robot.gravity_row, gate)
        rates = desired_rates(held[i], gate)
        if constants.certified:
            rates = gated_rates(rates, f, pitch, gate)
        along = dot(turn(rates, pitch, action, gate), f)
        sure = without_error(along, robot.error_chord * degree)
        action[0] = scale_of_step(degree, robot.merge_radius, duration) * sure
        strength, _ = split(f)
        if strength > 0.0:
            alignment[i] = abs(f[0]) / strength
        lyapunov_rate[i] = -2.0 * along * sure


@kernel
def _steer_or_turn(axes, robots, constants, arrays, work):
    """``_steer`` of holonomic robots, ``_turn_bodies`` of nonholonomic ones."""
    observations, held, headings, actions, alignment, lyapunov_rate, turning = arrays
    rates = held[:, : len(axes) - 1]
    first = robots[0]
    while first < robots[1]:
        run = first, end_of_run(turning, first, robots[1])
        if turning[first]:
            given = observations, rates, headings, actions, alignment, lyapunov_rate
            _turn_bodies(axes, run, constants, given, work)
        else:
            own = observations, held, headings, actions, alignment, lyapunov_rate
            _steer(axes, run, constants, own, work)
        first = run[1]


class HeadingFilter(SafetyFilter):
    """Heading filter of B environments (theorem C).

    Args:
        scenario, num_envs, frame, num_threads: as ``SafetyFilter``.
        min_alignment: ε, at least 10⁻⁶ and less than 1.
        max_turn_rate: of a heading or a body axis, rad/s; the scenario's limit also applies.
        certified: False uses the raw vector in law (4) without margin or gate.
        bearing_error: η, rad; speeds are reduced by the maximum effect of errors (theorem N1').
    """

    state_key = "steering"
    reuses_calls = True

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        min_alignment: float = 0.1,
        max_turn_rate: float = MAX_TURN_RATE,
        frame: str = "net_bearing",
        certified: bool = True,
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        check_inputs(scenario, "law (4)", bodies=True)
        turning = scenario.nonholonomic_robots
        turns_body, size = bool(turning.any()), scenario.dim
        if turning.all():
            size = max(model.n_angles for model in scenario.models)
        super().__init__(scenario, num_envs, size, frame, num_threads)
        most = positive("max_turn_rate", max_turn_rate, "rad/s")
        robot = robot_of(scenario, check_margin(min_alignment), bearing_error, most)
        certified = flag("certified", certified)
        if robot.error_chord > 0.0 and not certified:
            raise_invalid(
                "bearing_error", bearing_error, "0 with certified=False, which gives no guarantee"
            )
        given = None if scenario.max_turn_rate is None else scenario.min_turn_limit
        self._heading_rate = most if given is None else min(most, given)
        scaled_speed = certified and (turns_body or scenario.tau > scenario.certified_step)
        max_turn = self._heading_rate * scenario.tau
        self._make_sums(weighs=scaled_speed or robot.error_chord > 0.0)
        self._constants = _Constants(robot, scaled_speed, certified, max_turn)
        self.carried = np.zeros((num_envs, scenario.n_robots, scenario.dim))
        """Headings h_i, (B, n, d), in the robots' frames; zero if none yet."""

    @cached_property
    def choice_mask(self) -> NDArray[np.bool_]:
        """As ``SafetyFilter.choice_mask``: vectors have d numbers, turn rates d − 1."""
        mask = np.ones((self.scenario.n_robots, self.action_size), np.bool_)
        if self.mixes_models:
            mask[self.scenario.nonholonomic_robots, -1] = False
        return mask

    @property
    def headings(self) -> NDArray[np.float64]:
        """Copy of ``carried``."""
        return self.carried.copy()

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"headings": self.carried, **super()._memory}

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``SafetyFilter.apply_calls``."""
        act, constants = _turn_bodies if self.turns_body else _steer, self._constants
        mixed: tuple[NDArray[Any], ...] = ()
        if self.mixes_models:
            act, mixed = _steer_or_turn, (self._turning,)
        if elapsed is not None:
            constants = constants._replace(max_turn=self._heading_rate * float(elapsed))
        memory, told = (self._held, self.carried), (self.alignment, self.lyapunov_rate)
        given, sums = (act, part, constants, observations), self._sums_of(observations)
        return over_robots(*given, *memory, actions, *told, *mixed, sums=sums)


register_filter("heading", HeadingFilter)
