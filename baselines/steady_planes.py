"""Planes of space in which robots decide: what they see there, and how they follow headings there.

A robot of space passes obstacles in a plane that holds f (``planes_in_space``). What it sees and
remembers there is what a robot of the plane sees and remembers, so that the same policy steers it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.engine.state_checks import Remembering
from rendezvous_env.engine.threads import Part
from rendezvous_env.physics.neighbour_rows import net_bearing_of
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    dot,
    load,
    norm,
    scaled,
    split,
    store,
    to_global,
    to_local,
    without,
)
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.robots.unicycle import clip
from rendezvous_env.safety.turning import TINY, Gate, gate_of, mean_axis, pitch_of, rates_of
from rendezvous_env.scenario.scenario import Scenario

from .obstacle_rules.merged_silhouettes_2d import joined_interval_2d
from .obstacle_rules.planes_in_space import cut_by, kept_azimuth, widened_rays
from .obstacle_rules.silhouettes import is_seen
from .obstacle_rules.turning_robots import axis_is_clear_3d
from .steady_frames import law_speed
from .steering import ALIGNED_IN_SPACE, WITHIN, inputs_towards


class _Robot(NamedTuple):
    """What the kernels need to know of the robots."""

    neighbour_slots: int
    obstacle_slots: int
    gravity_row: int
    turns: bool
    """Whether they are nonholonomic."""
    keeps: float
    """As ``kept_azimuth``, rad."""
    clearance: float
    """By how much cones are widened, rad."""
    merge_radius: float
    speed_limit: float
    gate: Gate


class _Memory(NamedTuple):
    """What robots remember of their planes, (B, n, ...) each; vectors in the frame of the yaw that
    their body had at first, levelled by gravity.
    """

    towards: NDArray[np.float64]
    """(B, n, 3), f/‖f‖; zero before the first step."""
    aside: NDArray[np.float64]
    """(B, n, 3), the unit vector across f of the plane."""
    angles: NDArray[np.float64]
    """Of f in the plane, rad: by how much it has turned there."""
    blocked: NDArray[np.float64]
    """Whether something there is before f."""
    yaws: NDArray[np.float64]
    """By how much the body has turned, rad."""
    pitches: NDArray[np.float64]
    turns: NDArray[np.float64]
    """Of the yaw in the step before, rad."""
    bends: NDArray[np.float64]
    """|v| ‖ω‖ τ² of that step, m."""
    headings: NDArray[np.float64]
    """(B, n, 2), in the plane."""
    velocities: NDArray[np.float64]


class SteadyPlanes(Remembering):
    """Planes of the robots of B teams in space; as ``SteadyFrames`` has it for unicycles.

        (cos θ, sin θ) = f/‖f‖ in the plane,   θ ← θ + ∠ in the plane that f has turned

    While something in its plane is before f, but not too wide, a robot keeps to it, as f turns;
    else it takes the one with least to turn, and what it remembers turns with it about f.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        clearance: rad.
        most: at most so fast may a body turn, rad/s; the scenario's limits hold too.
        keeps: of ``kept_azimuth``, rad: PASSABLE under headings.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        clearance: float,
        most: float = math.inf,
        keeps: float = math.inf,
    ) -> None:
        layout, robots = scenario.observation_layout, (num_envs, scenario.n_robots)
        widths = {"towards": (3,), "aside": (3,), "headings": (2,), "velocities": (2,)}
        self._kept = _Memory(
            **{name: np.zeros((*robots, *widths.get(name, ()))) for name in _Memory._fields}
        )
        self.headings, self.velocities = self._kept.headings, self._kept.velocities
        rows = layout.neighbour_slots + 2 * layout.obstacle_slots
        self._seen = np.zeros((*robots, rows, 2), np.float32)
        self._robot = _Robot(
            neighbour_slots=layout.neighbour_slots,
            obstacle_slots=layout.obstacle_slots,
            gravity_row=layout.gravity.start,
            turns=scenario.model.nonholonomic,
            keeps=float(keeps),
            clearance=clearance,
            merge_radius=float(scenario.merge_radius),
            speed_limit=float(scenario.speed_limit),
            gate=gate_of(scenario, 0.0, 0.0, most),
        )

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return self._kept._asdict()

    def seen(
        self, observations: NDArray[np.float32], teams: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """What some teams see in their planes, of (B, n, rows, 3): (B, n, K + 2 M, 2), until the
        next call; once or twice in a step, with the same observations.
        """
        _look(teams, observations, self._robot, self._kept, self._seen)
        return self._seen

    def follow(
        self, teams: Part, observations: NDArray[np.float32], held: NDArray[np.float64]
    ) -> None:
        """Write the desired inputs of a part of the teams, in units of their bounds: (v, ω), or
        where another sets the speed ω alone; velocities of single integrators.
        """
        _follow(teams, observations, self._robot, self._kept, held)

    def turn(self, teams: Part, actions: NDArray[np.float32]) -> None:
        """Take note of the actions that these teams take for τ."""
        _turn(teams, actions, self._robot, self._kept)

    def settle(self, share: float) -> NDArray[np.float64]:
        """As ``SteadyFrames.settle``."""
        kept = self._kept
        kept.yaws[...] += (min(share, 1.0) - 1.0) * kept.turns
        bends, kept.turns[...], kept.bends[...] = kept.bends.copy(), 0.0, 0.0
        return bends


@kernel(allocates=True)
def _look(teams, observations, robot, memory, seen):
    K, M = robot.neighbour_slots, robot.obstacle_slots
    rays, cut, intervals = np.empty((M, 8, 3)), np.empty((M, 2, 2)), np.empty((M, 2))
    for team in teams:
        for i in range(observations.shape[1]):
            rows, out = observations[team, i], seen[team, i]
            silhouettes = rows[K : K + 8 * M].reshape((M, 8, 3))
            if robot.turns:
                memory.pitches[team, i] = pitch_of(rows, robot.gravity_row, robot.gate)
            frame, (was, before, angle) = _plane_of((team, i), memory)
            strength, u = split(net_bearing_of(rows, K))
            if strength == 0.0:
                u = was if was != ORIGIN else X_AXIS
            angle += math.atan2(dot(u, before), dot(u, was))
            if before == ORIGIN:
                before = _aside_of_neighbours(rows, u, K)
            count = widened_rays(silhouettes, robot.clearance, rays)
            cones = rays[:count], cut[:count], intervals[:count]
            keeps = robot.keeps if memory.blocked[team, i] != 0.0 else 0.0
            aside, blocked = _taken_plane(u, before, keeps, robot.clearance, cones)
            memory.blocked[team, i] = 1.0 if blocked else 0.0
            memory.angles[team, i] = angle
            store(to_global(frame, u), memory.towards[team, i])
            store(to_global(frame, aside), memory.aside[team, i])
            _write(rows, (u, aside, angle), silhouettes, cut, out)


@kernel
def _plane_of(robot, memory):
    """A robot's frame, and its plane as the body sees it: f/‖f‖, the unit vector across it, θ."""
    frame = body_frame_3d(memory.yaws[robot], memory.pitches[robot])
    u, aside = load(memory.towards[robot]), load(memory.aside[robot])
    return frame, (to_local(frame, u), to_local(frame, aside), memory.angles[robot])


@kernel
def _aside_of_neighbours(rows, u, neighbour_slots):
    """Across f, towards the neighbour that is farthest aside; zero where all are along f."""
    best = ORIGIN
    for k in range(neighbour_slots):
        across = without(load(rows[k]), u)
        if norm(across) > norm(best):
            best = across
    return best


@kernel
def _taken_plane(u, before, keeps, clearance, cones):
    """As ``kept_azimuth``, on the side of the one before; and whether anything there is before f.

    ``cones`` are its views; what the plane cuts of them is left there.
    """
    rays, cut, intervals = cones
    aside, _ = kept_azimuth(u, before, keeps, clearance, cones)
    if dot(aside, before) < 0.0:  # left stays left
        aside = scaled(aside, -1.0)
        cut_by(u, aside, rays, cut)
    low, high, _, _ = joined_interval_2d(X_AXIS, cut, intervals)
    return aside, low < clearance and high > -clearance


@kernel
def _write(rows, plane, silhouettes, cut, out):
    """What is seen of neighbours and obstacles in a plane, (K + 2 M, 2)."""
    M, count = silhouettes.shape[0], 0
    K = out.shape[0] - 2 * M
    for k in range(K):
        out[k, 0], out[k, 1] = _in_plane(load(rows[k]), plane)
    out[K:] = 0.0
    for m in range(M):
        if not is_seen(silhouettes[m]):
            continue
        for s in range(2):
            length, edge = split(load(cut[count, s]))
            if length > 0.0:
                out[K + 2 * m + s, 0], out[K + 2 * m + s, 1] = _turned(edge, plane[2])
        count += 1


@kernel
def _turned(vector, angle):
    """A vector of the plane turned counter-clockwise, a pair."""
    c, s = math.cos(angle), math.sin(angle)
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


@kernel
def _in_plane(vector, plane):
    """The part of a triple in a plane, a pair in its frame."""
    u, aside, angle = plane
    return _turned((dot(vector, u), dot(vector, aside)), angle)


@kernel(allocates=True)
def _follow(teams, observations, robot, memory, held):
    K, M, gate = robot.neighbour_slots, robot.obstacle_slots, robot.gate
    rays = np.empty((M, 8, 3))
    for team in range(teams[0], teams[1]):
        for i in range(observations.shape[1]):
            rows, desired = observations[team, i], held[team, i]
            _, (u, aside, angle) = _plane_of((team, i), memory)
            ahead, across = _turned(memory.headings[team, i], -angle)
            heading = combine(ahead, u, across, aside)
            speed = law_speed(rows, K, robot.merge_radius, gate.duration)
            wanted = scaled(heading, WITHIN * min(speed / robot.speed_limit, 1.0))
            if not robot.turns:
                store(wanted, desired)
                continue
            pitch = memory.pitches[team, i]
            forward, rates = inputs_towards(wanted, pitch, gate, ALIGNED_IN_SPACE)
            desired[-2] = rates[0] / max(gate.yaw_limit, TINY)
            desired[-1] = rates[1] / max(gate.pitch_limit, TINY)
            if len(desired) > 2:
                silhouettes = rows[K : K + 8 * M].reshape((M, 8, 3))
                cones = rays[: widened_rays(silhouettes, robot.clearance, rays)]
                desired[0] = forward if axis_is_clear_3d(rates, pitch, cones, gate) else 0.0


@kernel
def _turn(teams, actions, robot, memory):
    gate = robot.gate
    for team in range(teams[0], teams[1]):
        for i in range(actions.shape[1]):
            velocity, plane = load(actions[team, i]), _plane_of((team, i), memory)[1]
            if robot.turns:
                rates = rates_of(actions[team, i], gate)
                speed = clip(velocity[0], robot.speed_limit)
                velocity = scaled(mean_axis(rates, memory.pitches[team, i], gate), speed)
                turned = math.hypot(rates[0], rates[1]) * gate.duration
                memory.bends[team, i] = abs(speed) * turned * gate.duration
                memory.turns[team, i] = rates[0] * gate.duration
                memory.yaws[team, i] += memory.turns[team, i]
            x, y = _in_plane(velocity, plane)
            memory.velocities[team, i, 0], memory.velocities[team, i, 1] = x, y
