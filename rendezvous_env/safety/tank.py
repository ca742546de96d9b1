"""Theorem D: any motion while a robot's energy tank lasts, else law (4), which fills it.

docs/guarantees.md, section 8. Each robot keeps this account alone, from its own bearings. Vectors
are triples in one frame; a vector of the plane has z = 0 and keeps it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import bools, flag, number, refuse
from ..compilation import inner_kernel, kernel
from ..engine.state_checks import check_observations
from ..engine.threads import each_block
from ..physics.rows import degree_of, net_bearing_of
from ..physics.vectors import combine, dot, load, norm, scaled, split, store
from ..robots.single_integrator import speed_scale
from ..robots.unicycle import clip
from ..scenario.scenario import Scenario
from .heading import into_cap, scale_of_step
from .safety_filter import (
    SafetyFilter,
    check_steerable,
    over_teams,
    register_filter,
    teams_of_block,
)
from .settings import check_bearing_error, check_gate_constants, error_chord
from .turning import gated_rate_2d, gated_rates_3d, mean_axis_2d, mean_axis_3d


@kernel
def descent_scale(strength, degree, merge_radius, duration, speed_limit):
    """Factor s on f with which a step is sure to let V fall, and no faster than the robot may go.

        s = min(1, r/(2 D τ), v_max/‖f‖)                            (theorem D)

    Args:
        strength: ‖f‖, m/s.
        degree: D, the summed lengths of the neighbour rows, positive, m/s.
        merge_radius: r, m.
        duration: τ, s.
        speed_limit: v_max, m/s.

    Returns:
        s, a number in (0, 1], without unit.
    """
    unhurried = speed_limit / max(strength, speed_limit)
    return min(scale_of_step(degree, merge_radius, duration), unhurried)


@kernel
def certain_descent(net_bearing, degree, displacement, merge_radius, error=0.0):
    """This robot's part in what V is sure to fall by; negative where V may rise.

        2 f·Δ − (2/r) D ‖Δ‖² − 2 e ‖Δ‖                              (theorem D)

    Summed over the robots this bounds V(t) − V(t + τ) while neighbours stay at least r apart.

    Args:
        net_bearing: f, a triple, m/s.
        degree: D, m/s.
        displacement: Δ over the step, a triple, m.
        merge_radius: r, m.
        error: e, m/s: f is wrong by no more.

    Returns:
        A number, m²/s.
    """
    spent = 2.0 / merge_radius * degree * dot(displacement, displacement)
    sure = 2.0 * dot(net_bearing, displacement) - spent
    return sure - 2.0 * error * norm(displacement) if error > 0.0 else sure


@kernel
def promised_descent(strength, scale, min_alignment, duration, error=0.0):
    """What a robot owes in every step, so that all meet in finite time (theorem D).

        ε² τ s ‖f‖²,   with errors   τ s max(0, ε ‖f‖ − e)²

    Args:
        strength: ‖f‖, m/s.
        scale: s, without unit.
        min_alignment: ε, without unit.
        duration: τ, s.
        error: e, m/s.

    Returns:
        A number, m²/s.
    """
    if error > 0.0:
        sure = max(min_alignment * strength - error, 0.0)
        return duration * scale * sure * sure
    return min_alignment * min_alignment * duration * scale * strength * strength


@kernel
def descending_velocity(wanted, net_bearing, scale, min_alignment, error=0.0):
    """Law (4) along the wanted line, which earns at least what is owed.

        v = s h hᵀf,   h the wanted direction projected onto the cap |hᵀf| ≥ ε‖f‖    (theorem D)
        v = s max(0, hᵀf − e) h                                     with errors (theorem N1')

    The direction is f/‖f‖ where nothing is wanted.

    Args:
        wanted: a triple, of any length and unit.
        net_bearing: f, a triple, not zero, m/s.
        scale: s, without unit.
        min_alignment: ε, without unit.
        error: e, m/s.

    Returns:
        v, a triple, m/s.
    """
    (length, h), (_, towards) = split(wanted), split(net_bearing)
    if length == 0.0:
        h = towards
    elif dot(h, towards) < 0.0:  # h and −h are the same line
        h = combine(-1.0, h, 0.0, h)
    h = into_cap(h, towards, min_alignment, towards)
    along = dot(h, net_bearing)
    if error > 0.0:
        along = max(along - error, 0.0)
    return combine(scale * along, h, 0.0, h)


@kernel
def spend_tanks(share, turns_body, observations, constants, held, levels, actions, told):
    """The actions of the teams that this thread takes, and what is told of them (theorem D).

        carried out if A + G(Δ) ≥ 0,   G(Δ) = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²

    With bearing errors f may be wrong by e = 2 sin(η/2) D: see tank.py for what is charged then.

    Args:
        share: this thread's part, see ``engine.threads``.
        turns_body: whether the robots are nonholonomic.
        observations: (B, n, rows, d), in the robots' own frames; neighbour rows in m/s.
        constants: of the tank, see ``_Constants``.
        held: what is wanted, (B, n, k), as shares of the limits.
        levels: A, (B, n), m²/s.
        actions: (B, n, a) float32, all zero; filled in, m/s and rad/s.
        told: deposits G (m²/s), carried_out, alignment |hᵀf|/‖f‖ and lyapunov_rate −2 f·Δ/τ
            (m²/s²), (B, n) each; filled in.
    """
    each_block(
        share, _spend_teams, (turns_body, observations, constants, held, levels, actions, told)
    )


@inner_kernel(inline="text")
def _spend_teams(block, arguments):
    turns_body, observations, constants, held, levels, actions, told = arguments
    first, last = teams_of_block(block, len(observations))
    for team in range(first, last):
        _spend_team(
            turns_body,
            observations[team],
            constants,
            held[team],
            levels[team],
            actions[team],
            (told[0][team], told[1][team], told[2][team], told[3][team]),
        )


@inner_kernel(inline="code")
def _spend_team(turns_body, observations, constants, held, levels, actions, told):
    deposits, carried_out, alignment, lyapunov_rate = told
    for i in range(len(observations)):
        rows = observations[i]
        f = net_bearing_of(rows, constants.neighbour_slots)
        degree = degree_of(rows, constants.neighbour_slots)
        strength, _ = split(f)
        deposits[i], carried_out[i], alignment[i], lyapunov_rate[i] = 0.0, False, np.nan, 0.0
        if degree == 0.0:
            continue
        if turns_body:
            carried_out[i], deposits[i], moved = _spend_turning(
                rows, f, strength, degree, constants, held[i], levels[i], actions[i]
            )
            ahead = f[0]
        else:
            carried_out[i], deposits[i], moved = _spend_going(
                f, strength, degree, constants, held[i], levels[i], actions[i]
            )
            length, direction = split(moved)
            ahead = dot(direction, f) if length > 0.0 else np.nan
        if strength > 0.0:
            alignment[i] = abs(ahead) / strength
        lyapunov_rate[i] = -2.0 * dot(f, moved) / constants.duration


@inner_kernel(inline="code")
def _spend_going(f, strength, degree, constants, held, level, action):
    """One robot that goes anywhere: whether its wish is carried out, its deposit, displacement."""
    error = constants.error_chord * degree
    scale = descent_scale(
        strength, degree, constants.merge_radius, constants.duration, constants.speed_limit
    )
    owed = promised_descent(strength, scale, constants.min_alignment, constants.duration, error)
    wanted = scaled(load(held), constants.speed_limit)
    _, within = speed_scale(dot(wanted, wanted), constants.speed_limit)
    moved = _go(scaled(wanted, within), constants, action)
    deposit = certain_descent(f, degree, moved, constants.merge_radius, error) - owed
    carried_out = level + deposit >= 0.0
    if not carried_out:
        moved = _go(
            descending_velocity(wanted, f, scale, constants.min_alignment, error), constants, action
        )
        deposit = certain_descent(f, degree, moved, constants.merge_radius, error) - owed
    return carried_out, deposit, moved


@inner_kernel(inline="code")
def _go(velocity, constants, action):
    """Send a velocity; its displacement as it will be executed, after rounding to float32."""
    store(velocity, action)
    sent = load(action)
    _, within = speed_scale(dot(sent, sent), constants.speed_limit)
    return scaled(sent, constants.duration * within)


@inner_kernel(inline="code")
def _spend_turning(rows, f, strength, degree, constants, held, level, action):
    """One nonholonomic robot, in its body frame; returns as ``_spend_going``."""
    pitch, error = 0.0, constants.error_chord * degree
    if len(held) == 3:
        gravity = load(rows[constants.gravity_row])
        pitch = math.atan2(-gravity[0], -gravity[2])
    action[0] = clip(held[0], 1.0) * constants.speed_limit
    action[1] = clip(held[1], 1.0) * constants.yaw_limit
    if len(held) == 3:
        action[2] = clip(held[2], 1.0) * constants.pitch_limit
    moved = _drive(_mean_axis(action, pitch, constants), constants, action)
    deposit = certain_descent(f, degree, moved, constants.merge_radius, error)
    carried_out = level + deposit >= 0.0
    if not carried_out:
        _gate(f, pitch, constants, action)
        mean_axis = _mean_axis(action, pitch, constants)
        scale = descent_scale(
            strength, degree, constants.merge_radius, constants.duration, constants.speed_limit
        )
        along = dot(mean_axis, f)
        if error > 0.0:
            along = math.copysign(max(abs(along) - error, 0.0), along)
        action[0] = scale * along
        moved = _drive(mean_axis, constants, action)
        deposit = certain_descent(f, degree, moved, constants.merge_radius, error)
    return carried_out, deposit, moved


@kernel
def _gate(f, pitch, constants, action):
    """Replace turn rates that would let a robot stay orthogonal to f, in place."""
    yaw_rate = np.float64(action[1])
    margin, dead_zone = constants.min_alignment, constants.dead_zone
    if len(action) == 2:
        action[1] = gated_rate_2d(
            yaw_rate, f, margin, dead_zone, constants.duration, constants.yaw_limit
        )
        return
    action[1], action[2] = gated_rates_3d(
        (yaw_rate, np.float64(action[2])),
        f,
        pitch,
        margin,
        dead_zone,
        constants.duration,
        (constants.yaw_limit, constants.pitch_limit),
    )


@kernel
def _mean_axis(action, pitch, constants):
    """The mean body axis m over a step with the turn rates of an action, in the body frame."""
    yaw_rate = clip(np.float64(action[1]), constants.yaw_limit)
    if len(action) == 2:
        return mean_axis_2d(yaw_rate, constants.duration)
    pitch_rate = clip(np.float64(action[2]), constants.pitch_limit)
    return mean_axis_3d(yaw_rate, pitch_rate, pitch, constants.duration)


@inner_kernel(inline="code")
def _drive(mean_axis, constants, action):
    """The displacement τ v m (theory 4, arcs) of an action."""
    speed = clip(np.float64(action[0]), constants.speed_limit)
    return scaled(mean_axis, constants.duration * speed)


@kernel
def book_deposits(levels, deposits, contact, merged_into, resting):
    """Bring the levels of B teams up to the end of a step: A ← max(A + G, 0), in place (theorem D).

    A robot that presses against a wall along f would earn without end: in a step with contact only
    a loss is booked. A loss that would empty a tank is rounding. A survivor takes all.

    Args:
        levels: A, (B, n), m²/s.
        deposits: G, (B, n), m²/s; zero afterwards.
        contact: (B, n) bool, whether the robot touched an obstacle.
        merged_into: (B, n), index of the robot that each one is now part of.
        resting: (B,) bool, teams that the step passed by.
    """
    for team in range(len(levels)):
        for i in range(levels.shape[1]):
            deposit = deposits[team, i]
            deposits[team, i] = 0.0
            if resting[team] or (contact[team, i] and deposit > 0.0):
                continue
            levels[team, i] = max(levels[team, i] + deposit, 0.0)
        for i in range(levels.shape[1]):
            survivor = merged_into[team, i]
            if survivor != i:
                levels[team, survivor] += levels[team, i]
                levels[team, i] = 0.0


_LARGEST = float(np.finfo(np.float32).max)
_FULLEST = 1e60
"""Level that no episode can have, m²/s: sums of such levels are still finite."""


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the tank's arguments."""

    neighbour_slots: int
    gravity_row: int
    merge_radius: float
    duration: float
    min_alignment: float
    dead_zone: float
    speed_limit: float
    yaw_limit: float
    pitch_limit: float
    error_chord: float


def unit_of_tanks(scenario: Scenario) -> float:
    """The unit r D̄, m²/s, in which levels are shown: twice the most that a robot can earn in a
    step; 1 without links.
    """
    return float(scenario.merge_radius * scenario.max_degree) or 1.0


class EnergyTank(SafetyFilter):
    """Energy tanks, frames and held wishes of the robots of B teams (theorem D).

        A ← A + G(Δ),   G(Δ) = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²              (guarantees 8)

    A wish is carried out where A + G ≥ 0, else law (4) along it: see tank.py. Nonholonomic robots
    keep the account without the term ε²; with an empty tank they drive with v = s mᵀf, and turn
    through the gate of theory 3. One step is

        tank.hold(wishes); actions = tank.act(observations); …; tank.book(…)

    where G is that of the actions as they are sent, in float32. A policy, which learns of neither
    contacts nor merges, calls ``book()`` bare: then every step books as commanded, and the tank of
    a robot that is gone is lost.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        budget: B_i, the level of every robot's tank at the start of an episode, m²/s.
        min_alignment: ε, in (0, 1).
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        observe_level: whether ``view`` shows one row more, (A/(r D̄), 0, …).
        bearing_error: η, rad: the account stays right while no bearing is wrong by more. A step is
            charged 2 e ‖Δ‖ more, e = 2 sin(η/2) D, and owes τ s max(0, ε‖f‖ − e)² in place of its
            last term. (Section 8 fades ε there; a tank needs no dead zone, and owes more without.)
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    state_key = "tank"
    keeps_ledger = True

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        observe_level: bool = False,
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        check_steerable(scenario)
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.action_size,
            frame=frame,
            num_threads=num_threads,
        )
        check_gate_constants(min_alignment, self._sight.dead_zone)
        self.budget = number("budget", budget, 0.0, unit="m²/s")
        self.observes_level = flag("observe_level", observe_level)
        bounds = [*map(float, scenario.action_bounds), 0.0, 0.0]
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            gravity_row=scenario.observation_layout.gravity.start,
            merge_radius=scenario.merge_radius,
            duration=scenario.tau,
            min_alignment=float(min_alignment),
            dead_zone=self._sight.dead_zone,
            speed_limit=bounds[0],
            yaw_limit=bounds[1],
            pitch_limit=bounds[2],
            error_chord=error_chord(check_bearing_error(bearing_error)),
        )
        team = num_envs, scenario.n_robots
        self._levels = np.full(team, self.budget)
        self._deposits = np.zeros(team)
        self.carried_out = np.zeros(team, dtype=np.bool_)
        self._nobody, self._no_team = np.zeros(team, np.bool_), np.zeros(num_envs, np.bool_)
        self._themselves = np.tile(np.arange(scenario.n_robots), (num_envs, 1))

    @property
    def levels(self) -> NDArray[np.float64]:
        """A, (B, n), m²/s; zero for a robot whose tank a survivor has taken over."""
        return self._levels.copy()

    @property
    def normalised_levels(self) -> NDArray[np.float64]:
        """A/(r D̄), (B, n), see ``unit_of_tanks``."""
        return self._levels / unit_of_tanks(self.scenario)

    @property
    def told(self) -> dict[str, NDArray[Any]]:
        """What there is to tell of the last step, (B, n) each; not copied."""
        return {"tank": self._levels, "carried_out": self.carried_out, **super().told}

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"levels": self._levels, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._levels[which] = self.budget
        self._deposits[which] = 0.0
        self.carried_out[which] = False

    def view(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``SafetyFilter.view``; one row more, (B, n, rows + 1, d), with ``observe_level``."""
        seen = super().view(observations)
        if not self.observes_level:
            return seen
        level = np.zeros_like(seen[..., :1, :])
        level[..., 0, 0] = np.minimum(self.normalised_levels, _LARGEST)
        return np.concatenate([seen, level], axis=-2)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``SafetyFilter.act``; what the step earns waits for ``book``."""
        observations = check_observations(observations, self._seen)
        actions = np.zeros(self._held.shape, dtype=np.float32)
        fixed = (observations, self._constants, self._held, self._levels, actions)
        told = (self._deposits, self.carried_out, self.alignment, self.lyapunov_rate)
        turns = self.turns_body
        over_teams(lambda part: spend_tanks(part, turns, *fixed, told), *self._batch)
        return actions

    def book(
        self,
        contact: ArrayLike | None = None,
        merged_into: ArrayLike | None = None,
        resting: ArrayLike | None = None,
    ) -> None:
        """Bring the levels up to the end of the step; arguments as ``SafetyFilter.book``.

        In a step with contact a robot books min(0, G); who merges hands its tank to the survivor; a
        step that a merge cuts short books as commanded.
        """
        team, survivors = self._levels.shape, self._themselves
        touched, passed = self._nobody, self._no_team
        if contact is not None:
            touched = np.ascontiguousarray(bools("contact", contact, team, "robots"))
        if resting is not None:
            passed = np.ascontiguousarray(bools("resting", resting, team[:1], "teams"))
        if merged_into is not None:
            survivors = _robots("merged_into", merged_into, team)
        book_deposits(self._levels, self._deposits, touched, survivors, passed)

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """As ``SafetyFilter.check_state``; no level is below zero.

        Raises:
            ValueError: naming what does not fit.
        """
        checked = super().check_state(state)
        if (wrong := (checked["levels"] < 0) | (checked["levels"] > _FULLEST)).any():
            team, robot = np.argwhere(wrong)[0].tolist()
            raise ValueError(
                f"state: levels of robot_{robot} in team {team} is "
                f"{checked['levels'][team, robot]}; it must be from 0 to {_FULLEST:g} m²/s"
            )
        return checked


register_filter("tank", EnergyTank)


def _robots(name: str, value: Any, team: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices (B, n) of robots that there are.

    Raises:
        ValueError: for another shape or type, or an index out of range.
    """
    robots = np.asarray(value)
    if robots.shape != team or robots.dtype.kind not in "iu":
        refuse(name, value, f"whole numbers of shape (B, n) = {team}")
    if robots.min() < 0 or robots.max() >= team[1]:
        refuse(name, value, f"indices of robots, from 0 to {team[1] - 1}")
    return np.ascontiguousarray(robots, dtype=np.int64)
