"""Rule of merged intervals under an energy tank (theorem D): wall following with a cost limit.

In 3-D it applies in a plane that contains f (``planes_in_space``).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import number, positive
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.limits import LARGEST
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    load,
    norm,
    perpendicular,
    rotated,
    scaled,
    split,
    store,
)
from rendezvous_env.safety.settings import check_margin
from rendezvous_env.safety.tank import (
    EnergyTank,
    certain_descent,
    descent_scale,
    promised_descent,
)
from rendezvous_env.safety.turning import Robot, mean_axis, robot_of, send_rates
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask, StatefulPolicy
from ..steering import ALIGNED, ALIGNED_IN_SPACE, Steering, inputs_towards
from .merged_intervals_2d import TWO_PI, axis_is_clear, merged_interval_2d
from .obstacle_avoidance import Array, check_clearance
from .planes_in_space import axis_is_clear_3d, kept_azimuth, widened_rays

SIDE, WORK, PATIENCE, SHORT, HEADING, ASIDE, MEMORY = 0, 1, 2, 3, 4, 7, 10
"""Indices in a robot's memory, and its size.

The side of passing (1 counter-clockwise, −1 clockwise, 0 if f is free). ∫ f·v dt since the robot
reached the wall, m²/s; its maximum decrease before the robot turns back, over ‖f‖, m. Whether the
tank was too low in the previous step; the heading (3); in 3-D the unit vector across f of the kept
plane (3)."""

_JUMP = 1.5  # rad; an edge farther from the heading belongs to another wall
_LOST = 2.4  # rad; maximum angle at which a wall is searched
_BEHIND_EDGE = 0.9  # of the clearance: angle from the heading at which the wall is searched
_LARGEST_PATIENCE = 1e3  # of that of the first attempt
_BUDGET = 250.0  # in units of r max a_ij: 50 m²/s for r = 0.2 m and weights of 1 m/s
_PATIENCE = 5.0  # in units of r
_ROUNDING = 5e-6
"""Reserve of a tank for rounding of actions to float32, in units of r max a_ij."""
_REST_TIME = 30.0  # s for which the tank must last at rest after a step that uses energy
_TOIL = 0.15
"""Fraction of ‖f‖ times path length that counts as lost for nonholonomic robots.

Otherwise two opposite robots could circle one obstacle indefinitely."""


class _Settings(NamedTuple):
    """Parameters of wall following."""

    robot: Robot
    clearance: float  # rad; in space within the plane, and across it
    patience: float  # m against f of a first attempt; each turn doubles it
    aligned: float  # rad; nonholonomic robots drive within this angle of the desired direction
    rounding: float  # m²/s that must remain in a tank


@kernel(allocates=True)
def wall_following_velocities(
    net_bearing, degrees, silhouettes, levels, settings, pitches, memory, out
):
    """Desired velocities: along f where it is free, otherwise along the wall.

        vᵢ = sᵢ ‖fᵢ‖ hᵢ                                                            (guarantees 8)

    For nonholonomic robots the outputs are the speeds and turn rates that follow them. A robot
    rests if its stored energy is too low, and turns back afterwards. Inputs are fᵢ, (N, d), and Dᵢ,
    (N,), m/s, silhouettes (N, M, S, d), Aᵢ, (N,), m²/s, and βᵢ, (N,), rad, of 3-D nonholonomic
    robots. ``memory``, (N, MEMORY), is updated. The output is ``out``, (N, a), m/s, or m/s and
    rad/s.
    """
    dim, slots, robot = net_bearing.shape[1], silhouettes.shape[1], settings.robot
    rays, cut, intervals = np.empty((slots, 8, 3)), np.empty((slots, 2, 2)), np.empty((slots, 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        before = load(memory[i, HEADING : HEADING + dim])
        spent = memory[i, SHORT] > 0.0 or memory[i, WORK] < -memory[i, PATIENCE] * strength
        if robot.turns and before[0] < math.cos(settings.aligned):
            spent = False  # it first turns on the spot
        memory[i, SHORT] = 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        if dim == 2:
            free, turn = _turn(
                towards, before, spent, silhouettes[i], settings, memory[i], intervals
            )
            heading, aside, seen = rotated(towards, turn), perpendicular(towards), 0
            store(heading, memory[i, HEADING:ASIDE])
        else:
            seen = widened_rays(silhouettes[i], settings.clearance, rays)
            views = rays[:seen], cut[:seen], intervals[:seen]
            free, heading, aside = _way_in_space(towards, before, spent, settings, memory[i], views)
        account = degrees[i], levels[i]
        if not robot.turns:
            plane = towards, aside
            store(_affordable(f, plane, account, heading, free, robot, memory[i]), out[i])
            continue
        speed, rates = _inputs(f, account, heading, free, pitches[i], settings, memory[i])
        if dim == 2:
            clear = axis_is_clear(rates, silhouettes[i], robot.gate)
        else:
            clear = axis_is_clear_3d(rates, pitches[i], rays[:seen], robot.gate)
        out[i, 0] = speed if clear else 0.0
        send_rates(rates, out[i], robot.gate)


@inner_kernel
def _way_in_space(towards, before, spent, settings, memory, views):
    """True if any direction is free, the heading, and the unit vector across f of its plane."""
    held, keeps = memory[SIDE], TWO_PI if memory[SIDE] != 0.0 else 0.0
    aside, kept = kept_azimuth(towards, load(memory[ASIDE:]), keeps, settings.clearance, views)
    if held != 0.0 and not kept:
        memory[SIDE] = held = 1.0
    within = dot(before, towards), dot(before, aside), 0.0
    free, turn = _turn(X_AXIS, within, spent, views[1], settings, memory, views[2])
    heading = combine(math.cos(turn), towards, math.sin(turn), aside)
    store(heading, memory[HEADING:ASIDE])
    # the next azimuth after both sides of this plane
    following = cross(towards, aside) if held < 0.0 < memory[SIDE] else aside
    store(following if memory[SIDE] != 0.0 else ORIGIN, memory[ASIDE:])
    return free, heading, aside


@inner_kernel
def _turn(towards, before, spent, silhouettes, settings, memory, intervals):
    """True if any direction is free, and the angle from f to the heading, rad."""
    joined = merged_interval_2d(towards, silhouettes, intervals)
    low, high = joined[0], joined[1]
    clearance, held = settings.clearance, memory[SIDE]
    if high - low >= TWO_PI:
        return False, 0.0
    if low >= clearance or high <= -clearance:
        if memory[WORK] >= 0.0:
            memory[PATIENCE] = settings.patience
        memory[SIDE] = 0.0
        return True, 0.0
    if held == 0.0:  # the nearer edge at first
        memory[SIDE] = 1.0 if abs(high) <= abs(low) else -1.0
        memory[WORK] = 0.0
    elif spent:
        memory[SIDE] = -held
        memory[PATIENCE] = min(2.0 * memory[PATIENCE], _LARGEST_PATIENCE * settings.patience)
    side, kept = memory[SIDE], math.atan2(dot(perpendicular(towards), before), dot(towards, before))
    edge, gap = _edge(joined, side)
    apart = edge - kept
    apart -= TWO_PI * math.floor((apart + math.pi) / TWO_PI)
    if held == side and abs(apart) > _JUMP:
        edge, gap = _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals)
    return True, edge + side * min(clearance, 0.5 * gap)


@inner_kernel
def _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals):
    """Edge of the wall next to the heading, rad from f, and the gap beyond; else the defaults."""
    feeler = kept - side * _BEHIND_EDGE * settings.clearance
    felt = merged_interval_2d(rotated(towards, feeler), silhouettes, intervals)
    if felt[1] - felt[0] >= TWO_PI:
        return edge, gap
    nearest, beyond = _edge(felt, side)
    other, before = _edge(felt, -side)
    if side * other > 0.0:  # the nearest edge is on the far side: the wall is in front of it
        nearest, beyond = other - side * before, before
    if side * nearest < -_LOST:
        return edge, gap
    return feeler + nearest, beyond


@inner_kernel
def _edge(joined, side):
    """Edge of a merged interval on a side, and the free angle beyond it, rad."""
    if side > 0.0:
        return joined[1], joined[3]
    return joined[0], joined[2]


@inner_kernel
def _affordable(f, plane, account, heading, free, robot, memory):
    """Velocity along a heading, or zero if the stored energy is too low.

    ``plane`` is f/‖f‖ and a unit vector across it; ``account`` is D, m/s, and A, m²/s.
    """
    (towards, aside), (degree, level), strength = plane, account, norm(f)
    r, margin, duration = robot.merge_radius, robot.gate.min_alignment, robot.gate.duration
    scale = descent_scale(strength, degree, r, duration, robot.speed_limit)
    speed = scale * strength
    moved = combine(speed * duration, heading, 0.0, heading)
    owed = promised_descent(strength, scale, margin, duration)
    deposit = certain_descent(f, degree, moved, r) - owed
    reserve = owed * _REST_TIME / duration
    if free and (deposit >= 0.0 or level + deposit >= reserve):
        return combine(speed, heading, 0.0, heading)
    memory[SHORT] = 1.0
    if level >= owed:
        return 0.0, 0.0, 0.0
    # law (4) will be executed: choose the slowest motion, away from the wall
    turn = math.copysign(math.acos(margin), dot(aside, heading))
    return combine(speed * math.cos(turn), towards, speed * math.sin(turn), aside)


@inner_kernel
def _inputs(f, account, heading, free, pitch, settings, memory):
    """Speed and turn rates towards a heading; the robot drives only with enough stored energy."""
    (degree, level), strength = account, norm(f)
    robot, gate, r = settings.robot, settings.robot.gate, settings.robot.merge_radius
    speed = strength * descent_scale(strength, degree, r, gate.duration, robot.speed_limit)
    speed, rates = inputs_towards(scaled(heading, speed), pitch, gate, settings.aligned)
    moved = scaled(mean_axis(rates, pitch, gate), speed * gate.duration)
    if not free or level + certain_descent(f, degree, moved, r) < settings.rounding:
        memory[SHORT] = 1.0 if speed > 0.0 else 0.0
        speed = 0.0
    return speed, rates


class TankMergedPolicy(StatefulPolicy):
    """Wall following under an energy tank, on alternating sides with growing distance.

    An obstacle that blocks f is passed on one side, along the wall, until f is free. The path may
    lead away from f while the tank suffices. In 3-D the path has one azimuth, the one with the
    smallest turn (``planes_in_space``).

    The robot turns back when its tank is low, or when ∫ f·v dt since it reached the wall has
    decreased by more than ``patience``‖f‖. This limit doubles after each turn, so the robot
    explores both sides with growing distance, in 3-D then those across them. If the stored energy
    is too low, the robot rests instead of pressing against a wall.

    A nonholonomic robot turns towards that direction and drives where its axis is outside all
    silhouettes. While it turns on the spot, the direction is fixed. A fraction of its path counts
    as lost, which prevents two robots from circling an obstacle indefinitely. Its tank has no
    minimum alignment, so it may always rest.

    Each step counts as commanded, without feedback about contacts or steps shortened by a merge.
    The stored energy of a merged robot is lost.

    Args:
        scenario: the experiment.
        budget: initial energy B of each robot, m²/s; None is 250 r max a_ij, which is 50 in the
            shipped scenarios.
        min_alignment: ε of the tank, at least 10⁻⁶ and less than 1.
        clearance: minimum angle from an edge, rad.
        patience: maximum distance against f of a first attempt, m; None is 5 r, which is 1 in the
            shipped scenarios.
    """

    def __init__(
        self,
        scenario: Scenario,
        budget: float | None = None,
        min_alignment: float = 0.05,
        clearance: float = 0.2,
        patience: float | None = None,
    ) -> None:
        r = float(scenario.merge_radius)
        unit = r * scenario.sensing_graph.extreme_weights(scenario.n_robots)[1]
        budget = min(_BUDGET * unit, LARGEST) if budget is None else budget
        patience = min(_PATIENCE * r, LARGEST) if patience is None else patience
        self.scenario, self.budget = scenario, number("budget", budget, 0.0, unit="m²/s")
        self._margin = check_margin(min_alignment)
        check_clearance(clearance)
        steering = self._steering = Steering(scenario)
        robot = robot_of(scenario, 0.0 if steering.turns else self._margin)  # guarantees 8
        bounds = robot.speed_limit, robot.gate.yaw_limit, robot.gate.pitch_limit
        self._unit = np.array(bounds[: scenario.action_size] if steering.turns else bounds[0])
        self._settings = _Settings(
            robot,
            clearance=float(clearance) / (scenario.dim - 1),
            patience=positive("patience", patience, "m"),
            rounding=_ROUNDING * unit,
            aligned=ALIGNED if scenario.dim == 2 else ALIGNED_IN_SPACE,
        )

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``: a tank that does not observe merges."""
        own = {"budget": self.budget, "min_alignment": self._margin}
        return {"by": "tank", "observes_merges": False} | own

    def _start(self, teams: int) -> None:
        self._tank = EnergyTank(
            self.scenario, teams, budget=self.budget, min_alignment=self._margin, frame="local"
        )
        self._memory = np.zeros((teams, self.scenario.n_robots, MEMORY))
        self._memory[..., PATIENCE] = self._settings.patience

    def _forget(self, which: Mask) -> None:
        self._tank.forget(which)
        self._memory[which] = 0.0
        self._memory[which, :, PATIENCE] = self._settings.patience

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        seen, layout = self._teams_of(observations), self.scenario.observation_layout
        f, robots = layout.net_bearing(seen), seen.shape[0] * seen.shape[1]
        silhouettes = np.ascontiguousarray(layout.split(seen).obstacles)
        desired = np.zeros((robots, self.scenario.action_size))
        wall_following_velocities(
            f.reshape(robots, layout.dim),
            layout.degree(seen).reshape(robots),
            silhouettes.reshape(robots, *silhouettes.shape[2:]),
            self._tank.levels.reshape(robots),
            self._settings,
            self._steering.pitches(seen).reshape(robots),
            self._memory.reshape(robots, MEMORY),
            desired,
        )
        choices = desired.reshape(*f.shape[:-1], -1) / self._unit
        actions = self._tank.apply(seen, choices)
        self._tank.update()
        velocities = self._steering.velocities(actions, seen)
        self._memory[..., WORK] += self.scenario.tau * np.sum(f * velocities, axis=-1)
        if self._steering.turns:
            toil = np.linalg.norm(f, axis=-1) * np.linalg.norm(velocities, axis=-1)
            self._memory[..., WORK] -= _TOIL * self.scenario.tau * toil
            for first in (HEADING, ASIDE)[: layout.dim - 1]:
                vectors = self._memory[..., first : first + layout.dim]
                vectors[:] = self._steering.turned(vectors, actions, seen)
        return self._as_given(actions)

    @property
    def levels(self) -> Array:
        """Stored energies A, (..., n), m²/s; empty before the first action."""
        return np.zeros(0) if self._leading is None else self._as_given(self._tank.levels)
