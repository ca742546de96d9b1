"""Contact with obstacles over arrays: ``obstacles.contact`` for many robots at once.

Robots are lanes, (L,), the last axis of every array. Points and displacements are tuples of d.
"""

from typing import Any

import jax
import jax.numpy as jnp

from ...obstacles.contact import (
    _CHORD_TOLERANCE,
    _LEAST_CHORDS,
    _MAX_LEGS,
    _MOST_CHORDS,
    _MOST_WORK,
    SLIDE,
    STOP,
)
from ...obstacles.obstacle_set import _MAX_PUSHES
from ...physics.vectors import cross, dot
from ...robots.motion import SLID, STOPPED, chord_error_bound, displacement_at, period
from ..arrays.array_form import Array, array_form, norm_of, select
from ..arrays.loops import while_busy
from ..arrays.selection import divided
from ..arrays.some_envs import for_envs
from .fields import Fields
from .shapes import Shapes, World

_dot = array_form(dot)


def _add(a: Any, b: Any) -> Any:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _subtract(a: Any, b: Any) -> Any:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _scaled(a: Any, factor: Any) -> Any:
    return tuple(x * factor for x in a)


class Contact:
    """Motion of robots up to and along obstacles, in SLIDE or STOP mode.

    With ``bounded`` gradients pass: legs are a loop of fixed length, and corrections by less than
    the depth of contact, whose loops end early, are constants.
    """

    def __init__(self, shapes: Shapes, mode: int, bounded: bool = False) -> None:
        self._shapes, self._mode, self._tolerances = shapes, mode, shapes.tolerances
        self._bounded = bounded

    def move_straight(self, world: World, point: Any, way: Any) -> tuple[Array, Any]:
        """``contact.move_straight``: whether there was a contact, and the displacement."""
        near, fraction = self._first_contact(world, point, way, self._tolerances.depth)
        end_is_clear = self._shapes.is_clear(world, _add(point, way), self._tolerances.touching)
        free = ~near | ((fraction > 1.0) & end_is_clear)
        in_skin = self._is_in_skin(world, point, ~free)
        end, has_room, from_start = self._follow(world, point, way, ~free, in_skin)
        executed = _subtract(end, point)
        met = jnp.where(in_skin, from_start, fraction) <= 1.0
        met |= self._is_held(world, point, executed, way)
        return self._outcome(free, has_room, way, met, executed)

    def move_curved(self, world: World, point: Any, way: Any, curve: Any) -> tuple[Array, Any]:
        """``contact.move_curved``; a curve is (model, action, frame, memory)."""
        model = curve[0]
        reach = model.speed_limit * model.duration
        near = jnp.any(self._shapes.within(world, point, reach), axis=0)
        has_room, in_skin, start = self._out_of_skins(world, point, near)
        time = self._time_of_contact(world, start, curve, near & has_room)
        contact, free_end = time <= model.duration, _add(start, way)
        is_clear = self._shapes.is_clear(world, free_end, self._tolerances.touching)
        free = ~near | (~contact & is_clear)
        share = jnp.minimum(time, model.duration)
        pace = jnp.full_like(share, model.speed_limit)

        def place(share: Any) -> Any:
            return _add(start, self._displacement(curve, share))

        end, _ = self._settle(world, start, place, share, pace, ~free & has_room)
        if self._mode == SLIDE:
            left = _subtract(free_end, end)
            slid, _, _ = self._follow(world, end, left, ~free & has_room & contact)
            end = select(contact, slid, end)
        executed = _subtract(end, point)
        met = contact | self._is_held(world, point, executed, way)
        moved = select(in_skin, _subtract(free_end, point), way) if self._shapes.has_skins else way
        met, executed = self._outcome(free, has_room, moved, met, executed)
        return met & near, select(near, executed, way)

    def _outcome(self, free: Any, has_room: Any, way: Any, met: Any, executed: Any) -> Any:
        met = jnp.where(has_room, met & ~free, _dot(way, way) > 0.0)
        executed = select(free, way, executed)
        return met, tuple(jnp.where(has_room, part, 0.0) for part in executed)

    def _displacement(self, curve: Any, time: Any) -> Any:
        moved = array_form(displacement_at)(*curve, time)
        return tuple(jnp.broadcast_to(part, time.shape) for part in moved)

    def _first_contact(self, world: World, point: Any, way: Any, depth: Any) -> tuple[Array, Array]:
        reach = norm_of(way) + jnp.maximum(0.0, -depth)
        within = self._shapes.within(world, point, reach)
        entries = jnp.where(within, self._shapes.entry(world, point, way, depth), jnp.inf)
        return jnp.any(within, axis=0), jnp.min(entries, axis=0)

    def _out_of_skins(self, world: World, point: Any, asked: Array) -> tuple[Array, Array, Any]:
        in_skin = self._is_in_skin(world, point, asked)
        if not self._shapes.has_skins:
            return ~in_skin, in_skin, point
        has_room, start = self._push_out(world, self._constant(point), in_skin)
        start = self._corrected(point, start)
        return has_room | ~in_skin, in_skin, select(in_skin, start, point)

    def _constant(self, values: Any) -> Any:
        return jax.tree.map(jax.lax.stop_gradient, values) if self._bounded else values

    def _corrected(self, point: Any, corrected: Any) -> Any:
        """A corrected point, with the gradient of the point where gradients pass."""
        if not self._bounded:
            return corrected
        return _add(point, self._constant(_subtract(corrected, point)))

    def _is_in_skin(self, world: World, point: Any, asked: Array) -> Array:
        if not self._shapes.has_skins:
            return jnp.zeros_like(asked)
        distance = self._shapes.distances(world, point)
        skins = (world.skins > 0.0) & self._shapes.within(world, point, 0.0)
        deep = skins & (distance < world.skins + self._tolerances.touching)
        return asked & jnp.any(deep, axis=0)

    def _push_out(self, world: World, point: Any, asked: Array) -> tuple[Array, Any]:
        """``obstacle_set.push_out``: whether there is room outside the obstacles, and the point."""
        none = jnp.zeros_like(point[0])
        end, is_out = self._settled(world, point, lambda _: point, none, none, asked)
        return is_out, end

    def _settle(
        self, world: World, start: Any, place: Any, share: Any, pace: Any, asked: Array
    ) -> tuple[Any, Array]:
        """``contact._settle``: a place on the path, and whether it is outside the obstacles."""
        depth, wanted, world = self._tolerances.depth, place(share), self._constant(world)
        start, share, step = self._constant((start, share, depth / jnp.maximum(depth, pace)))
        end, clear = self._settled(world, start, place, share, step, asked)
        return self._corrected(wanted, end), clear

    def _settled(
        self, world: World, start: Any, place: Any, share: Any, step: Any, asked: Array
    ) -> tuple[Any, Array]:
        """Push out a place on the path; without room, those before it, and last the start.

        Obstacles push in their order, 8 times through all.
        """
        slots = jnp.arange(self._shapes.count).reshape(-1, 1)

        def place_of(share: Any, step: Any) -> tuple[Any, Array]:
            last = ~((share > 0.0) & (step > 0.0))
            return self._constant(select(last, start, place(share))), last

        def push(now: Any) -> Any:
            point, slot, rounds, share, step, is_out, busy = now
            distance, normal = self._shapes.surface(world, point)
            deep = distance < world.skins
            begins = ~jnp.any(deep & (slots >= slot), axis=0)  # all are through
            rounds = rounds + begins
            clear = jnp.all(distance >= self._tolerances.touching + world.skins, axis=0)
            through = begins & (clear | (rounds > _MAX_PUSHES))
            last = place_of(share, step)[1]
            ends = through & (clear | last)
            pushing = deep & ((slots >= slot) | begins)
            which = jnp.argmax(pushing, axis=0).astype(jnp.int32)
            one = pushing & (slots == which) & busy & ~through
            depth = jnp.sum(jnp.where(one, world.skins - distance, 0.0), axis=0)
            along = tuple(jnp.sum(jnp.where(one, part, 0.0), axis=0) for part in normal)
            point = tuple(x + depth * n for x, n in zip(point, along, strict=True))
            retreats = busy & through & ~ends
            share, step = select(retreats, (share - step, 2.0 * step), (share, step))
            point = select(retreats, place_of(share, step)[0], point)
            slot = jnp.where(retreats, self._shapes.count, which + 1)
            rounds = jnp.where(retreats, 0, rounds)
            is_out = jnp.where(ends & busy, clear, is_out)
            return point, slot, rounds, share, step, is_out, busy & ~ends

        none = jnp.zeros(asked.shape, jnp.int32)
        begun = place_of(share, step)[0], none + self._shapes.count, none, share, step
        end, *_, is_out, _ = while_busy(push, (*begun, jnp.zeros_like(asked), asked))
        return end, is_out

    def _follow(
        self, world: World, point: Any, way: Any, asked: Array, in_skin: Any = False
    ) -> tuple[Any, Array, Array]:
        """``contact._follow``: the end of a robot that slides, or stops.

        A robot ``in_skin`` is first pushed out of it. Also returns whether that has room, and the
        fraction of the first leg.
        """

        def go(now: Any) -> Any:
            start, leg, left, legs, has_room, first, busy = now
            _, fraction = self._first_contact(world, start, leg, self._tolerances.depth)

            def place(share: Any) -> Any:
                return _add(start, _scaled(leg, share))

            begins = legs < 0  # to move out of a skin
            share = jnp.where(begins, 0.0, jnp.minimum(fraction, 1.0))
            end, is_out = self._settle(world, start, place, share, norm_of(leg), busy)
            has_room = has_room & ~(busy & begins & ~is_out)
            first = jnp.where(legs == 0, fraction, first)
            start, legs = select(busy, end, start), legs + 1
            goes_on = (fraction < 1.0) & (legs < _MAX_LEGS) & (self._mode != STOP)
            busy = busy & has_room & (begins | goes_on)
            if self._mode != STOP:
                left = left * (1.0 - share)
                along = _scaled(self._free_part(world, way, start, busy), left)
                leg = select(begins, leg, along)
            return start, leg, left, legs, has_room, first, busy

        legs, yes = jnp.where(in_skin, -1, jnp.zeros(asked.shape, jnp.int32)), asked | True
        begun = point, way, jnp.ones_like(way[0]), legs, yes, jnp.full_like(way[0], jnp.inf), asked
        if self._bounded:
            last = jax.lax.fori_loop(0, _MAX_LEGS + 1, lambda _, now: go(now), begun)
        else:
            last = jax.lax.while_loop(lambda now: jnp.any(now[-1]), go, begun)
        end, *_, has_room, first, _ = last
        return end, has_room, first

    def _is_held(self, world: World, point: Any, executed: Any, way: Any) -> Array:
        moves = _dot(way, way) > 0.0
        share = jnp.where(moves, divided(norm_of(executed), norm_of(way)), 1.0)
        end, depth = _add(point, executed), self._tolerances.depth
        near = self._shapes.within(world, end, depth)
        near &= self._shapes.distances(world, end) < world.skins + depth
        touched = jnp.sum(jnp.where(near, jnp.where(world.skins > 0.0, 2, 1), 0), axis=0)
        return (share < 1e-3) | ((share < 0.5) & (touched > 1))

    def _free_part(self, world: World, velocity: Any, point: Any, asked: Array) -> Any:
        """``contact.free_part``: the longest projection that enters no touched obstacle."""
        reach = jnp.where(
            world.skins > 0.0, world.skins + self._tolerances.touched_skin, self._tolerances.depth
        )
        distance, normal = self._shapes.surface(world, point)
        touched = asked & (distance < reach)
        each = self._shapes.normals(world, point, normal)

        def is_free(candidate: Any) -> Array:
            """True where velocities (*lanes), or (K, *lanes), enter no obstacle."""
            rounding, axis = self._tolerances.into * norm_of(candidate), candidate[0].ndim - 1
            candidate = tuple(jnp.expand_dims(part, axis) for part in candidate)
            along = jnp.stack([_dot(candidate, normals) for normals in each])
            enters = jnp.max(along, axis=0) < -jnp.expand_dims(rounding, axis)
            return ~jnp.any(touched & enters, axis=axis)

        def longest_of(candidates: Any, exist: Array, best: Any) -> Any:
            """The first of the longest free candidates (K, *lanes), if longer than the best."""
            length = _dot(candidates, candidates)
            length = jnp.where(exist & is_free(candidates), length, 0.0)
            first = jnp.argmax(length, axis=0)
            mine = jnp.arange(len(length)).reshape(-1, *[1] * first.ndim) == first
            chosen = tuple(jnp.sum(jnp.where(mine, part, 0.0), axis=0) for part in candidates)
            return select(jnp.max(length, axis=0) > _dot(best, best), chosen, best)

        def onto_plane(n: Any) -> Any:
            return _subtract(velocity, _scaled(n, _dot(velocity, n)))

        def face(m: Any, n: Any) -> Any:
            """``contact._onto_face``: onto a plane, or the line in which two planes meet."""
            line = array_form(cross)(m, n)
            squared = _dot(line, line)
            onto_line = _scaled(line, divided(_dot(velocity, line), squared))
            return select(squared < self._tolerances.parallel, onto_plane(n), onto_line)

        none = (jnp.zeros_like(velocity[0]),) * self._shapes.dim
        if self._shapes.dim == 2:  # two planes leave no direction in the plane
            kept = each[:1] if each[0] is each[1] else each
            faces = [onto_plane(normals) for normals in kept]
            best = longest_of(
                tuple(jnp.stack(parts, axis=1).reshape(-1, *touched.shape[1:])
                      for parts in zip(*faces, strict=True)),
                jnp.repeat(touched, len(kept), axis=0),
                none,
            )  # fmt: skip
        else:
            slots = jnp.arange(self._shapes.count).reshape(-1, 1)

            def meet(i: Any, best: Any) -> Any:
                plane = tuple(part[i] for part in each[0])
                exist = touched & touched[i] & (slots >= i)
                return longest_of(face(plane, each[0]), exist, best)

            best = jax.lax.fori_loop(0, self._shapes.count, meet, none)
        return select(is_free(velocity), velocity, best)

    def _time_of_contact(self, world: World, point: Any, curve: Any, asked: Array) -> Array:
        """``_first_contact_on_curve``, with its gradient where gradients pass.

        A time t of contact satisfies g(t) = −depth, g the distance to the obstacles; hence
        dt = −dg/ġ.
        """
        if not self._bounded:
            return self._first_contact_on_curve(world, point, curve, asked)
        fixed = self._constant((world, point, curve[1:]))
        kept = fixed[0], fixed[1], (curve[0], *fixed[2])
        found = self._first_contact_on_curve(*kept, asked)
        met = found <= curve[0].duration
        time = jnp.where(met, found, 0.0)

        def gap(world: World, point: Any, curve: Any, time: Array) -> Array:
            there = _add(point, self._displacement(curve, time))
            return jnp.min(self._shapes.distances(world, there) - world.skins, axis=0)

        _, rate = jax.jvp(lambda now: gap(*kept, now), (time,), (jnp.ones_like(time),))
        apart = gap(world, point, curve, time)
        change = divided(self._constant(apart) - apart, self._constant(rate))
        return jnp.where(met, time + change, found)

    def _first_contact_on_curve(self, world: World, point: Any, curve: Any, asked: Array) -> Array:
        """``contact._first_contact_on_curve``: the time until contact, s, or inf."""
        model, action, _, memory = curve
        bent = array_form(chord_error_bound)(model, action, memory)
        closes = array_form(period)(model, action, memory)
        duration = jnp.broadcast_to(jnp.minimum(model.duration, closes), asked.shape)
        work = 1 + sum(1 + corners for corners in self._shapes.corners)
        most = max(_LEAST_CHORDS, min(_MOST_CHORDS, _MOST_WORK // work))
        depth = self._tolerances.depth

        def advance(now: Any) -> Any:
            here, time, piece, found, chords, busy = now
            end = jnp.minimum(duration, time + piece)
            there = _add(point, self._displacement(curve, end))
            sagitta = bent * (end - time) ** 2
            _, fraction = self._first_contact(world, here, _subtract(there, here), depth - sagitta)
            clear, precise = fraction > 1.0, sagitta <= _CHORD_TOLERANCE
            arrives, touches = clear & (end >= duration), ~clear & precise
            found = jnp.where(busy & arrives, jnp.inf, found)
            at = time + jnp.minimum(fraction, 1.0) * (end - time)
            found = jnp.where(busy & touches, at, found)
            piece = jnp.where(clear, 2.0 * piece, 0.5 * (end - time))
            goes_on = busy & clear & ~arrives
            time, here = jnp.where(goes_on, end, time), select(goes_on, there, here)
            busy = busy & ~arrives & ~touches & (chords + 1 < most)
            found = jnp.where(goes_on & ~busy, time, found)
            return here, time, piece, found, chords + 1, busy

        zero = jnp.zeros_like(duration)
        none = jnp.full_like(duration, jnp.inf)
        begun = point, zero, duration, none, jnp.zeros(asked.shape, jnp.int32), asked
        return while_busy(advance, begun)[3]


class ObstacleContact:
    """Motion of the robots of environments among obstacles.

    Args:
        fields: the obstacles.
        model: constants of the robot model.
        mode: SLIDE or STOP.
        every: whether all robots are computed, rather than those near an obstacle, a few at a time.
    """

    def __init__(self, fields: Fields, model: Any, mode: int, every: bool) -> None:
        self._fields, self._model, self._every = fields, model, every
        self._contact = Contact(fields.shapes, mode, every)
        self.outcome = STOPPED if mode == STOP else SLID
        """Contact of robots that meet an obstacle, for ``Motion.update``."""
        self.margin = 3.0 * fields.shapes.tolerances.depth
        """More than a skin, m: contact is possible on paths longer than the clearance less this."""

    def __call__(
        self, obstacles: Any, near: Array, positions: Array, ways: Array, curve: Any
    ) -> tuple[Array, Array]:
        """Displacements (n, d, *batch), m, that obstacles allow, and contacts (n, *batch).

        ``curve`` is the action, frame and memory, tuples of (n, *batch), of robots that are
        ``near`` (n, *batch) an obstacle.
        """
        n, d = positions.shape[:2]
        shape = near.shape
        count = near.size // n

        def lanes(values: Any) -> Any:
            return [value.reshape(-1) for value in values]

        def rows(values: Array) -> Array:
            return jnp.stack([values[:, k].reshape(-1) for k in range(d)])

        given = {
            "point": rows(positions), "way": rows(ways), "curve": [lanes(part) for part in curve],
            "environment": jnp.arange(near.size, dtype=jnp.uint32) % count,
        }  # fmt: skip

        def stop(given: Any) -> Any:
            return self._stop(self._world_of(obstacles, given["environment"]), given)

        otherwise = given["way"], jnp.zeros(near.size, bool)
        moved, contact = for_envs(near.reshape(-1), stop, given, otherwise, self._every)
        moved = jnp.stack([part.reshape(shape) for part in moved], axis=1)
        return moved, contact.reshape(shape)

    def _world_of(self, obstacles: Any, environment: Array) -> World:
        """Obstacles of lanes, which belong to these environments."""
        if self._fields.fixed is not None:
            return self._fields.world(None, 1)

        if obstacles.present.ndim == 1:  # one environment
            world = jax.tree.map(lambda values: values[..., None], obstacles)
        else:
            world = jax.tree.map(
                lambda values: jnp.take(values, environment, axis=-1, mode="clip"), obstacles
            )
        return self._fields.shapes.with_edges(world)

    def _stop(self, world: World, given: Any) -> Any:
        point, way = tuple(given["point"]), tuple(given["way"])
        action, frame, memory = (tuple(part) for part in given["curve"])
        if memory:
            curve = self._model, action, frame, memory
            met, executed = self._contact.move_curved(world, point, way, curve)
        else:
            met, executed = self._contact.move_straight(world, point, way)
        return jnp.stack(executed), met
