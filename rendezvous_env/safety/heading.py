"""Theorem C: any raw vector becomes a certified heading, which law (4) moves a robot along.

docs/theory.md, section 3. The turn rates of nonholonomic robots are in ``turning.py``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import flag, positive, real, refuse, shown
from ..compilation import inner_kernel, kernel
from ..engine.state_checks import check_observations
from ..engine.threads import each_block
from ..physics.rows import degree_of, net_bearing_of
from ..physics.vectors import X_AXIS, combine, dot, load, split, store, without
from ..scenario.scenario import Scenario
from .safety_filter import (
    SafetyFilter,
    check_steerable,
    over_teams,
    register_filter,
    teams_of_block,
)
from .settings import check_bearing_error, check_gate_constants, check_vectors, error_chord
from .turning import gate_2d, gate_3d, mean_body_axis_2d, mean_body_axis_3d

NO_CAP = -2.0
"""A margin that every heading keeps."""
_NEARLY_PARALLEL = 1e-9
_NEARLY_ANTIPODAL = 1e-6


def flexible_velocity(
    net_bearing: NDArray[np.float64], headings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Velocity of the flexible bearing-only law: the net bearing projected onto the heading.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                              (Zhao & Zheng, eq. 4)

    Args:
        net_bearing: fᵢ = Σⱼ aᵢⱼ gᵢⱼ, (..., d), m/s, in the robot's own frame.
        headings: hᵢ, (..., d), unit vectors in the same frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    f, h = net_bearing, headings
    return h * np.sum(h * f, axis=-1, keepdims=True)


def step_scale(row_lengths_sum: Any, merge_radius: float, duration: float) -> Any:
    """Factor on a robot's velocity with which V cannot rise within a long step.

        min(1, r/(2 Dᵢ τ))                                          (theory 4)

    Args:
        row_lengths_sum: Dᵢ = Σⱼ aᵢⱼ, the summed lengths of the neighbour rows, a number or an array
            of any shape, m/s.
        merge_radius: r, m.
        duration: τ, s.

    Returns:
        Factors in (0, 1], of the same shape; 1 where Dᵢ = 0.
    """
    return merge_radius / np.maximum(2.0 * duration * row_lengths_sum, merge_radius)


scale_of_step = kernel(step_scale)
"""``step_scale`` of a number, for kernels."""


@kernel
def turn_limit(max_turn):
    """A largest turn γ as ``certify_one`` wants it: cos γ, sin γ, squared chord 4 sin²(γ/2).

    Args:
        max_turn: γ, rad; π or more is no limit.

    Returns:
        Three numbers without unit; the chord is inf where there is no limit.
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
    """The heading nearest in spirit to a raw vector with which law (4) is certain to meet.

        Cᵢ = {h : ‖h‖ = 1, hᵀfᵢ ≥ εᵢ ‖fᵢ‖},   εᵢ = ε clip(‖fᵢ‖/δ − 1, 0, 1)    (theorem C)

    1. Carry: the previous heading, flipped if hᵀfᵢ < 0, is projected onto the cap Cᵢ.
    2. Aim: the raw vector is projected onto the cap without flipping. A zero raw vector, or one
       along −fᵢ where that is outside the cap, aims at the carried heading.
    3. Turn from carried towards aim along the great circle, through fᵢ if they are antipodal, by at
       most ``max_turn``.

    Where fᵢ = 0 every heading is allowed, nothing is flipped, and antipodal headings turn
    counter-clockwise in the local xy plane.

    Args:
        raw: any vectors, (..., d), d = 2 or 3, of any unit; only the direction counts.
        net_bearing: fᵢ, (..., d), m/s, in the same frame.
        previous: the headings of the step before, (..., d), in the same frame; zero = none yet:
            fᵢ/‖fᵢ‖ is carried then, or the local x axis where fᵢ = 0.
        min_alignment: ε, in (0, 1).
        dead_zone: δ = a*/(2n), m/s.
        max_turn: ω_max τ, rad; π or more (inf too) is no limit.

    Returns:
        Headings hᵢ, (..., d), unit vectors.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, dead_zone)
    if not real(max_turn) > 0:
        raise ValueError(f"max_turn is {shown(max_turn)}; it must be positive (rad)")
    f = check_vectors("net_bearing", net_bearing)
    q = check_vectors("raw", raw, like=f)
    h = check_vectors("previous", previous, like=f)
    out = np.empty_like(f)
    d = f.shape[-1]
    flat = (q.reshape(-1, d), f.reshape(-1, d), h.reshape(-1, d))
    turn = real(max_turn) if real(max_turn) < math.pi else math.inf
    certify(*flat, float(min_alignment), float(dead_zone), turn, out.reshape(-1, d))
    return out


# One implementation for the plane and for space: a vector of the plane has z = 0 and keeps it.


@kernel
def certify(raw, net_bearing, previous, min_alignment, dead_zone, max_turn, out):
    """``certified_heading`` for N robots, unchecked: hᵀf ≥ ε_i ‖f‖ (theorem C).

    Args:
        raw: (N, d), of any unit, float64 like all of these arrays.
        net_bearing: f, (N, d), m/s.
        previous: (N, d), unit vectors or zero.
        min_alignment: ε.
        dead_zone: δ, m/s.
        max_turn: rad; inf is no limit.
        out: (N, d), for unit vectors; may be ``previous`` itself.
    """
    limit = turn_limit(max_turn)
    for i in range(out.shape[0]):
        q, f, h = load(raw[i]), load(net_bearing[i]), load(previous[i])
        x, y, z = certify_one(q, f, h, min_alignment, dead_zone, limit)
        out[i, 0], out[i, 1] = x, y
        if out.shape[1] == 3:
            out[i, 2] = z


@kernel
def certify_one(raw, net_bearing, previous, min_alignment, dead_zone, limit):
    """``certified_heading`` of one robot: hᵀf ≥ ε_i ‖f‖ (theorem C).

    Args:
        raw: a triple, of any unit.
        net_bearing: f, a triple, m/s.
        previous: a unit triple or zero.
        min_alignment: ε.
        dead_zone: δ, m/s.
        limit: from ``turn_limit``.

    Returns:
        h, a unit triple.
    """
    strength, towards = split(net_bearing)
    margin = min_alignment * min(max(strength / dead_zone - 1.0, 0.0), 1.0)
    if strength == 0.0:
        towards, margin = X_AXIS, NO_CAP
    carried = _carry(previous, towards, margin)
    length, direction = split(raw)
    aim = into_cap(direction, towards, margin, carried) if length > 0.0 else carried
    return into_cap(_turn(carried, aim, towards, limit), towards, margin, towards)


@kernel
def _carry(previous, towards, margin):
    """The previous heading as a line: its end that looks along f, projected onto the cap."""
    length, heading = split(previous)
    if length == 0.0:
        return towards
    if margin != NO_CAP and dot(heading, towards) < 0.0:
        heading = combine(-1.0, heading, 0.0, heading)
    return into_cap(heading, towards, margin, towards)


@kernel
def into_cap(direction, towards, margin, otherwise):
    """Nearest unit vector h with h·u ≥ margin: ε u + √(1 − ε²) w, w the part across u.

    Args:
        direction: a unit triple.
        towards: u, the centre of the cap, a unit triple.
        margin: ε, the cosine of the cap's half angle.
        otherwise: what to return where the direction is −u, all of the edge being equally near.

    Returns:
        h, a unit triple.
    """
    if dot(direction, towards) >= margin:
        return direction
    size, across = split(without(direction, towards))
    if size < _NEARLY_PARALLEL:
        return otherwise
    return combine(margin, towards, math.sqrt(1.0 - margin * margin), across)


@kernel
def _turn(carried, aim, towards, limit):
    """From carried towards aim along the great circle by at most the angle γ.

        h cos γ + t sin γ,   t the unit tangent at the carried heading h

    Args:
        carried: h, a unit vector.
        aim: a unit vector.
        towards: u, a unit vector; an antipodal aim is reached through it.
        limit: cos γ, sin γ and the square of the chord of γ.
    """
    cos_limit, sin_limit, square_chord = limit
    gap = combine(1.0, aim, -1.0, carried)
    if dot(gap, gap) <= square_chord:
        return aim
    size, tangent = split(without(aim, carried))
    if size < _NEARLY_ANTIPODAL and dot(aim, carried) < 0.0:
        size, tangent = split(without(towards, carried))
        if size < _NEARLY_ANTIPODAL:
            tangent = _any_perpendicular(carried)
    return combine(cos_limit, carried, sin_limit, tangent)


@kernel
def _any_perpendicular(h):
    """A unit vector across h: counter-clockwise in the xy plane; along x if h is vertical."""
    size, perpendicular = split((-h[1], h[0], 0.0))
    return perpendicular if size > _NEARLY_ANTIPODAL else split(without(X_AXIS, h))[1]


@kernel
def steer_headings(
    share, observations, constants, held, headings, actions, alignment, lyapunov_rate
):
    """Law (4) with the certified heading, for the teams that this thread takes.

        v = min(1, r/(2Dτ)) h hᵀ f                                  (eq. 4, theorem C, theory 4)
        v = min(1, r/(2Dτ)) max(0, hᵀf − e) h,   e = 2 sin(η/2) D   with bearing errors (N1')

    Args:
        share: this thread's part, see ``engine.threads``.
        observations: (B, n, rows, d), m/s, in the robots' own frames.
        constants: of the scenario and of the wrapper, see steering.py.
        held: raw vectors, (B, n, d), of any unit.
        headings: h, (B, n, d), unit vectors or zero; brought up to date.
        actions: v, (B, n, d) float32, m/s; filled in.
        alignment: |hᵀf|/‖f‖, (B, n); filled in, NaN where f is zero.
        lyapunov_rate: −2 (hᵀf)², (B, n), m²/s²; filled in. With errors −2 hᵀf max(0, hᵀf − e).
    """
    arguments = observations, constants, held, headings, actions, alignment, lyapunov_rate
    each_block(share, _steer_teams, arguments)


@inner_kernel(inline="text")
def _steer_teams(block, arguments):
    observations, constants, held, headings, actions, alignment, lyapunov_rate = arguments
    first, last = teams_of_block(block, len(observations))
    limit = turn_limit(constants.max_turn)
    for team in range(first, last):
        for i in range(observations.shape[1]):
            f = net_bearing_of(observations[team, i], constants.neighbour_slots)
            degree = degree_of(observations[team, i], constants.neighbour_slots)
            raw, scale = load(held[team, i]), 1.0
            if constants.certified:
                h = certify_one(
                    raw,
                    f,
                    load(headings[team, i]),
                    constants.min_alignment,
                    constants.dead_zone,
                    limit,
                )
                if constants.long_step:
                    scale = scale_of_step(degree, constants.merge_radius, constants.duration)
            else:
                _, h = split(raw)
            along = dot(h, f)
            sure = along
            if constants.error_chord > 0.0:
                sure = max(along - constants.error_chord * degree, 0.0)
            store(h, headings[team, i])
            store(combine(sure * scale, h, 0.0, h), actions[team, i])
            strength, _ = split(f)
            alignment[team, i] = abs(along) / strength if strength > 0.0 else np.nan
            lyapunov_rate[team, i] = -2.0 * along * sure


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the wrapper's arguments."""

    neighbour_slots: int
    merge_radius: float
    duration: float
    min_alignment: float
    dead_zone: float
    max_turn: float
    certified: bool
    long_step: bool
    error_chord: float


class HeadingFilter(SafetyFilter):
    """Headings, frames and held raw vectors of the robots of B teams.

    Args:
        scenario: whose robots are steered.
        num_envs: B.
        min_alignment: ε, in (0, 1).
        max_turn_rate: of a heading or of a body axis, rad/s; the scenario's limit holds too.
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        certified: False lets the raw vector through: law (4) bare, without margin or gate.
        bearing_error: η, rad: a robot goes slower by what bearings that are wrong by no more than
            that could feign (theorem N1').
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    state_key = "steering"

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        certified: bool = True,
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        turns_body = scenario.model.nonholonomic
        check_steerable(scenario)
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.model.n_angles if turns_body else scenario.dim,
            frame=frame,
            num_threads=num_threads,
        )
        check_gate_constants(min_alignment, self._sight.dead_zone)
        max_turn_rate = positive("max_turn_rate", max_turn_rate, "rad/s")
        flag("certified", certified)
        bearing_error = check_bearing_error(bearing_error)
        if bearing_error > 0.0 and not certified:
            refuse("bearing_error", bearing_error, "0 with certified=False: nothing is promised")
        self._limits = self._turn_limits(max_turn_rate)
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            merge_radius=scenario.merge_radius,
            duration=scenario.tau,
            min_alignment=float(min_alignment),
            dead_zone=self._sight.dead_zone,
            max_turn=float(self._limits[0]) * scenario.tau,
            certified=bool(certified),
            long_step=scenario.tau > scenario.certified_step,
            error_chord=error_chord(bearing_error),
        )
        self._headings = np.zeros((num_envs, scenario.n_robots, scenario.dim))

    def _turn_limits(self, max_turn_rate: float) -> NDArray[np.float64]:
        """Limit of each turn rate, rad/s: the smaller of the wrapper's and the scenario's."""
        if self.turns_body:
            return np.minimum(max_turn_rate, self.scenario.action_bounds[1:])
        given = self.scenario.max_turn_rate
        return np.array([max_turn_rate if given is None else min(max_turn_rate, given)])

    @property
    def headings(self) -> NDArray[np.float64]:
        """h_i, (B, n, d), in the robots' own frames; zero for a robot that has none yet."""
        return self._headings.copy()

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"headings": self._headings, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._headings[which] = 0.0

    def act(
        self, observations: NDArray[np.float32], elapsed: float | None = None
    ) -> NDArray[np.float32]:
        """Actions for the base environment; sets ``alignment`` and ``lyapunov_rate``.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.
            elapsed: s since the actions before, in which a heading may have turned; None is τ.
                Bodies turn for τ from now on, whatever it is.

        Returns:
            (B, n, a) float32; zero for robots that see no neighbour.

        Raises:
            ValueError: for observations of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        shape = (*self._held.shape[:2], self.scenario.action_size)
        actions = np.zeros(shape, dtype=np.float32)
        if self.turns_body:
            self._turn_bodies(observations, actions)
            return actions

        constants = self._constants
        if elapsed is not None:
            constants = constants._replace(max_turn=float(self._limits[0]) * elapsed)
        fixed = (observations, constants, self._held, self._headings)
        given = (actions, self.alignment, self.lyapunov_rate)
        over_teams(lambda part: steer_headings(part, *fixed, *given), *self._batch)
        return actions

    def _turn_bodies(self, observations: NDArray[np.float32], actions: NDArray[np.float32]) -> None:
        """Gated turn rates, and the speed v = mᵀf for the mean body axis m (theory 4, arcs).

        With bearing errors it is less by e, so that V falls whatever f is.
        """
        constants, scenario = self._constants, self.scenario
        seen = scenario.observation_layout.split(observations)
        f = scenario.observation_layout.net_bearing(observations)
        degree = scenario.observation_layout.degree(observations)
        rates = np.clip(self._held, -1.0, 1.0) * self._limits
        pitch = np.zeros(f.shape[:-1])
        if seen.gravity is not None:
            pitch = np.arctan2(-seen.gravity[..., 0], -seen.gravity[..., 2]).astype(np.float64)
        if constants.certified:
            self._gate(f, pitch, rates)
        rates = rates.astype(np.float32).astype(np.float64)  # m is that of the rate executed
        if scenario.dim == 2:
            mean_axis = mean_body_axis_2d(rates[..., 0], constants.duration)
        else:
            mean_axis = mean_body_axis_3d(rates[..., 0], rates[..., 1], pitch, constants.duration)
        along = np.sum(mean_axis * f, axis=-1)
        scale = step_scale(degree, constants.merge_radius, constants.duration)
        alone = degree == 0
        sure = along
        if constants.error_chord > 0.0:
            sure = np.copysign(np.maximum(abs(along) - constants.error_chord * degree, 0.0), along)
        actions[..., 0] = np.where(alone, 0.0, sure * (scale if constants.certified else 1.0))
        actions[..., 1:] = np.where(alone[..., None], 0.0, rates)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.alignment[...] = np.abs(f[..., 0]) / np.linalg.norm(f, axis=-1)
        self.lyapunov_rate[...] = -2.0 * along * sure

    def _gate(
        self, f: NDArray[np.float64], pitch: NDArray[np.float64], rates: NDArray[np.float64]
    ) -> None:
        """Replace turn rates that would let a robot stay orthogonal to f, in place."""
        d, constants = f.shape[-1], self._constants
        margins = (constants.min_alignment, constants.dead_zone, constants.duration)
        flat, gated = rates.reshape(-1, d - 1), np.empty((rates.size // (d - 1), d - 1))
        if d == 2:
            gate_2d(flat, f.reshape(-1, d), *margins, self._limits, gated)
        else:
            gate_3d(flat, f.reshape(-1, d), pitch.reshape(-1), *margins, self._limits, gated)
        rates[...] = gated.reshape(rates.shape)


register_filter("heading", HeadingFilter)
