"""Links under any desired velocities: none grows longer, none is lost; the projection; refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import UNEQUAL, five
from filtered_teams import Seen
from tuples import triple

from rendezvous_env import Scenario, Sensing, Simulator
from rendezvous_env.safety.links import LinkKeeping, project_on_links
from research.desired_velocities import KINDS, desired_velocities

TEAMS = 12
ROUNDING = 1e-6
"""Of float32 rows and actions, m."""


class Links(Seen):
    """Episodes of link-keeping robots; lengths in m."""

    def __init__(self, scenario, *, kind="mixed", steps=None, made=LinkKeeping, **options):
        self.reach, self.layout = scenario.sensing.range or np.inf, scenario.observation_layout
        self.growth, self.lost, self.least_degree = -np.inf, 0, np.inf
        choose = desired_velocities(scenario, TEAMS, np.random.default_rng(0), kind)
        filtered = made(scenario, TEAMS, frame="local", **options)
        super().__init__(scenario, filtered, choose, steps=steps)

    def watch(self, step):
        degree, active = self.layout.degree(step.observations), step.before.active
        self.least_degree = min(self.least_degree, degree[step.on][active[step.on]].min())
        before, after = (distances(moment.positions) for moment in (step.before, step.after))
        linked = (step.simulator.weights > 0) & (before <= self.reach) & step.calm[:, None, None]
        self.growth = max(self.growth, (after - before)[linked].max(initial=-np.inf))
        self.lost += int(((after > self.reach) & linked).sum())


def distances(p):
    return np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)


def chain(n, dim, reach, seed=0):
    """A start whose shorter links connect it and hardly any others are there, (n, d) rows."""
    random, radius = np.random.default_rng(seed), 0.2
    places = [np.zeros(dim)]
    while len(places) < n:
        step = random.normal(size=dim)
        new = places[-1] + step / np.linalg.norm(step) * (reach - (n - 1) * radius / 2) * 0.999
        if min(np.linalg.norm(new - place) for place in places) > 2 * radius:
            places.append(new)
    return tuple(map(tuple, np.array(places).tolist()))


def short_sighted(n=6, dim=2, reach=2.0, **changes):
    start = chain(n, dim, reach)
    sensing = Sensing(range=reach, **changes.pop("sensing", {}))
    changes = {"time_limit": 400.0} | changes
    return Scenario(n_robots=n, dim=dim, start_positions=start, sensing=sensing, **changes)


# ---- links under any velocities ------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_no_link_grows_longer_and_all_meet(dim, kind):
    scenario = five(f"single_integrator-{dim}d", spawn_size=3.0, time_limit=300.0)
    seen = Links(scenario, kind=kind)
    n, weight = 5, scenario.bottleneck_weight
    rises = (n - 1) * scenario.merge_radius * np.triu(UNEQUAL).sum()
    assert seen.growth < ROUNDING and seen.rise < ROUNDING
    assert (seen.times <= n * (seen.start + rises) / (4 * 0.5 * weight**2)).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("share", [0.1, 1.0])
@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_robots_of_limited_range_lose_nobody_and_meet(dim, share, factor):
    scenario = short_sighted(dim=dim)
    scenario = scenario.replace(
        time_step=factor * scenario.certified_step, allow_long_step=True, time_limit=3e3
    )
    seen = Links(scenario, share=share)
    assert seen.growth < ROUNDING and seen.lost == 0 and seen.least_degree > 0.999
    n, a, r, reach = 6, 1.0, scenario.merge_radius, 2.0
    most = 2 * a * reach * (n * (n - 1) / 2 + (n - 1) ** 2) + (n - 1) * r * a * n * (n - 1) / 2
    slowest = min(1.0, r / (2 * scenario.tau * a))
    assert (seen.times <= n * most / (4 * share * a**2 * slowest)).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("error", [0.05, 0.2])
def test_wrong_bearings_that_are_allowed_for_lose_nobody(dim, error):
    scenario = short_sighted(dim=dim, sensing={"error": error})
    seen = Links(scenario, bearing_error=error + 1e-6)
    assert seen.growth < ROUNDING and seen.lost == 0 and np.isfinite(seen.times).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_links_are_kept_however_wrong_bearings_are(dim):
    """For η ≥ π/(2n) nobody promises a meeting."""
    scenario = short_sighted(dim=dim, sensing={"error": 0.9}, time_limit=20.0)
    seen = Links(scenario, bearing_error=0.9 + 1e-6)
    assert seen.growth < ROUNDING and seen.lost == 0


class Carefree(LinkKeeping):
    """As if steps were so short that any velocity of the dual cone would do."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self._constants = self._constants._replace(radius=1e6, share=0.0)


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({}, {"made": Carefree}),
        ({"sensing": {"error": 0.2}}, {"share": 0.01, "bearing_error": 0.0}),
    ],
)
def test_links_that_are_not_kept_are_caught(changes, options):
    seen = Links(short_sighted(time_limit=20.0, **changes), **options)
    assert seen.growth > 1e-4


def test_free_velocities_lose_links():
    """What the projection is for: the same velocities, bare."""
    scenario = short_sighted(time_limit=20.0)
    simulator = Simulator(scenario, TEAMS)
    choose = desired_velocities(scenario, TEAMS, np.random.default_rng(0), "flee")
    observations = simulator.reset(0)
    for step in range(200):
        velocity = scenario.speed_limit * choose(observations, step)
        observations = simulator.step(velocity.astype(np.float32)).observations
    degree = scenario.observation_layout.degree(observations)
    assert (degree[simulator.active] == 0).any()


# ---- the projection ------------------------------------------------------------------------------


def allowed(points, bearings, radius, error):
    """Whether ‖v‖ ≤ 2 ρ cos(∠(v, g) + η) for all bearings, (N,)."""
    speed = np.linalg.norm(points, axis=-1)
    with np.errstate(invalid="ignore"):
        angles = np.arccos(np.clip(points @ bearings.T / speed[:, None], -1, 1)) + error
    most = 2 * radius * np.cos(np.minimum(angles, np.pi)).min(axis=-1)
    return (speed <= most + 1e-12 * radius) | (speed == 0)


def draw(random, dim):
    """Bearings in a narrow or wide cone, a radius and a desired velocity."""
    count, spread = random.integers(1, 7), random.choice([0.01, 0.3, 1.0, 2.0])
    bearings = np.eye(dim)[0] + spread * random.normal(size=(count, dim))
    bearings /= np.linalg.norm(bearings, axis=-1, keepdims=True)
    return bearings, random.uniform(0.3, 2), random.normal(size=dim) * random.uniform(0, 3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("error", [0.0, 0.2])
def test_nothing_that_is_allowed_is_nearer_to_a_desired_one(dim, error):
    """(w − x)·(z − x) ≤ 0 for all z of a convex set: z drawn everywhere, and near x."""
    random, inner = np.random.default_rng(dim), 0
    for _ in range(300):
        bearings, radius, desired = draw(random, dim)
        rows = bearings * random.uniform(0.5, 2, (len(bearings), 1))
        found = project_on_links(triple(desired), rows, len(rows), radius, error)
        x = np.array(found)[:dim]
        assert allowed(x[None], bearings, radius, error).all()
        scale = random.choice([1.0, 1e-1, 1e-2, 1e-3], (600, 1))
        z = np.where(scale == 1.0, 0.0, x) + scale * radius * random.normal(size=(600, dim))
        z = z[allowed(z, bearings, radius, error)]
        assert ((z - x) @ (desired - x)).max(initial=0.0) < 1e-9
        inner += np.linalg.norm(x) > 0 and not np.array_equal(x, desired)
    assert inner > 50


def test_in_the_plane_it_is_the_nearest_point_of_two_discs():
    """The two outermost bearings count; the discs meet in 0 and in ρ (g + g')."""
    random = np.random.default_rng(5)
    for _ in range(500):
        half, radius, desired = (
            random.uniform(0, 1.5),
            random.uniform(0.3, 2),
            random.normal(size=2),
        )
        angles = np.append(random.uniform(-half, half, 3), [half, -half])
        g = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        found = project_on_links(triple(desired), g, 5, radius, 0.0)
        candidates = [desired, np.zeros(2), radius * (g[3] + g[4])]
        for centre in radius * g[3:]:
            candidates.append(
                centre + radius * (desired - centre) / np.linalg.norm(desired - centre)
            )
        points = np.array(candidates)
        points = points[allowed(points, g, radius, 0.0)]
        nearest = points[np.argmin(np.linalg.norm(points - desired, axis=-1))]
        np.testing.assert_allclose(found[:2], nearest, atol=1e-9)


def test_velocities_by_hand():
    """λ d q + (1 − λ) P(w), ρ = r/(4τ) = 1.5, with v_max = 3 and desired ones in units of it."""
    scenario = Scenario(n_robots=3, merge_radius=0.6, time_step=0.1, max_speed=3.0)
    links = LinkKeeping(scenario, 1, share=0.25, frame="local")
    rows = np.zeros((1, 3, *scenario.observation_layout.shape), np.float32)
    rows[0, 0] = [[1.0, 0.0], [0.0, 1.0]]
    rows[0, 1, 0] = [0.0, 1.0]
    rows[0, 2] = [[1.0, 0.0], [-1.0, 0.0]]
    links.hold([[[0.5, 0.5], [0.0, -1.0], [0.3, 0.4]]])
    actions = links.act(rows)[0]
    np.testing.assert_allclose(actions[0], np.array([1.0, 1.0]) * 0.25 + 0.75 * 1.5, rtol=1e-6)
    np.testing.assert_allclose(actions[1], [0.0, 0.25], atol=1e-6)  # away is not allowed at all
    assert not actions[2].any()  # between two robots nobody moves
    assert links.alignment[0, 0] == pytest.approx(1.0) and np.isnan(links.alignment[0, 2])
    assert links.lyapunov_rate[0, 1] == pytest.approx(-0.5)


def test_velocities_that_are_allowed_are_carried_out_but_for_the_share():
    scenario = five("single_integrator-2d")
    links, simulator = LinkKeeping(scenario, 4, share=1e-9, frame="local"), Simulator(scenario, 4)
    observations = simulator.reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    desired = 1e-3 * f / scenario.speed_limit
    links.hold(desired)
    actions = links.act(observations)
    rows = observations[:, :, : scenario.observation_layout.neighbour_slots]
    along = np.where(np.any(rows, axis=-1), np.einsum("bnkd,bnd->bnk", rows, f), np.inf)
    free = along.min(axis=-1) > 0.2
    assert free.any() and not free.all()
    np.testing.assert_allclose(actions[free], 1e-3 * f[free], rtol=1e-4)


# ---- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"share": 0.0}, r"share is 0.0; it must be in \(0, 1\]"),
        ({"share": 1.1}, "share is 1.1; it must"),
        ({"share": None}, "share is None; it must"),
        ({"bearing_error": -0.1}, "bearing_error is -0.1; it must"),
        ({"bearing_error": math.pi}, "bearing_error is 3.14.*; it must"),
    ],
)
def test_arguments_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        LinkKeeping(Scenario(), 1, **options)


@pytest.mark.parametrize(
    ("sensing", "field"),
    [
        ({"field_of_view": 3.0}, "field_of_view is 3 rad"),
        ({"dropout": 0.1}, "dropout is 0.1"),
        ({"occlusion": "robots"}, "occlusion is 'robots'"),
        ({"occlusion": "obstacles"}, "occlusion is 'obstacles'"),
    ],
)
def test_sight_that_is_not_mutual_is_refused(sensing, field):
    with pytest.raises(ValueError, match=rf"scenario: sensing\.{field}; theorem R needs"):
        LinkKeeping(Scenario(sensing=Sensing(range=3.0, **sensing)), 1)
