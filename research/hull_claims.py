"""Claims about the size L of a team, and what follows from it (guarantees 9, 10, 11 and 13)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from time_bounds import gains_time

from baselines.laws.pursuit import Pursuit
from rendezvous_env import Scenario, Simulator, graphs
from rendezvous_env.safety.gains import Gains
from rendezvous_env.safety.theorems.gains import size_bound
from rendezvous_env.safety.theorems.noise import held_size_bound
from rendezvous_env.safety.theorems.turning import pursuit_bound
from rendezvous_env.trajectory import Policy, Step
from train.verify.adversaries import by_name, certified, unit
from train.verify.cases import Case, draw_case
from train.verify.claim import (
    Array,
    Claim,
    Mask,
    Watch,
    as_chosen,
    by_law_1,
    falls,
    keeps,
    meets,
    no_rise,
)
from train.verify.falsification import directions, extents
from train.verify.paper_claims import bound_a, bound_c

_DRIVING = (0.4, 0.8)
"""Speed of a pursuer over ω_max r/2."""
_TURN_IN_A_STEP = 0.05
"""That a pursuer turns through at most, rad."""


def draw_uniform(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Complete graphs of one weight: every pair can dock, and has a row of its own."""
    return _complete(draw_case(random, batch, least_margin), random)


def draw_followed(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Steps that come near to continuous time."""
    return draw_case(random, batch, least_margin, step_factors=(0.2, 1.0))


def draw_held(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Complete graphs and cycles of one weight, with a step that theorem N covers."""
    scenario = _complete(
        draw_case(random, batch, least_margin, speed_limits=False), random
    ).scenario
    n = scenario.n_robots
    if n > 2 and random.random() < 0.5:
        scenario = scenario.replace(graph=graphs.cycle(scenario.bottleneck_weight))
    most = math.pi / n if scenario.dim == 2 or n == 2 else math.atan(1 / math.sqrt(n * (n - 2)))
    error = random.uniform(0.3, 0.9) * most
    step = scenario.merge_radius * math.sin(error) / (2.0 * scenario.max_degree)
    return Case(scenario.replace(time_step=step), 1.0)


def draw_pursuers(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Unicycles or 3-D robots that know their neighbours apart, on any graph."""
    dim = int(random.choice([2, 3]))
    model = "unicycle" if dim == 2 else "nonholonomic_3d"
    scenario = draw_case(random, batch, least_margin, dims=(dim,), robot_model=model).scenario
    turn = random.uniform(2.0, 6.0)
    return Case(
        scenario.replace(
            max_turn_rate=turn,
            max_speed=random.uniform(*_DRIVING) * turn * scenario.merge_radius / 2.0,
            time_step=_TURN_IN_A_STEP / turn,
            allow_long_step=True,
            neighbour_slots=scenario.n_robots - 1,
        ),
        1.0,
    )


def _complete(case: Case, random: np.random.Generator) -> Case:
    """The same team on a complete graph of one weight."""
    scenario: Scenario = case.scenario
    graph = graphs.complete(random.uniform(0.5, 2.0))
    return Case(scenario.replace(graph=graph), case.margin, case.options)


def pursuit(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Pursuers at the scenario's speed limit; each would rather pursue somebody else."""
    n, rows = case.scenario.n_robots, case.scenario.observation_layout.neighbour_slots
    order = np.argsort(-random.random((num_envs, n, rows)), axis=-1)
    return Pursuit(case.scenario, case.scenario.speed_limit, order)


def what_is_seen(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (1) among robots that hide one another as discs or balls of radius r/2."""
    return Occluded()


class Occluded:
    """ṗ_i = Σ a_ij g_ij over the neighbours j that no nearer robot hides.

    It reads positions, as a stand-in for a sensor that cannot see through robots. Each neighbour
    must have a row of its own.
    """

    def watch(self, teams: Simulator) -> None:
        """Look at these teams."""
        self._teams = teams

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (B, n, d), m/s."""
        scenario = self._teams.scenario
        hidden = self.hides(self._teams.positions, self._teams.active, scenario.merge_radius / 2.0)
        n = scenario.n_robots
        others = ~np.eye(n, dtype=bool)
        visible = ~hidden[:, others].reshape(-1, n, n - 1)
        rows = scenario.observation_layout.split(observations).neighbours
        velocities: NDArray[np.float32] = np.sum(rows * visible[..., None], axis=-2)
        return velocities

    def hides(self, positions: Array, active: Mask, radius: float) -> Mask:
        """(B, n, n): whether robot i cannot see robot j."""
        return hidden_by_robots(positions, active, radius)


def hidden_by_robots(positions: Array, active: Mask, radius: float) -> Mask:
    """Whether a nearer robot stands in the line of sight from robot i to the middle of robot j.

    Args:
        positions: (B, n, d), m.
        active: (B, n), who is there.
        radius: of the robots, m.

    Returns:
        (B, n, n).
    """
    n = positions.shape[1]
    offsets = positions[:, None] - positions[:, :, None]  # [i, j] from i to j
    distance = np.linalg.norm(offsets, axis=-1)
    apart = active[:, None] & active[:, :, None] & ~np.eye(n, dtype=bool)
    bearing = offsets / np.where(distance > 0, distance, 1.0)[..., None]
    cosine = np.einsum("bijd,bikd->bijk", bearing, bearing)
    # the disc of k subtends asin(radius/d_ik) from i
    share = np.minimum(radius / np.where(distance > 0, distance, np.inf), 1.0)
    covers = (cosine > np.sqrt(1.0 - share**2)[:, :, None, :]) & apart[:, :, None, :]
    nearer = distance[:, :, None, :] < distance[:, :, :, None]
    return np.asarray(np.any(covers & nearer, axis=-1))


_FLOAT32 = 2.0**-20
"""Share of a displacement that is lost or won by rounding rows and actions, at most."""


def hull_shrinks(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By what share of L(0) L falls in a step."""
    start = latest = teams.size()

    def look(step: Step) -> Array:
        nonlocal latest
        before, latest = latest, teams.size()
        return (before - latest) / start

    return look


def hull_draws_back(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By what share of L(0) the hull draws back in a step, least over directions all round; what
    rounding of rows and actions to float32 can do is allowed.
    """
    scenario = case.scenario
    along, start = directions(scenario.dim), teams.size()
    latest = extents(teams.positions, teams.active, along)
    rounded = _FLOAT32 * scenario.max_degree * scenario.tau

    def look(step: Step) -> Array:
        nonlocal latest
        before, latest = latest, extents(teams.positions, teams.active, along)
        return np.asarray(((before - latest).min(axis=-1) + rounded) / start)

    return look


def bodies(radius: float) -> Watch:
    """A watch on bodies of a radius, given over r: by what share of r the nearest two are apart
    beyond touching, at any moment of a step.

    Robots that merge in a step are left out of it, being two bodies in one place afterwards.
    """

    def watch(teams: Simulator, case: Case) -> Callable[[Step], Array]:
        places, active = teams.positions, teams.active
        merge_radius = teams.scenario.merge_radius

        def look(step: Step) -> Array:
            nonlocal places, active
            before, places = places, teams.positions
            went, active = active & ~teams.active, teams.active
            into = teams.merged_into
            docked = np.zeros_like(active)
            for team, robot in np.argwhere(went):
                docked[team, into[team, robot]] = True
            nearest = _nearest_in_a_step(before, places, active & ~docked)
            return nearest / merge_radius - 2.0 * radius

        return look

    return watch


bodies_stay_apart = bodies(0.5)
"""Bodies of radius r/2, which all pairs dock at r to spare."""


def _nearest_in_a_step(before: Array, after: Array, counted: Array) -> Array:
    """Least distance of two counted robots that moved on straight lines, (B,), m; inf without
    two.
    """
    offsets = before[:, None] - before[:, :, None]
    moved = (after - before)[:, None] - (after - before)[:, :, None]
    square = np.sum(moved**2, axis=-1)
    along = -np.sum(offsets * moved, axis=-1)
    moment = np.clip(np.divide(along, square, out=np.zeros_like(square), where=square > 0), 0, 1)
    distance = np.linalg.norm(offsets + moment[..., None] * moved, axis=-1)
    pairs = counted[:, None] & counted[:, :, None] & ~np.eye(counted.shape[1], dtype=bool)
    least: Array = np.min(distance, axis=(1, 2), where=pairs, initial=np.inf)
    return least


def weighted(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Any weights of neighbours under theorem G: one neighbour, whoever is most against the rest,
    or drawn anew in every step.
    """
    scenario = case.scenario
    gains, layout = Gains(scenario, num_envs, frame="local"), scenario.observation_layout
    kinds = random.integers(3, size=(num_envs, scenario.n_robots, 1))
    liking = random.random((num_envs, scenario.n_robots, layout.neighbour_slots))

    def policy(observations: NDArray[np.float32], time: Array) -> NDArray[np.float32]:
        rows = layout.split(observations).neighbours.astype(np.float64)
        seen = np.any(rows, axis=-1)
        against = -np.sum(unit(rows) * rows.sum(axis=-2, keepdims=True), axis=-1)
        score = np.where(kinds == 0, liking, against)
        score[~seen] = -np.inf
        one = score == score.max(axis=-1, keepdims=True)
        gains.hold(np.where(kinds == 2, random.random(liking.shape), one))
        return gains.act(observations)

    return policy


def bound_law_1(case: Case, teams: Simulator) -> Array:
    """The smaller of A and G, s; G's is proven in continuous time, and so up to a step a merge."""
    scenario = case.scenario
    followed = size_bound(scenario, teams.size()) + (scenario.n_robots - 1) * scenario.tau
    return np.minimum(bound_a(case, teams), followed)


def bound_held(case: Case, teams: Simulator) -> Array:
    """Of theorem N for held inputs, s."""
    return held_size_bound(case.scenario, teams.size())


def bound_pursuit(case: Case, teams: Simulator) -> Array:
    """Of E2 for pursuers at the speed limit, s."""
    return pursuit_bound(case.scenario, teams.size(), case.scenario.speed_limit)


def bound_gains(case: Case, teams: Simulator) -> Array:
    """Of theorem G where each robot sees at least one other, c = a*, s, up to a step a merge."""
    scenario = case.scenario
    gain = min(scenario.bottleneck_weight, scenario.speed_limit)
    followed = gains_time(scenario.n_robots, scenario.dim, teams.size(), gain)
    return followed + (scenario.n_robots - 1) * scenario.tau


bound_occluded = bound_gains
"""The nearest robot is never hidden."""


_law_1 = by_name("bearing-only")

HULL = (
    Claim(
        "bound-C-uniform",
        "any policy under certified headings, complete graph of one weight: T ≤ V0/(2(n−1)ε²a²)",
        draw_uniform,
        certified,
        bound_c,
        (meets, falls),
        as_chosen,
        timed=True,
    ),
    Claim(
        "theorem-G",
        "law (1): the hull never grows, T ≤ the smaller of A and G",
        draw_followed,
        _law_1,
        bound_law_1,
        (meets, keeps),
        by_law_1,
        timed=True,
        watch=hull_shrinks,
    ),
    Claim(
        "gain-wrapper",
        "any weights of neighbours, a* ≤ Σ_j c_ij ≤ D̄: the hull never grows, T ≤ G with c = a*",
        draw_followed,
        weighted,
        bound_gains,
        (meets, keeps),
        no_rise,
        timed=True,
        watch=hull_draws_back,
    ),
    Claim(
        "bound-N",
        "law (1), all D_i equal, τ ≤ (r/2c) sin(βπ/n): T ≤ G sin(π/n)/sin((1−β)π/n) + (n−1)τ",
        draw_held,
        _law_1,
        bound_held,
        (meets,),
        by_law_1,
        timed=True,
    ),
    Claim(
        "pursuit",
        "2-D, 3-D: turn to one robot, drive at c < ω_max r/2 if aligned: T ≤ G + nπ/(ω_max − 2c/r)",
        draw_pursuers,
        pursuit,
        bound_pursuit,
        (meets,),
        no_rise,
        timed=True,
    ),
    Claim(
        "bodies",
        "discs and balls of radius r/2 never overlap before they dock, whatever the policy",
        draw_uniform,
        certified,
        bound_c,
        (keeps, meets),
        as_chosen,
        watch=bodies_stay_apart,
    ),
    Claim(
        "occlusion",
        "law (1) on what robots of radius r/2 do not hide: T ≤ G with c = a*",
        draw_uniform,
        what_is_seen,
        bound_occluded,
        (meets, keeps),
        no_rise,
        timed=True,
        watch=hull_shrinks,
    ),
)
