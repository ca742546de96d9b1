"""Frames and planes of learned policies that do not turn with robots, as
``baselines.steady_frames``, over arrays.

Observations are ``Rows`` of arrays (..., n, …), vectors pairs or triples of arrays (..., n).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.physics.vectors import (
    combine,
    dot,
    norm,
    rotated,
    split,
    to_global,
    to_local,
    without,
)
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.robots.unicycle import arc_2d, clip
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.turning import TINY

from ..steady_frames import _Way
from ..steering import WITHIN
from . import planes, steering
from .arrays import Array, angle_of, parts_of, select
from .policy import Rows, degree_of, sum_of

_dot, _rotated, _split = map(array_form, (dot, rotated, split))


class SteadyObservation(NamedTuple):
    """Observations in a frame or plane, and what actions depend on."""

    rows: Rows
    pitch: Array  # β, rad
    plane: Any  # f/‖f‖ and the unit vector across it in 3-D, triples in the body frame


class SteadyAngles(NamedTuple):
    """Memory of unicycles: their initial body frames (``OdometryFrame``)."""

    angles: Array  # by which they have turned, rad


class Planes(NamedTuple):
    """Memory of 3-D robots (``SteadyPlanes``); vectors (..., n, 3) in the level initial frame."""

    towards: Array
    asides: Array
    angles: Array  # of f in the plane, rad
    blocked: Array
    yaws: Array  # rad
    pitches: Array  # rad


def no_memory(way: _Way, robots: tuple[int, ...]) -> SteadyAngles | Planes:
    """Memory of robots (..., n) before their first observation."""
    zero = jnp.zeros(robots, jnp.result_type(float))
    if way.robot.gate.planar:
        return SteadyAngles(zero)
    vectors = jnp.zeros((*robots, 3), zero.dtype)
    return Planes(vectors, vectors, zero, zero.astype(bool), zero, zero)


def look(way: _Way, seen: Rows, kept: Any) -> tuple[SteadyObservation, Any]:
    """Observations in the frames or planes, rounded to float32, and memory."""
    if isinstance(kept, Planes):
        return _look_in_planes(way, seen, kept)
    angles = kept.angles

    def turned(rows: Array) -> Array:
        angle = angles.reshape(*angles.shape, *[1] * (rows.ndim - angles.ndim - 1))
        return _rounded(_rotated(parts_of(rows), angle)[:2])

    rows = seen._replace(neighbours=turned(seen.neighbours), obstacles=turned(seen.obstacles))
    return SteadyObservation(rows, jnp.zeros_like(angles), ()), kept


def _rounded(vector: Any) -> Array:
    """Pairs as arrays (..., 2), as float32 represents them."""
    stacked = jnp.stack(vector, axis=-1)
    return stacked.astype(jnp.float32).astype(stacked.dtype)


def _look_in_planes(way: _Way, seen: Rows, kept: Planes) -> tuple[SteadyObservation, Planes]:
    pitch = steering.pitch_of(seen, way.robot.gate) if way.robot.turns else kept.pitches
    frame = array_form(body_frame_3d)(kept.yaws, pitch)
    was, before = (
        array_form(to_local)(frame, parts_of(vectors)) for vectors in (kept.towards, kept.asides)
    )
    strength, u = _split(parts_of(sum_of(seen)))
    u = select(strength == 0.0, _or_ahead(was), u)
    angle = kept.angles + angle_of(_dot(u, before), _dot(u, was))
    before = select(planes.any_of(before), before, _farthest_aside(seen.neighbours, u))
    cones = planes.widened_cones(seen.obstacles, way.clearance)
    keeps = jnp.where(kept.blocked, way.keeps, 0.0)
    aside, _ = planes.kept_azimuth(u, before, keeps, way.clearance, cones)
    side = jnp.where(_dot(aside, before) < 0.0, -1.0, 1.0)  # left stays left
    aside = tuple(side * part for part in aside)
    cut = planes.cut_by(u, aside, cones)
    joined = planes.interval_in_plane(cut)
    towards, asides = (jnp.stack(array_form(to_global)(frame, axis), -1) for axis in (u, aside))
    blocked = (joined.low < way.clearance) & (joined.high > -way.clearance)
    after = Planes(towards, asides, angle, blocked, kept.yaws, pitch)
    rows = _in_plane(parts_of(seen.neighbours), (u, aside), angle)
    edges = _rotated(_split(parts_of(cut))[1], angle[..., None, None])[:2]
    shown = seen._replace(neighbours=_rounded(rows), obstacles=_rounded(edges))
    return SteadyObservation(shown, pitch, (u, aside)), after


def _or_ahead(vector: Any) -> Any:
    """A triple, or the x axis for zero."""
    known = planes.any_of(vector)
    return jnp.where(known, vector[0], 1.0), *vector[1:]


def _farthest_aside(neighbours: Array, towards: Any) -> Any:
    """The component across f of the neighbour that is farthest aside."""
    u = tuple(part[..., None] for part in towards)
    across = array_form(without)(parts_of(neighbours), u)
    farthest = jnp.argmax(array_form(norm)(across), axis=-1)[..., None]
    return tuple(jnp.take_along_axis(part, farthest, axis=-1)[..., 0] for part in across)


def _in_plane(vectors: Any, plane: Any, angle: Array) -> Any:
    """Pairs of triples, of arrays (..., n) or (..., n, K), in planes of robots."""
    more = [1] * (vectors[0].ndim - angle.ndim)
    axes = [tuple(part.reshape(*part.shape, *more) for part in axis) for axis in plane]
    projected = [_dot(vectors, axis) for axis in axes]
    return _rotated(projected, angle.reshape(*angle.shape, *more))[:2]


def follow(way: _Way, seen: Rows, view: SteadyObservation, kept: Any, headings: Array) -> Array:
    """Choices for a filter along headings (..., n, 2), with the speed of law (1).

    They are velocities, speeds and turn rates, or without a tank turn rates, as fractions of
    limits: (..., n, d) or (..., n, 1 + angles).
    """
    robot, gate = way.robot, way.robot.gate
    scale = array_form(scale_of_step)(degree_of(seen), robot.merge_radius, gate.duration)
    law_speed = array_form(norm)(parts_of(sum_of(seen))) * scale
    if isinstance(kept, SteadyAngles):
        speed = jnp.minimum(law_speed, robot.speed_limit)
        wanted = _rotated(parts_of(headings * speed[..., None]), -kept.angles)
        forward, (rate, _) = steering.inputs_towards(wanted, view.pitch, gate, way.aligned)
        share = rate / gate.yaw_limit if gate.yaw_limit > 0.0 else 0.0 * rate
        return jnp.stack([forward / robot.speed_limit, share], axis=-1)
    ahead, across, _ = _rotated(parts_of(headings), -kept.angles)
    share = WITHIN * jnp.minimum(law_speed / robot.speed_limit, 1.0)
    heading = array_form(combine)(ahead, view.plane[0], across, view.plane[1])
    wanted = tuple(share * part for part in heading)
    if not robot.turns:
        return jnp.stack(wanted, axis=-1)
    forward, rates = steering.inputs_towards(wanted, view.pitch, gate, way.aligned)
    cones = planes.widened_cones(seen.obstacles, way.clearance)
    clear = planes.axis_is_clear(rates, view.pitch, cones, gate)
    limits = max(gate.yaw_limit, TINY), max(gate.pitch_limit, TINY)
    shares = (rate / limit for rate, limit in zip(rates, limits, strict=True))
    return jnp.stack([jnp.where(clear, forward, 0.0), *shares], axis=-1)


def turn(way: _Way, view: SteadyObservation, kept: Any, actions: Array) -> tuple[Array, Any]:
    """Mean velocities (..., n, 2) in the frames or planes over a step of actions, and memory."""
    robot, gate = way.robot, way.robot.gate
    if isinstance(kept, SteadyAngles):
        given = parts_of(actions.astype(kept.angles.dtype))
        speed, rate = (
            array_form(clip)(part, limit)
            for part, limit in zip(given, (robot.speed_limit, gate.yaw_limit), strict=True)
        )
        moved = array_form(arc_2d)(speed, kept.angles, rate, gate.duration)
        mean = jnp.stack(moved, axis=-1) / gate.duration
        return mean, SteadyAngles(kept.angles + rate * gate.duration)
    velocity: Any = parts_of(actions.astype(kept.angles.dtype))
    if robot.turns:
        speed = array_form(clip)(velocity[0], robot.speed_limit)
        driven = jnp.concatenate([speed[..., None], actions[..., 1:]], axis=-1)
        velocity = steering.velocities(driven, view.pitch, gate)
        turned = steering.rates_in(actions, gate)[0] * gate.duration
        after = kept._replace(yaws=kept.yaws + turned)
    else:
        after = kept
    return jnp.stack(_in_plane(velocity, view.plane, kept.angles), axis=-1), after
