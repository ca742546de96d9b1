"""Rules for obstacles in the plane over arrays: tangent-merged-tuned and tank-merged."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.jax.laws import flexible_velocity
from rendezvous_env.physics.vectors import combine, dot, perpendicular, rotated, split
from rendezvous_env.safety.heading import certify_one, turn_limit
from rendezvous_env.safety.turning import robot_of

from ..obstacle_rules import tank_policies
from ..obstacle_rules.merged_intervals_2d import TWO_PI
from ..obstacle_rules.obstacle_avoidance import TunedMergedPolicy
from ..obstacle_rules.tank_policies import TankMergedPolicy
from .arrays import Array, angle_of, parts_of, select
from .merged_intervals import MergedInterval, direction_of, merged_headings, merged_interval
from .policy import (
    JaxPolicy,
    Memory,
    check_in_plane,
    degree_of,
    register,
    scale_of,
    sum_of,
    within_limits,
)
from .tank import account_of, gain_of, spend

_combine, _dot, _rotated = map(array_form, (combine, dot, rotated))


@dataclass(frozen=True)
class TunedMerged(JaxPolicy):
    """As ``TunedMergedPolicy``: merged intervals, a committed side, certified headings."""

    clearance: float  # rad
    persistence: float
    min_alignment: float  # ε
    max_turn_rate: float  # rad/s

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """No headings, (..., n, 2)."""
        return jnp.zeros((*batch, self.scenario.n_robots, 2), jnp.result_type(float))

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen, scenario = self.rows_of(observations), self.scenario
        net = sum_of(seen)
        f, carried = parts_of(net), parts_of(memory)
        raw = merged_headings(
            direction_of(f), seen.obstacles, self.clearance, carried, self.persistence
        )
        limit = array_form(turn_limit)(self.max_turn_rate * scenario.tau)
        dead_zone = scenario.dead_zone or 1.0
        h = array_form(certify_one)(raw, f, carried, self.min_alignment, dead_zone, limit)
        h = jnp.stack(h, axis=-1)
        velocity = scale_of(degree_of(seen), scenario)[..., None] * flexible_velocity(net, h)
        return within_limits(velocity, scenario), h


@register("tangent-merged-tuned")
def _tuned(policy: TunedMergedPolicy) -> JaxPolicy:
    check_in_plane("tangent-merged-tuned", policy.scenario)
    limits = policy.min_alignment, policy.max_turn_rate
    return TunedMerged(policy.scenario, policy._clearance, policy._persistence, *limits)


class _Walls(NamedTuple):
    """Memory of the tank rule, see ``tank_policies``; arrays (..., n), headings (..., n, 2)."""

    levels: Array  # A, m²/s
    side: Array
    work: Array  # m²/s
    patience: Array  # m
    short: Array  # bool
    headings: Array


@dataclass(frozen=True)
class TankMerged(JaxPolicy):
    """As ``TankMergedPolicy``: wall following under an energy tank."""

    budget: float  # m²/s
    min_alignment: float  # ε
    clearance: float  # rad
    patience: float  # m

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """Full tanks, no walls."""
        zero = jnp.zeros((*batch, self.scenario.n_robots), jnp.result_type(float))
        headings = jnp.zeros((*zero.shape, 2), zero.dtype)
        first, none = zero + self.patience, zero.astype(bool)
        return _Walls(zero + self.budget, zero, zero, first, none, headings)

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen, robot = self.rows_of(observations), robot_of(self.scenario, self.min_alignment)
        f, before = parts_of(sum_of(seen)), parts_of(memory.headings)
        account = account_of(f, degree_of(seen), robot)
        towards = array_form(split)(f)[1]
        spent = memory.short | (memory.work < -memory.patience * account.strength)
        free, turn, walls = self._turn(towards, before, spent, seen.obstacles, memory)
        heading = _rotated(towards, turn)[:2]
        velocity, short = self._affordable(towards, heading, free, account, memory.levels, robot)
        lost = account.strength == 0.0
        desired = tuple(jnp.where(lost, 0.0, part) for part in velocity)
        sent, levels = spend(desired, account, memory.levels, robot)
        work = jnp.where(lost, memory.work, walls.work) + self.scenario.tau * _dot(f, sent)
        after = _Walls(
            levels,
            jnp.where(lost, memory.side, walls.side),
            work,
            jnp.where(lost, memory.patience, walls.patience),
            short & ~lost,
            jnp.where(lost[..., None], memory.headings, jnp.stack(heading, axis=-1)),
        )
        return within_limits(jnp.stack(sent, axis=-1), self.scenario), after

    def _turn(
        self, towards: Any, before: Any, spent: Array, silhouettes: Array, memory: _Walls
    ) -> tuple[Array, Array, _Walls]:
        """``tank_policies._turn``: whether a direction is free, the turn from f, and memory."""
        joined, held = merged_interval(towards, silhouettes), memory.side
        low, high = joined.low, joined.high
        clear = ~joined.closed & ((low >= self.clearance) | (high <= -self.clearance))
        wall = ~joined.closed & ~clear
        joined = MergedInterval(*(jnp.where(wall, part, 0.0) for part in joined))
        nearer = jnp.where(jnp.abs(joined.high) <= jnp.abs(joined.low), 1.0, -1.0)
        turned = jnp.where(spent, -held, held)
        side = jnp.where(wall, jnp.where(held == 0.0, nearer, turned), 0.0)
        more = jnp.minimum(2.0 * memory.patience, tank_policies._LARGEST_PATIENCE * self.patience)
        patience = jnp.where(wall & (held != 0.0) & spent, more, memory.patience)
        patience = jnp.where(clear & (memory.work >= 0.0), self.patience, patience)
        work = jnp.where(wall & (held == 0.0), 0.0, memory.work)
        ahead = array_form(perpendicular)(towards)
        kept = angle_of(_dot(ahead, before), _dot(towards, before))
        edge, gap = _edge(joined, side)
        apart = edge - kept
        apart = apart - TWO_PI * jnp.floor((apart + 0.5 * TWO_PI) / TWO_PI)
        jumps = wall & (held == side) & (jnp.abs(apart) > tank_policies._JUMP)
        along = self._along_wall(towards, kept, (edge, gap), silhouettes, side)
        edge, gap = select(jumps, along, (edge, gap))
        turn = jnp.where(wall, edge + side * jnp.minimum(self.clearance, 0.5 * gap), 0.0)
        kept_side = jnp.where(merged_closed := ~clear & ~wall, held, side)
        return ~merged_closed, turn, memory._replace(side=kept_side, work=work, patience=patience)

    def _along_wall(
        self, towards: Any, kept: Array, otherwise: Any, silhouettes: Array, side: Array
    ) -> Any:
        """``tank_policies._along_wall``: the edge of the wall next to the heading, and the gap."""
        feeler = kept - side * tank_policies._BEHIND_EDGE * self.clearance
        felt = merged_interval(_rotated(towards, feeler)[:2], silhouettes)
        (nearest, beyond), (other, before) = _edge(felt, side), _edge(felt, -side)
        far = side * other > 0.0
        nearest = jnp.where(far, other - side * before, nearest)
        beyond = jnp.where(far, before, beyond)
        unfit = felt.closed | (side * nearest < -tank_policies._LOST)
        return select(unfit, otherwise, (feeler + nearest, beyond))

    def _affordable(
        self, towards: Any, heading: Any, free: Array, account: Any, levels: Array, robot: Any
    ) -> tuple[Any, Array]:
        """``tank_policies._affordable``: the velocity, and whether the tank is too low for it."""
        margin, duration = self.min_alignment, robot.gate.duration
        speed = account.scale * account.strength
        whole = tuple(speed * part for part in heading)
        gain = gain_of(account, tuple(part * duration for part in whole), robot)
        reserve = account.owed * tank_policies._REST_TIME / duration
        enough = free & ((gain >= 0.0) | (levels + gain >= reserve))
        aside = array_form(perpendicular)(towards)
        away = jnp.where(_dot(aside, heading) < 0.0, -1.0, 1.0)
        across = speed * (1.0 - margin * margin) ** 0.5 * away
        slow = _combine(speed * margin, towards, across, aside)
        rest = tuple(jnp.zeros_like(part) for part in slow)
        velocity = select(enough, whole, select(levels >= account.owed, rest, slow))
        return velocity, ~enough


def _edge(joined: MergedInterval, side: Array) -> tuple[Array, Array]:
    """Edge of a merged interval on a side, and the free angle beyond it, rad."""
    upper = side > 0.0
    edge = jnp.where(upper, joined.high, joined.low)
    return edge, jnp.where(upper, joined.gap_above, joined.gap_below)


@register("tank-merged")
def _tank(policy: TankMergedPolicy) -> JaxPolicy:
    check_in_plane("tank-merged", policy.scenario)
    settings = policy._settings
    return TankMerged(
        policy.scenario, policy.budget, policy._margin, settings.clearance, settings.patience
    )
