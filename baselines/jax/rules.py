"""Rules for obstacles over arrays: tangent-merged-tuned and tank-merged."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.jax.filters.tank import Tank
from rendezvous_env.jax.laws import flexible_velocity
from rendezvous_env.physics.vectors import combine, cross, dot, norm, perpendicular, rotated, split
from rendezvous_env.safety.heading import certify_one, turn_limit
from rendezvous_env.safety.tank import EnergyTank, certain_descent
from rendezvous_env.safety.turning import mean_axis, robot_of

from ..obstacle_rules import tank_policies
from ..obstacle_rules.merged_intervals_2d import TWO_PI
from ..obstacle_rules.obstacle_avoidance import TunedMergedPolicy
from ..obstacle_rules.tank_policies import TankMergedPolicy
from . import steering
from .arrays import Array, angle_of, parts_of, select, where
from .filters import TeamFilter, account_of, gain_of, spend
from .merged_intervals import MergedInterval, direction_of, merged_headings, merged_interval
from .planes import axis_is_clear, cut_by, headings_in_planes, kept_azimuth, widened_cones
from .policy import (
    JaxPolicy,
    Memory,
    Rows,
    degree_of,
    register,
    scale_of,
    sum_of,
    within_limits,
)

_combine, _cross, _dot, _rotated = map(array_form, (combine, cross, dot, rotated))


class _Course(NamedTuple):
    """Memory of the tuned rule; () where robots need none."""

    headings: Array  # (..., n, d)
    asides: Any  # (..., n, 3), across f in the kept planes of 3-D
    sent: Any  # (..., n, a), the last actions of robots that turn


@dataclass(frozen=True)
class TunedMerged(JaxPolicy):
    """As ``TunedMergedPolicy``: merged intervals, a committed side, certified headings."""

    clearance: float  # rad
    persistence: float
    min_alignment: float  # ε
    max_turn_rate: float  # rad/s

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """No headings."""
        scenario, turns = self.scenario, self.scenario.model.nonholonomic
        robots = *batch, scenario.n_robots
        headings = jnp.zeros((*robots, scenario.dim), jnp.result_type(float))
        sent = jnp.zeros((*robots, scenario.action_size), jnp.float32) if turns else ()
        return _Course(headings, headings if scenario.dim == 3 else (), sent)

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen, scenario = self.rows_of(observations), self.scenario
        turns, gate = scenario.model.nonholonomic, robot_of(scenario).gate
        pitch = steering.pitch_of(seen, gate)
        if turns:
            headings, asides = jax.tree.map(
                lambda vectors: steering.turned(vectors, memory.sent, pitch, gate), memory[:2]
            )
            memory = _Course(headings, asides, memory.sent)
        net = sum_of(seen)
        f, carried = parts_of(net), parts_of(memory.headings)
        raw, asides = self._aim(f, seen, carried, memory.asides)
        limit = array_form(turn_limit)(self.max_turn_rate * scenario.tau)
        dead_zone = scenario.dead_zone or 1.0
        h = array_form(certify_one)(raw, f, carried, self.min_alignment, dead_zone, limit)
        h = jnp.stack(h, axis=-1)
        velocity = scale_of(degree_of(seen), scenario)[..., None] * flexible_velocity(net, h)
        if not turns:
            return within_limits(velocity, scenario), _Course(h, asides, ())
        sent = steering.steered(parts_of(velocity), seen, pitch, gate, scenario)
        return sent, _Course(h, asides, sent)

    def _aim(self, f: Any, seen: Rows, carried: Any, asides: Any) -> tuple[Any, Any]:
        """Vectors to certify, and in 3-D what is across f in their planes."""
        if self.scenario.dim == 2:
            rule = self.clearance, carried, self.persistence
            return merged_headings(direction_of(f), seen.obstacles, *rule), ()
        limits = self.clearance, self.persistence
        raw, across = headings_in_planes(f, seen.obstacles, limits, carried, parts_of(asides))
        return raw, jnp.stack(across, axis=-1)


@register("tangent-merged-tuned")
def _tuned(policy: TunedMergedPolicy) -> JaxPolicy:
    limits = policy.min_alignment, policy.max_turn_rate
    return TunedMerged(policy.scenario, policy._clearance, policy._persistence, *limits)


class _Walls(NamedTuple):
    """Memory of the tank rule, see ``tank_policies``; arrays (..., n), headings (..., n, d)."""

    tank: Any  # A, m²/s; state of the filter for robots that turn
    side: Array
    work: Array  # m²/s
    patience: Array  # m
    short: Array  # bool
    headings: Array
    asides: Any  # (..., n, 3) in 3-D, else ()


class _Way(NamedTuple):
    """Where a robot is to go."""

    free: Array  # whether any direction is
    heading: Any
    towards: Any  # f/‖f‖
    aside: Any  # across it
    cones: Any  # of obstacles in 3-D, widened


@dataclass(frozen=True)
class TankMerged(JaxPolicy):
    """As ``TankMergedPolicy``: wall following under an energy tank."""

    budget: float  # m²/s
    min_alignment: float  # ε
    settings: tank_policies._Settings

    @property
    def _turns(self) -> bool:
        return self.settings.robot.turns

    @cached_property
    def _tank(self) -> TeamFilter:
        """The tank of robots that turn."""
        given: dict[str, Any] = {
            "budget": self.budget,
            "min_alignment": self.min_alignment,
            "frame": "local",
        }
        return TeamFilter(Tank(EnergyTank(self.scenario, 1, **given), jnp.float32), self.scenario)

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """Full tanks, no walls."""
        zero = jnp.zeros((*batch, self.scenario.n_robots), jnp.result_type(float))
        vectors = jnp.zeros((*zero.shape, self.scenario.dim), zero.dtype)
        tank = self._tank.begin(batch) if self._turns else zero + self.budget
        first, none = zero + self.settings.patience, zero.astype(bool)
        asides = vectors if self.scenario.dim == 3 else ()
        return _Walls(tank, zero, zero, first, none, vectors, asides)

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen, settings, robot = self.rows_of(observations), self.settings, self.settings.robot
        f, before = parts_of(sum_of(seen)), parts_of(memory.headings)
        account = account_of(f, degree_of(seen), robot)
        spent = memory.short | (memory.work < -memory.patience * account.strength)
        if robot.turns:  # it has still to turn on the spot
            spent &= before[0] >= math.cos(settings.aligned)
        way, walls = self._way(f, before, spent, seen.obstacles, memory)
        if robot.turns:
            return self._drive(observations, seen, account, way, walls, memory)
        velocity, short = self._affordable(way, account, memory.tank, robot)
        lost = account.strength == 0.0
        desired = tuple(jnp.where(lost, 0.0, part) for part in velocity)
        sent, levels = spend(desired, account, memory.tank, robot)
        walls = walls._replace(
            tank=levels, short=short, work=walls.work + self.scenario.tau * _dot(f, sent)
        )
        after = _unless(lost, walls, memory._replace(tank=levels, short=jnp.zeros_like(short)))
        return within_limits(jnp.stack(sent, axis=-1), self.scenario), after

    def _drive(
        self, observations: Any, seen: Rows, account: Any, way: _Way, walls: _Walls, memory: _Walls
    ) -> tuple[Array, _Walls]:
        """Actions and memory of robots that turn: towards the heading, where the axis is clear."""
        robot, gate, tau = self.settings.robot, self.settings.robot.gate, self.scenario.tau
        pitch, lost = steering.pitch_of(seen, gate), account.strength == 0.0
        speed = account.strength * account.scale
        wanted = steering.padded(tuple(speed * part for part in way.heading))
        speed, rates = steering.inputs_towards(wanted, pitch, gate, self.settings.aligned)
        m = array_form(mean_axis)(rates, pitch, gate)
        moved, f = tuple(part * speed * gate.duration for part in m), steering.padded(account.f)
        left = array_form(certain_descent)(f, account.degree, moved, robot.merge_radius)
        stops = ~way.free | (memory.tank.levels + left < self.settings.rounding)
        short = stops & (speed > 0.0)
        if way.cones is None:
            clear = steering.axis_is_clear(rates, seen.obstacles, gate)
        else:
            clear = axis_is_clear(rates, pitch, way.cones, gate)
        desired = jnp.where(stops | ~clear, 0.0, speed), *rates[: 1 if gate.planar else 2]
        choices = jnp.stack([jnp.where(lost, 0.0, part) for part in desired], axis=-1)
        choices /= jnp.asarray(self.scenario.action_bounds, choices.dtype)
        sent, tank = self._tank.apply(observations, choices, memory.tank)
        velocity = steering.velocities(sent, pitch, gate)
        toil = tank_policies._TOIL * account.strength * array_form(norm)(velocity)
        walls = _unless(lost, walls, memory)
        after = walls._replace(
            tank=tank, short=short & ~lost, work=walls.work + tau * (_dot(f, velocity) - toil)
        )
        headings, asides = jax.tree.map(
            lambda vectors: steering.turned(vectors, sent, pitch, gate), after[-2:]
        )
        return sent, after._replace(headings=headings, asides=asides)

    def _way(
        self, f: Any, before: Any, spent: Array, silhouettes: Array, memory: _Walls
    ) -> tuple[_Way, _Walls]:
        """Way past the obstacles, and memory; in 3-D that of ``tank_policies._way_in_space``."""
        towards = array_form(split)(f)[1]
        if len(f) == 2:
            free, turn, walls = self._turn(towards, before, spent, silhouettes, memory)
            heading = _rotated(towards, turn)[:2]
            way = _Way(free, heading, towards, array_form(perpendicular)(towards), None)
            return way, walls._replace(headings=jnp.stack(heading, axis=-1))
        cones, held = widened_cones(silhouettes, self.settings.clearance), memory.side
        keeps = jnp.where(held != 0.0, TWO_PI, 0.0)
        before_f = parts_of(memory.asides)
        aside, kept = kept_azimuth(towards, before_f, keeps, self.settings.clearance, cones)
        held = jnp.where((held != 0.0) & ~kept, 1.0, held)
        within = jnp.stack([_dot(before, axis) for axis in (towards, aside)])
        cut = cut_by(towards, aside, cones)
        ahead = jnp.ones_like(held), jnp.zeros_like(held)
        free, turn, walls = self._turn(ahead, tuple(within), spent, cut, memory._replace(side=held))
        heading = _combine(jnp.cos(turn), towards, jnp.sin(turn), aside)
        # the next azimuth once both of this plane have been tried
        both = (held < 0.0) & (walls.side > 0.0)
        following = select(both, _cross(towards, aside), aside)
        following = [jnp.where(walls.side != 0.0, part, 0.0) for part in following]
        walls = walls._replace(
            headings=jnp.stack(heading, axis=-1), asides=jnp.stack(following, axis=-1)
        )
        return _Way(free, heading, towards, aside, cones), walls

    def _turn(
        self, towards: Any, before: Any, spent: Array, silhouettes: Array, memory: _Walls
    ) -> tuple[Array, Array, _Walls]:
        """``tank_policies._turn``: whether a direction is free, the turn from f, and memory."""
        joined, held = merged_interval(towards, silhouettes), memory.side
        low, high, settings = joined.low, joined.high, self.settings
        clear = ~joined.closed & ((low >= settings.clearance) | (high <= -settings.clearance))
        wall = ~joined.closed & ~clear
        joined = MergedInterval(*(jnp.where(wall, part, 0.0) for part in joined))
        nearer = jnp.where(jnp.abs(joined.high) <= jnp.abs(joined.low), 1.0, -1.0)
        turned = jnp.where(spent, -held, held)
        side = jnp.where(wall, jnp.where(held == 0.0, nearer, turned), 0.0)
        most = tank_policies._LARGEST_PATIENCE * settings.patience
        more = jnp.minimum(2.0 * memory.patience, most)
        patience = jnp.where(wall & (held != 0.0) & spent, more, memory.patience)
        patience = jnp.where(clear & (memory.work >= 0.0), settings.patience, patience)
        work = jnp.where(wall & (held == 0.0), 0.0, memory.work)
        ahead = array_form(perpendicular)(towards)
        kept = angle_of(_dot(ahead, before), _dot(towards, before))
        edge, gap = _edge(joined, side)
        apart = edge - kept
        apart = apart - TWO_PI * jnp.floor((apart + 0.5 * TWO_PI) / TWO_PI)
        jumps = wall & (held == side) & (jnp.abs(apart) > tank_policies._JUMP)
        along = self._along_wall(towards, kept, (edge, gap), silhouettes, side)
        edge, gap = select(jumps, along, (edge, gap))
        turn = jnp.where(wall, edge + side * jnp.minimum(settings.clearance, 0.5 * gap), 0.0)
        kept_side = jnp.where(merged_closed := ~clear & ~wall, held, side)
        return ~merged_closed, turn, memory._replace(side=kept_side, work=work, patience=patience)

    def _along_wall(
        self, towards: Any, kept: Array, otherwise: Any, silhouettes: Array, side: Array
    ) -> Any:
        """``tank_policies._along_wall``: the edge of the wall next to the heading, and the gap."""
        feeler = kept - side * tank_policies._BEHIND_EDGE * self.settings.clearance
        felt = merged_interval(_rotated(towards, feeler)[:2], silhouettes)
        (nearest, beyond), (other, before) = _edge(felt, side), _edge(felt, -side)
        far = side * other > 0.0
        nearest = jnp.where(far, other - side * before, nearest)
        beyond = jnp.where(far, before, beyond)
        unfit = felt.closed | (side * nearest < -tank_policies._LOST)
        return select(unfit, otherwise, (feeler + nearest, beyond))

    def _affordable(self, way: _Way, account: Any, levels: Array, robot: Any) -> tuple[Any, Array]:
        """``tank_policies._affordable``: the velocity, and whether the tank is too low for it."""
        margin, duration = self.min_alignment, robot.gate.duration
        speed = account.scale * account.strength
        whole = tuple(speed * part for part in way.heading)
        gain = gain_of(account, tuple(part * duration for part in whole), robot)
        reserve = account.owed * tank_policies._REST_TIME / duration
        enough = way.free & ((gain >= 0.0) | (levels + gain >= reserve))
        away = jnp.where(_dot(way.aside, way.heading) < 0.0, -1.0, 1.0)
        across = speed * (1.0 - margin * margin) ** 0.5 * away
        slow = _combine(speed * margin, way.towards, across, way.aside)
        rest = tuple(jnp.zeros_like(part) for part in slow)
        velocity = select(enough, whole, select(levels >= account.owed, rest, slow))
        return velocity, ~enough


def _unless(lost: Array, after: _Walls, before: _Walls) -> _Walls:
    """Memory after a step, or before it of robots without a net bearing; tanks as after."""
    return where(lost, before, after)


def _edge(joined: MergedInterval, side: Array) -> tuple[Array, Array]:
    """Edge of a merged interval on a side, and the free angle beyond it, rad."""
    upper = side > 0.0
    edge = jnp.where(upper, joined.high, joined.low)
    return edge, jnp.where(upper, joined.gap_above, joined.gap_below)


@register("tank-merged")
def _tank(policy: TankMergedPolicy) -> JaxPolicy:
    return TankMerged(policy.scenario, policy.budget, policy._margin, policy._settings)
