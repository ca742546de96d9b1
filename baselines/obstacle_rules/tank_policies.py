"""The joined rule under an energy tank (theorem D): round walls, on one side, turning back when it
costs too much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import between, number, positive
from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    load,
    norm,
    scaled,
    split,
    store,
)
from rendezvous_env.safety.tank import (
    EnergyTank,
    certain_descent,
    descent_scale,
    promised_descent,
)
from rendezvous_env.safety.turning import Gate, gate_of, mean_axis

from ..policy import Policy, RememberingPolicy, among_obstacles, register
from ..steering import ALIGNED, Steering, inputs_towards
from .merged_silhouettes_2d import TWO_PI, joined_interval_2d
from .obstacle_avoidance import Array, check_clearance
from .planes_in_space import kept_azimuth, widened_rays
from .turning_robots import axis_is_clear, in_the_plane_or_turning

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

SIDE, HEADING_X, HEADING_Y, WORK, PATIENCE, SHORT = range(6)
MEMORY = 6
"""Numbers in a robot's memory: the side on which it passes what blocks f (1 counter-clockwise, −1
clockwise, 0 nothing blocks f); its heading; ∫ f·v dt since it met the wall, m²/s; over ‖f‖ how far
that may fall before it turns back, m; whether its tank was too low for the step before."""
HEADING, ASIDE = MEMORY, MEMORY + 3
MEMORY_IN_SPACE = MEMORY + 6
"""In space that heading is counted in a plane that holds f; its heading in its own frame follows,
and the unit vector across f of that plane."""

_JUMP = 1.5
"""rad; an edge so far from the heading is another wall's."""
_LOST = 2.4
"""rad; farther round than this no wall is felt for."""
_BEHIND_EDGE = 0.9
"""Of the clearance: how far beside the heading the wall is felt for."""
_LARGEST_PATIENCE = 1e3
"""m."""
_TOIL = 0.15
"""Share of ‖f‖ times its way that a unicycle counts as lost: two that go round one thing on one
side, ever opposite, would else never turn back."""
_ROUNDING = 1e-6
"""m²/s; what a tank must have left, as actions are sent in float32."""
_REST_TIME = 30.0
"""For so long must the tank last at rest after any step that costs something, s."""


class Settings(NamedTuple):
    """What wall followers share."""

    clearance: float
    """Angle by which to stay clear of an edge, rad; in space within the plane, and across it."""
    patience: float
    """How far back a first try may lead, m; each turn doubles it."""
    min_alignment: float
    """ε of the tank."""
    merge_radius: float
    """r, m."""
    duration: float
    """τ, s."""
    speed_limit: float
    """v_max, m/s."""
    turns: bool
    """Whether robots are unicycles."""
    gate: Gate
    """Step and turn limit of a unicycle."""


@dataclass
class TankJoinedPolicy(RememberingPolicy):
    """The joined rule under an energy tank: round walls, away from f too while the tank lasts.

    What blocks f is passed on one side, along the wall, until f is free; in space at one azimuth,
    the one with least to turn (``planes_in_space``). The robot turns back when it has lost more
    than ``patience``‖f‖ of its own work ∫ f·v dt since it met the wall, twice as much after each
    turn, or when its tank is low; so it tries both sides ever farther, in space then those across
    them. Where the tank would not last it rests instead of pressing against a wall.

    A unicycle turns into that direction, drives where its axis points past all silhouettes, and
    does not change its mind while it turns on the spot. Some of its way counts as lost, so that two
    do not go round one thing for ever. Its tank owes nothing: it may always rest.

    It books what it commanded, knows neither contacts nor steps that a merge cut short, and what an
    absorbed robot had left is lost.
    """

    scenario: Scenario
    """Whose robots it steers."""
    budget: float = 50.0
    """B of each robot, m²/s."""
    margin: float = 0.05
    """ε of the tank, in (0, 1)."""
    clearance: float = 0.2
    """Angle by which to stay clear of an edge, rad."""
    patience: float = 1.0
    """How far from f a first try may lead, m."""

    def __post_init__(self) -> None:
        number("budget", self.budget, 0.0, unit="m²/s")
        between("min_alignment", self.margin, 0, 1)
        check_clearance(self.clearance)
        positive("patience", self.patience, "m")
        scenario = self.scenario
        steering = self._steering = Steering(scenario)
        self._unit = np.array(scenario.action_bounds if steering.turns else scenario.speed_limit)
        self._settings = Settings(
            clearance=float(self.clearance) / (scenario.dim - 1),
            patience=float(self.patience),
            min_alignment=0.0 if steering.turns else float(self.margin),  # guarantees 8
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
            turns=steering.turns,
            gate=gate_of(scenario, 0.0, 0.0),
        )

    def _start(self, teams: int) -> None:
        scenario, margin = self.scenario, self.margin
        self._tank = EnergyTank(
            scenario, teams, budget=self.budget, min_alignment=margin, frame="local"
        )
        size = MEMORY if scenario.dim == 2 else MEMORY_IN_SPACE
        self._memory = np.zeros((teams, scenario.n_robots, size))
        self._memory[..., PATIENCE] = self.patience

    def _forget(self, which: NDArray[np.bool_]) -> None:
        self._tank.forget(which)
        self._memory[which] = 0.0
        self._memory[which, :, PATIENCE] = self.patience

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``."""
        seen, layout = self._teams_of(observations), self.scenario.observation_layout
        f, robots = layout.net_bearing(seen), seen.shape[0] * seen.shape[1]
        follow = wall_following_velocities if layout.dim == 2 else wall_following_velocities_3d
        silhouettes = np.ascontiguousarray(layout.split(seen).obstacles)
        desired = np.zeros((robots, layout.dim))
        follow(
            f.reshape(robots, layout.dim),
            layout.degree(seen).reshape(robots),
            silhouettes.reshape(robots, *silhouettes.shape[2:]),
            self._tank.levels.reshape(robots),
            self._settings,
            self._memory.reshape(robots, self._memory.shape[-1]),
            desired,
        )
        self._tank.hold(desired.reshape(f.shape) / self._unit)
        actions = self._tank.act(seen)
        self._tank.book()
        velocities = self._steering.velocities(actions, seen)
        self._memory[..., WORK] += self.scenario.tau * np.sum(f * velocities, axis=-1)
        if self._steering.turns:
            toil = np.linalg.norm(f, axis=-1) * np.linalg.norm(velocities, axis=-1)
            self._memory[..., WORK] -= _TOIL * self.scenario.tau * toil
            heading = self._memory[..., HEADING_X : HEADING_Y + 1]
            heading[:] = self._steering.turned(heading, actions, seen)
        return self._as_given(actions)

    @property
    def levels(self) -> Array:
        """A, (..., n), m²/s; without an episode there are none."""
        return np.zeros(0) if self._leading is None else self._as_given(self._tank.levels)


def _fits(scenario: Scenario) -> bool:
    return among_obstacles(scenario) or in_the_plane_or_turning(scenario)


@register("tank-joined", fits=_fits, kind="tank")
def _tank_joined(
    scenario: Scenario,
    budget: float = TankJoinedPolicy.budget,
    min_alignment: float = TankJoinedPolicy.margin,
    clearance: float = TankJoinedPolicy.clearance,
    patience: float = TankJoinedPolicy.patience,
) -> Policy:
    """Follows walls under an energy tank, the one side or the other, ever farther."""
    return TankJoinedPolicy(scenario, budget, min_alignment, clearance, patience)


# ---- kernels over robots -------------------------------------------------------------------------


@kernel(allocates=True)
def wall_following_velocities(net_bearing, degrees, silhouettes, levels, settings, memory, out):
    """Desired velocities: along f where nothing blocks it, else along the wall; of unicycles the
    speeds and turn rates with which they follow them.

        vᵢ = sᵢ ‖fᵢ‖ hᵢ                                                            (guarantees 8)

    A robot rests where its tank would not last, and turns back after that.

    Args:
        net_bearing: fᵢ, (N, 2), m/s.
        degrees: Dᵢ, (N,), m/s.
        silhouettes: (N, M, 2, 2), counter-clockwise edge, then clockwise edge.
        levels: Aᵢ, (N,), m²/s.
        settings: a Settings.
        memory: (N, MEMORY), changed.
        out: (N, 2), m/s; or m/s and rad/s.
    """
    intervals = np.empty((silhouettes.shape[1], 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        spent = _is_spent(strength, memory[i]) and not (settings.turns and _looks_aside(memory[i]))
        memory[i, SHORT] = 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        free, turn = _turn(towards, spent, silhouettes[i], settings, memory[i], intervals)
        heading = _turned(towards, turn)
        memory[i, HEADING_X], memory[i, HEADING_Y] = heading[0], heading[1]
        account, plane = (degrees[i], levels[i]), (towards, _left_of(towards))
        if settings.turns:
            store(_inputs(f, account, heading, free, silhouettes[i], settings, memory[i]), out[i])
            continue
        store(_affordable(f, plane, account, heading, free, settings, memory[i]), out[i])


@kernel(allocates=True)
def wall_following_velocities_3d(net_bearing, degrees, silhouettes, levels, settings, memory, out):
    """As ``wall_following_velocities``, in a plane of space: of (N, 3), silhouettes (N, M, 8, 3),
    memory (N, MEMORY_IN_SPACE).
    """
    slots = silhouettes.shape[1]
    rays, cut, intervals = np.empty((slots, 8, 3)), np.empty((slots, 2, 2)), np.empty((slots, 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        spent = _is_spent(strength, memory[i])
        memory[i, SHORT] = 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        seen = widened_rays(silhouettes[i], settings.clearance, rays)
        views, held = (rays[:seen], cut[:seen], intervals[:seen]), memory[i, SIDE]
        before = load(memory[i, ASIDE:])
        aside, kept = kept_azimuth(towards, before, held != 0.0, settings.clearance, views)
        if held != 0.0 and not kept:
            memory[i, SIDE] = held = 1.0
        heading = load(memory[i, HEADING:ASIDE])
        memory[i, HEADING_X], memory[i, HEADING_Y] = dot(heading, towards), dot(heading, aside)
        free, turn = _turn(X_AXIS, spent, views[1], settings, memory[i], views[2])
        heading = combine(math.cos(turn), towards, math.sin(turn), aside)
        account, plane = (degrees[i], levels[i]), (towards, aside)
        store(_affordable(f, plane, account, heading, free, settings, memory[i]), out[i])
        if held < 0.0 < memory[i, SIDE]:  # both azimuths of the plane have been tried
            aside = cross(towards, aside)
        store(heading, memory[i, HEADING:ASIDE])
        store(aside if memory[i, SIDE] != 0.0 else ORIGIN, memory[i, ASIDE:])


@kernel
def _is_spent(strength, memory):
    """Whether a robot turns back: its tank was too low, or it has lost too much of its work."""
    return memory[SHORT] > 0.0 or memory[WORK] < -memory[PATIENCE] * strength


@kernel
def _turn(towards, spent, silhouettes, settings, memory, intervals):
    """Whether any direction is free, and the angle from f to the heading, rad."""
    joined = joined_interval_2d(towards, silhouettes, intervals)
    low, high = joined[0], joined[1]
    clearance = settings.clearance
    if high - low >= TWO_PI:
        return False, 0.0
    if low >= clearance or high <= -clearance:
        if memory[WORK] >= 0.0:
            memory[PATIENCE] = settings.patience
        memory[SIDE] = 0.0
        return True, 0.0
    kept = _kept_angle(towards, memory)
    held = memory[SIDE]
    _choose_side(joined, spent, memory)
    side = memory[SIDE]
    edge, gap = _edge(joined, side)
    if held == side and abs(_wrapped(edge - kept)) > _JUMP:
        edge, gap = _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals)
    return True, edge + side * min(clearance, 0.5 * gap)


@kernel
def _choose_side(joined, spent, memory):
    """Take the nearer edge at first; the other side once work or tank are spent."""
    if memory[SIDE] == 0.0:
        memory[SIDE] = 1.0 if abs(joined[1]) <= abs(joined[0]) else -1.0
        memory[WORK] = 0.0
    elif spent:
        memory[SIDE] = -memory[SIDE]
        memory[PATIENCE] = min(2.0 * memory[PATIENCE], _LARGEST_PATIENCE)


@kernel
def _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals):
    """Edge of the wall beside the heading, rad from f, and the gap beyond; else as given."""
    feeler = kept - side * _BEHIND_EDGE * settings.clearance
    felt = joined_interval_2d(_turned(towards, feeler), silhouettes, intervals)
    if felt[1] - felt[0] >= TWO_PI:
        return edge, gap
    nearest, beyond = _edge(felt, side)
    other, before = _edge(felt, -side)
    if side * other > 0.0:  # nearest is one on the far side: the wall lies before it
        nearest, beyond = other - side * before, before
    if side * nearest < -_LOST:
        return edge, gap
    return feeler + nearest, beyond


@kernel
def _edge(joined, side):
    """The edge of a joined interval on a side, and the free angle beyond it, rad."""
    if side > 0.0:
        return joined[1], joined[3]
    return joined[0], joined[2]


@kernel
def _affordable(f, plane, account, heading, free, settings, memory):
    """The velocity along a heading, or rest where the tank would not last; ``plane`` is f/‖f‖ and a
    unit vector across it, ``account`` D, m/s, and A, m²/s.
    """
    (towards, aside), (degree, level), strength = plane, account, norm(f)
    r, duration = settings.merge_radius, settings.duration
    scale = descent_scale(strength, degree, r, duration, settings.speed_limit)
    speed = scale * strength
    moved = combine(speed * duration, heading, 0.0, heading)
    owed = promised_descent(strength, scale, settings.min_alignment, duration)
    deposit = certain_descent(f, degree, moved, r) - owed
    reserve = owed * _REST_TIME / duration
    if free and (deposit >= 0.0 or level + deposit >= reserve):
        return combine(speed, heading, 0.0, heading)
    memory[SHORT] = 1.0
    if level >= owed:
        return 0.0, 0.0, 0.0
    # law (4) will drive it: then as little as can be, and away from the wall
    turn = math.copysign(math.acos(settings.min_alignment), dot(aside, heading))
    return combine(speed * math.cos(turn), towards, speed * math.sin(turn), aside)


@kernel
def _looks_aside(memory):
    """Whether a unicycle has still to turn on the spot."""
    return abs(math.atan2(memory[HEADING_Y], memory[HEADING_X])) > ALIGNED


@kernel
def _inputs(f, account, heading, free, silhouettes, settings, memory):
    """Speed and turn rate of a unicycle that is to go along a heading: it drives where its axis is
    clear and its tank lasts. ``account`` as for ``_affordable``.
    """
    (degree, level), strength = account, norm(f)
    r, duration = settings.merge_radius, settings.duration
    speed = strength * descent_scale(strength, degree, r, duration, settings.speed_limit)
    speed, rates = inputs_towards(scaled(heading, speed), 0.0, settings.gate)
    moved = scaled(mean_axis(rates, 0.0, settings.gate), speed * duration)
    if not free or level + certain_descent(f, degree, moved, r) < _ROUNDING:
        memory[SHORT] = 1.0 if speed > 0.0 else 0.0
        return 0.0, rates[0], 0.0
    clear = axis_is_clear(rates, silhouettes, settings.gate)
    return speed if clear else 0.0, rates[0], 0.0


@kernel
def _kept_angle(towards, memory):
    """Angle from f to the heading of the step before, rad; 0 if there is none."""
    before = memory[HEADING_X], memory[HEADING_Y], 0.0
    return math.atan2(dot(_left_of(towards), before), dot(towards, before))


@kernel
def _left_of(direction):
    """A direction of the plane a quarter turn on, as a triple."""
    return -direction[1], direction[0], 0.0


@kernel
def _turned(direction, angle):
    """A direction of the plane turned counter-clockwise, as a triple."""
    return combine(math.cos(angle), direction, math.sin(angle), _left_of(direction))


@kernel
def _wrapped(angle):
    """The same angle in [−π, π)."""
    return angle - TWO_PI * math.floor((angle + math.pi) / TWO_PI)
