"""Frames and planes that do not rotate with nonholonomic robots, for stored directions.

A nonholonomic robot has no compass, but its commanded rates determine its rotation since the start
of the episode. A unicycle stores directions in its initial body frame. A 3-D robot passes obstacles
in a plane that contains f (``planes_in_space``), where the same policy controls it.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.engine.state_checks import StatefulMixin
from rendezvous_env.engine.threads import Slice
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    dot,
    load,
    norm,
    rotated,
    scaled,
    split,
    store,
    to_global,
    to_local,
    without,
)
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.robots.unicycle import arc_2d, clip
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.turning import TINY, Robot, mean_axis, pitch_of, rates_of, robot_of
from rendezvous_env.scenario.scenario import Scenario

from .obstacle_rules.merged_intervals_2d import merged_interval_2d
from .obstacle_rules.obstacle_edges import is_seen
from .obstacle_rules.planes_in_space import (
    axis_is_clear_3d,
    cut_by,
    kept_azimuth,
    widened_rays,
)
from .policy import Float32
from .records import Array, Records
from .steering import ALIGNED_IN_SPACE, WITHIN, inputs_towards


class _Way(NamedTuple):
    """Steering parameters for kernels."""

    robot: Robot
    aligned: float  # as ``inputs_towards``, rad
    clearance: float  # widening of cones, rad
    keeps: float  # as ``kept_azimuth``, rad


class _Bodies(StatefulMixin):
    """Memory of the bodies in B environments, for the kernels of a subclass.

    A unicycle drives within the ``clearance``, rad, of its desired direction; in 3-D cones are
    widened by it. ``most`` is an additional limit of turn rates, rad/s. ``keeps``, rad, applies in
    3-D, as in ``kept_azimuth``: PASSABLE for heading policies.
    """

    _fields: Mapping[str, tuple[int, ...]]  # shapes of a robot's memory
    _yaws: str  # index of the rotation of the bodies in the memory
    _look: Any
    _follow: Any
    _turn: Any

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        clearance: float,
        most: float = math.inf,
        keeps: float = math.inf,
    ) -> None:
        robots, robot = (num_envs, scenario.n_robots), robot_of(scenario, most=most)
        self._records = Records(robots, self._fields)
        aligned = clearance if scenario.dim == 2 else ALIGNED_IN_SPACE
        self._way = _Way(robot, float(aligned), float(clearance), float(keeps))
        self.headings: Array = np.zeros((*robots, 2))
        """Desired headings, (B, n, 2), in that frame or plane; zero where undefined."""
        self.velocities: Array = np.zeros((*robots, 2))
        """Mean velocities over the previous step, (B, n, 2), m/s."""
        rows = robot.neighbour_slots + 2 * robot.obstacle_slots
        self._seen = np.zeros((*robots, rows, 2), np.float32)

    @property
    def _memory(self) -> dict[str, Array]:
        return {
            "headings": self.headings, "velocities": self.velocities, **self._records.views,
        }  # fmt: skip

    def seen(self, observations: Float32, teams: NDArray[np.intp]) -> Float32:
        """Observations of some environments in that frame or plane, (B, n, K + 2M, 2).

        The array is valid until the next call.
        """
        self._look(teams, observations, self._way, self._records.array, self._seen)
        return self._seen

    def follow(self, teams: Slice, observations: Float32, held: Array) -> None:
        """Write actions of some environments with the speed of law (1), in units of their bounds.

        These are velocities of single integrators, (v, ω), or ω alone where the speed is set
        elsewhere.
        """
        self._follow(teams, observations, self._way, self._records.array, self.headings, held)

    def turn(self, teams: Slice, actions: Float32) -> None:
        """Record the actions of these environments, which last τ."""
        self._turn(teams, actions, self._way, self._records.array, self.velocities)

    def settle(self, share: float) -> Array:
        """Correct the last step, which lasted only a fraction of τ.

        Returns |v| ‖ω‖ τ² of the step, (B, n), m, which bounds the distance of its arc from a
        straight line.
        """
        kept = self._records.views
        bends = kept["bends"].copy()
        kept[self._yaws][...] += (min(share, 1.0) - 1.0) * kept["turns"]
        kept["turns"][...], kept["bends"][...] = 0.0, 0.0
        return bends


@inner_kernel
def _law_speed(rows, robot):
    """Speed of law (1) in a step of τ, min(1, r/(2 D τ)) ‖f‖, m/s."""
    degree = degree_of(rows, robot.neighbour_slots)
    scale = scale_of_step(degree, robot.merge_radius, robot.gate.duration)
    return norm(net_bearing_of(rows, robot.neighbour_slots)) * scale


_IN_FRAMES = {"angles": (1,), "turns": (1,), "bends": (1,)}
"""Memory of a unicycle's body.

Its rotation, rad, and that of the previous step; |v ω| τ² of that step, m."""


@kernel
def _look_in_frames(teams, observations, way, memory, seen):
    for team in teams:
        for i in range(observations.shape[1]):
            c, s = math.cos(memory[team, i, 0]), math.sin(memory[team, i, 0])
            for k in range(observations.shape[2]):
                x, y = (
                    np.float64(observations[team, i, k, 0]),
                    np.float64(observations[team, i, k, 1]),
                )
                seen[team, i, k, 0], seen[team, i, k, 1] = c * x - s * y, s * x + c * y


@kernel
def _follow_in_frames(teams, observations, way, memory, headings, held):
    robot, limit, gate = way.robot, way.robot.speed_limit, way.robot.gate
    for team in range(teams[0], teams[1]):
        for i in range(observations.shape[1]):
            desired = held[team, i]
            speed = min(_law_speed(observations[team, i], robot), limit)
            c, s = math.cos(memory[team, i, 0]), math.sin(memory[team, i, 0])
            x, y, _ = scaled(load(headings[team, i]), speed)
            wanted = c * x + s * y, c * y - s * x, 0.0
            forward, (rate, _) = inputs_towards(wanted, 0.0, gate, way.aligned)
            desired[-1] = rate / gate.yaw_limit if gate.yaw_limit > 0.0 else 0.0
            if len(desired) > 1:
                desired[0] = forward / limit


@kernel
def _turn_in_frames(teams, actions, way, memory, velocities):
    robot, gate = way.robot, way.robot.gate
    for team in range(teams[0], teams[1]):
        for i in range(actions.shape[1]):
            kept = memory[team, i]
            speed = clip(np.float64(actions[team, i, 0]), robot.speed_limit)
            rate = clip(np.float64(actions[team, i, 1]), gate.yaw_limit)
            x, y = arc_2d(speed, kept[0], rate, gate.duration)
            velocities[team, i, 0] = x / gate.duration
            velocities[team, i, 1] = y / gate.duration
            turned = rate * gate.duration
            kept[1] = turned
            kept[2] = abs(speed * turned) * gate.duration
            kept[0] += turned


class OdometryFrame(_Bodies):
    """Headings of the unicycles of B environments, in their initial body frames.

    u = R(θ) u_body,   θ ← θ + ω τ
    """

    _fields, _yaws = _IN_FRAMES, "angles"
    _look, _follow = staticmethod(_look_in_frames), staticmethod(_follow_in_frames)
    _turn = staticmethod(_turn_in_frames)


_IN_PLANES = {
    **{"towards": (3,), "aside": (3,)},
    **{name: (1,) for name in ("angles", "blocked", "yaws", "pitches", "turns", "bends")},
}
"""Memory of a robot's plane, with triples in the level frame of the body's initial yaw.

f/‖f‖, zero before the first step; the unit vector of the plane across f; rotation of f in the
plane, rad. Whether an obstacle there blocks f. Yaw of the body, from the initial one, and pitch,
rad. Yaw of the previous step, rad, and |v| ‖ω‖ τ² of that step, m."""
_ASIDE, _ANGLE, _BLOCKED, _YAW, _PITCH, _TURNED, _BEND = 3, *range(6, 12)


@kernel(allocates=True)
def _look_in_planes(teams, observations, way, memory, seen):
    robot, K, M = way.robot, way.robot.neighbour_slots, way.robot.obstacle_slots
    rays, cut, intervals = np.empty((M, 8, 3)), np.empty((M, 2, 2)), np.empty((M, 2))
    for team in teams:
        for i in range(observations.shape[1]):
            rows, out = observations[team, i], seen[team, i]
            silhouettes = rows[K : K + 8 * M].reshape((M, 8, 3))
            kept = memory[team, i]
            if robot.turns:
                kept[_PITCH] = pitch_of(rows, robot.gravity_row, robot.gate)
            frame, (was, before, angle) = _plane_of(kept)
            strength, u = split(net_bearing_of(rows, K))
            if strength == 0.0:
                u = was if was != ORIGIN else X_AXIS
            angle += math.atan2(dot(u, before), dot(u, was))
            if before == ORIGIN:  # across f, towards the neighbour farthest from the line of f
                for k in range(K):
                    across = without(load(rows[k]), u)
                    before = across if norm(across) > norm(before) else before
            count = widened_rays(silhouettes, way.clearance, rays)
            cones = rays[:count], cut[:count], intervals[:count]
            keeps = way.keeps if kept[_BLOCKED] != 0.0 else 0.0
            aside, _ = kept_azimuth(u, before, keeps, way.clearance, cones)
            if dot(aside, before) < 0.0:  # left stays left
                aside = scaled(aside, -1.0)
                cut_by(u, aside, cones[0], cones[1])
            low, high, _, _ = merged_interval_2d(X_AXIS, cones[1], cones[2])
            blocked = low < way.clearance and high > -way.clearance
            kept[_BLOCKED] = 1.0 if blocked else 0.0
            kept[_ANGLE] = angle
            store(to_global(frame, u), kept[:_ASIDE])
            store(to_global(frame, aside), kept[_ASIDE:_ANGLE])
            _write_plane(rows, (u, aside, angle), silhouettes, cut, out)


@inner_kernel
def _plane_of(kept):
    """Frame of a robot, and its plane in the body frame: f/‖f‖, the unit vector across it, θ."""
    frame = body_frame_3d(kept[_YAW], kept[_PITCH])
    u, aside = load(kept[:_ASIDE]), load(kept[_ASIDE:_ANGLE])
    return frame, (to_local(frame, u), to_local(frame, aside), kept[_ANGLE])


@inner_kernel
def _write_plane(rows, plane, silhouettes, cut, out):
    """Write the neighbours and obstacles in a plane, (K + 2 M, 2)."""
    M, count = silhouettes.shape[0], 0
    K = out.shape[0] - 2 * M
    for k in range(K):
        store(_in_plane(load(rows[k]), plane), out[k])
    out[K:] = 0.0
    for m in range(M):
        if not is_seen(silhouettes[m]):
            continue
        for s in range(2):
            length, edge = split(load(cut[count, s]))
            if length > 0.0:
                store(rotated(edge, plane[2]), out[K + 2 * m + s])
        count += 1


@inner_kernel
def _in_plane(vector, plane):
    """Projection of a triple onto a plane, as a triple in its frame with z = 0."""
    u, aside, angle = plane
    return rotated((dot(vector, u), dot(vector, aside), 0.0), angle)


@kernel(allocates=True)
def _follow_in_planes(teams, observations, way, memory, headings, held):
    robot, gate = way.robot, way.robot.gate
    K, M = robot.neighbour_slots, robot.obstacle_slots
    rays = np.empty((M, 8, 3))
    for team in range(teams[0], teams[1]):
        for i in range(observations.shape[1]):
            rows, desired = observations[team, i], held[team, i]
            _, (u, aside, angle) = _plane_of(memory[team, i])
            ahead, across, _ = rotated(load(headings[team, i]), -angle)
            heading = combine(ahead, u, across, aside)
            share = WITHIN * min(_law_speed(rows, robot) / robot.speed_limit, 1.0)
            wanted = scaled(heading, share)
            if not robot.turns:
                store(wanted, desired)
                continue
            pitch = memory[team, i, _PITCH]
            forward, rates = inputs_towards(wanted, pitch, gate, way.aligned)
            desired[-2] = rates[0] / max(gate.yaw_limit, TINY)
            desired[-1] = rates[1] / max(gate.pitch_limit, TINY)
            if len(desired) > 2:
                silhouettes = rows[K : K + 8 * M].reshape((M, 8, 3))
                cones = rays[: widened_rays(silhouettes, way.clearance, rays)]
                desired[0] = forward if axis_is_clear_3d(rates, pitch, cones, gate) else 0.0


@kernel
def _turn_in_planes(teams, actions, way, memory, velocities):
    robot, gate = way.robot, way.robot.gate
    for team in range(teams[0], teams[1]):
        for i in range(actions.shape[1]):
            velocity, kept = load(actions[team, i]), memory[team, i]
            plane = _plane_of(kept)[1]
            if robot.turns:
                rates = rates_of(actions[team, i], gate)
                speed = clip(velocity[0], robot.speed_limit)
                velocity = scaled(mean_axis(rates, kept[_PITCH], gate), speed)
                turned = math.hypot(rates[0], rates[1]) * gate.duration
                kept[_BEND] = abs(speed) * turned * gate.duration
                kept[_TURNED] = rates[0] * gate.duration
                kept[_YAW] += kept[_TURNED]
            store(_in_plane(velocity, plane), velocities[team, i])


class OdometryPlane(_Bodies):
    """Planes of the 3-D robots of B environments; the counterpart of ``OdometryFrame``.

        (cos θ, sin θ) = f/‖f‖ in the plane,   θ ← θ + rotation of f in the plane

    While an obstacle in its plane blocks f, but is not too wide, a robot keeps the plane as f
    rotates. Otherwise it uses the plane with the smallest turn, and its memory is rotated about f.
    """

    _fields, _yaws = _IN_PLANES, "yaws"
    _look, _follow = staticmethod(_look_in_planes), staticmethod(_follow_in_planes)
    _turn = staticmethod(_turn_in_planes)
