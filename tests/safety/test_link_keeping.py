"""Point of least norm compared with another solver; law R b, and projections that keep links.

The bearings are random or degenerate.
"""

import math

import numpy as np
import pytest
from geometry import triple
from scipy.optimize import nnls

import baselines
import rendezvous_env as rv
from rendezvous_env import Simulator, graphs
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.safety.links import (
    LinkKeeping,
    link_keeping_law,
    min_norm_points,
    project_on_links,
)
from rendezvous_env.trajectory import run
from train.verify.monitors import unit

SETS = 300
BALANCED = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / math.sqrt(3)


def by_another_solver(bearings):
    """q from min ‖x‖ subject to g·x ≥ 1 (Lawson and Hanson, 1974, chapter 23): q = x/‖x‖²."""
    system = np.vstack([bearings.T, np.ones(len(bearings))])
    target = np.append(np.zeros(bearings.shape[1]), 1.0)
    weights, _ = nnls(system, target)
    residual = system @ weights - target
    if np.linalg.norm(residual) < 1e-7:
        return np.zeros(bearings.shape[1])
    x = -residual[:-1] / residual[-1]
    return x / (x @ x)


def directions(random, count, dim):
    return unit(random.normal(size=(count, dim)))


def sets_of_bearings(dim):
    """Bearings of a cone, of nearly a half-space, and in all directions.

    Degenerate ones coincide (nearly), are opposite, or lie in one plane or on a cone.
    """
    random, axis = np.random.default_rng(dim), np.eye(dim)[0]
    for _ in range(SETS):
        for half_angle in (0.3, 1.2, 3.2):
            g = directions(random, 400, dim)
            near = g[np.arccos(np.clip(g @ axis, -1, 1)) <= half_angle]
            yield near[: random.choice([1, 2, 3, 4, 6, 12])]
        few = directions(random, random.integers(1, 4), dim)
        yield few[random.integers(len(few), size=9)]
        nearly = few[random.integers(len(few), size=9)]
        for apart in (1e-3, 1e-7, 1e-12, 1e-15):
            yield unit(nearly + apart * random.normal(size=nearly.shape))
        yield np.vstack([few, -few[:1]])
        yield np.vstack([few, -few])
        flat = few.copy()
        flat[:, -1] = 0.0
        if np.linalg.norm(flat, axis=-1).min() > 0.1:
            yield unit(flat)
        yaw, height = random.uniform(0, 7, 8), random.choice([1e-9, 0.01, 0.5])
        if dim == 3:
            level = math.sqrt(1 - height**2)
            yield np.stack([level * np.cos(yaw), level * np.sin(yaw), np.full(8, height)], axis=-1)
            yield BALANCED


@pytest.mark.kernels
@pytest.mark.parametrize("dim", [2, 3])
def test_least_norm_point_matches_other_solver(dim):
    """‖q‖² ≤ q·g for all g proves that no point of the hull is nearer; q lies in the hull."""
    sets = list(sets_of_bearings(dim))
    for g in sets:
        q = min_norm_points(g)
        length = np.linalg.norm(q)
        assert (g @ q).min() >= length**2 - 1e-12 * max(length, 1e-3)
        assert length == pytest.approx(np.linalg.norm(by_another_solver(g)), abs=1e-7)
    assert len(sets) > 10 * SETS


THIN = np.array(
    [
        [0.9545404540927737, 0.23722064045039334, -0.18049623055528496],
        [-0.180008142660658, 0.7021357452699972, -0.6889139741578814],
        [-0.958632397305397, -0.2288284559396138, 0.16929697158779863],
        [0.2986585891993691, -0.6885221466401442, 0.6608632995434761],
        [-0.9586018066759435, -0.2274820186160025, 0.17127319534593205],
    ]
)
"""Bearings around the origin, which lies in a thin tetrahedron of them."""


@pytest.mark.parametrize("kind", ["balanced", "flat", "opposite", "thin"])
def test_bearings_lie_along_balanced_point(kind):
    """q·g ≥ ‖q‖² for all g: otherwise motion along q lengthens a link."""
    random, count = np.random.default_rng(0), 100_000
    if kind == "balanced":
        g = BALANCED + 10.0 ** random.uniform(-17, -1, (count, 1, 1)) * random.normal(size=(4, 3))
    elif kind == "flat":
        g = random.normal(size=(count, 4, 3))
        g[..., 2] *= 10.0 ** random.uniform(-16, 0, (count, 1))
    elif kind == "thin":
        g = THIN + 10.0 ** random.uniform(-17, -1, (count, 1, 1)) * random.normal(size=(5, 3))
        g[0] = THIN
    else:
        pair, others = random.normal(size=(count, 1, 3)), random.normal(size=(count, 3, 3))
        g = np.concatenate([pair, -pair, others], axis=1)
        g += 10.0 ** random.uniform(-17, -1, (count, 1, 1)) * random.normal(size=(count, 5, 3))
    g = unit(g)
    q = min_norm_points(g)
    least = np.einsum("nkd,nd->nk", g, q).min(axis=1)
    assert (least >= (q**2).sum(axis=1) - 1e-14).all()


def test_least_norm_matches_hand_computation():
    east, north, west = [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]
    slanted = [math.cos(2.5), math.sin(2.5)]
    for bearings, q in (
        ([east], east),
        ([east, north], [0.5, 0.5]),
        ([east, north, west], [0.0, 0.0]),
        ([slanted, east, north], [(1 + math.cos(2.5)) / 2, math.sin(2.5) / 2]),
        ([[0.0, 0.0], [0.0, 3.0], [0.0, 0.0]], north),
        ([[0.0, 0.0], [0.0, 0.0]], [0.0, 0.0]),
    ):
        np.testing.assert_allclose(min_norm_points(bearings), q, atol=1e-16)
    axes = np.eye(3)
    np.testing.assert_allclose(min_norm_points(axes), [1 / 3] * 3, atol=1e-15)
    np.testing.assert_allclose(min_norm_points([*axes, [0.9, 0.9, 0]]), [1 / 3] * 3, atol=1e-15)
    np.testing.assert_array_equal(min_norm_points([*axes, -np.ones(3)]), np.zeros(3))


@pytest.mark.parametrize("dim", [2, 3])
def test_least_norm_ignores_weights_order_and_absent_rows(dim):
    random = np.random.default_rng(7)
    rows = random.normal(size=(5, 40, 4, dim)) + 1.5 * np.eye(dim)[0]
    q = min_norm_points(rows)
    assert q.shape == (5, 40, dim)
    longer = rows * random.uniform(1e-3, 1e3, (5, 40, 4, 1))
    spread = np.insert(longer[:, :, ::-1], [0, 2, 4], 0.0, axis=2)
    np.testing.assert_allclose(min_norm_points(spread), q, atol=1e-14)
    np.testing.assert_allclose(min_norm_points(rows.astype(np.float32)), q, atol=1e-6)
    np.testing.assert_array_equal(min_norm_points(rows[3, 7]), q[3, 7])


@pytest.mark.parametrize("dim", [2, 3])
def test_distance_sum_is_at_least_two(dim):
    """Lemma 2: Σ‖q_i‖ ≥ 2 if each robot has a neighbour, on directed graphs as well."""
    random, least = np.random.default_rng(dim), np.inf
    for _ in range(SETS):
        n = int(random.integers(2, 9))
        places = random.normal(size=(n, dim)) * random.choice([1.0, 1.0, 1e-3], dim)
        offsets, robots = places - places[:, None], np.arange(n)
        sees = random.random((n, n)) < 0.4
        sees[robots, random.permutation(n)] = True
        np.fill_diagonal(sees, False)
        sees[robots, (robots + 1) % n] |= ~sees.any(axis=1)
        total = np.linalg.norm(min_norm_points(offsets * sees[..., None]), axis=-1).sum()
        least = min(least, total)
    assert 2 - 1e-9 <= least < 2.2


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([1.0, 2.0], "neighbour_rows has shape"),
        ([[1.0, 2.0, 3.0, 4.0]], "neighbour_rows has shape"),
        ([[1.0, np.nan]], r"neighbour_rows is \[1\.0, nan\]; it must be finite"),
    ],
)
def test_invalid_rows_are_rejected(rows, message):
    with pytest.raises(ValueError, match=message):
        min_norm_points(rows)


def test_long_step_scales_law():
    q = np.array([[0.5, 0.0], [0.0, 1.0]])
    velocity = link_keeping_law(q, np.array([1.0, 9.0]), merge_radius=0.4, duration=0.1)
    np.testing.assert_allclose(velocity, [[0.5, 0.0], [0.0, 4.0]])


def lengths(simulator):
    p = simulator.positions
    return np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("graph", [graphs.path(2.0), graphs.random_tree((0.5, 2.0)), "cycle"])
@pytest.mark.parametrize("steps", [1.0, 2.0])
def test_links_never_grow_and_team_meets(dim, graph, steps):
    """Also at twice the certified step, r/D, where v τ is maximal."""
    scenario = rv.Scenario(
        n_robots=6, dim=dim, graph=graph, spawn_size=5.0, merge_radius=0.3,
        time_limit=400.0, neighbour_slots=5,
    )  # fmt: skip
    scenario = scenario.replace(time_step=steps * scenario.certified_step, allow_long_step=True)
    policy, simulator = baselines.make("link-keeping", scenario), Simulator(scenario, 6)
    observations, longest = simulator.reset(1), -np.inf
    before, alive = lengths(simulator), simulator.active
    for step in run(simulator, policy, observations):
        now, left = lengths(simulator), simulator.active
        grown = np.where(simulator.weights > 0, now - before, -1.0)
        whole = step.running & (alive == left).all(axis=-1)
        longest, before, alive = max(longest, grown[whole].max(initial=-1)), now, left
    assert longest < 1e-6 and (simulator.status == RENDEZVOUS).all()


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
    bearings = unit(np.eye(dim)[0] + spread * random.normal(size=(count, dim)))
    return bearings, random.uniform(0.3, 2), random.normal(size=dim) * random.uniform(0, 3)


@pytest.mark.kernels
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("error", [0.0, 0.2])
def test_velocity_is_closest_admissible(dim, error):
    """(w − x)·(z − x) ≤ 0 for all z of a convex set: random z, also near x."""
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


def test_velocities_match_hand_computation():
    """λ d q + (1 − λ) P(w), ρ = r/(4τ) = 1.5, with v_max = 3 and w in units of it."""
    scenario = rv.Scenario(n_robots=3, merge_radius=0.6, time_step=0.1, max_speed=3.0)
    links = LinkKeeping(scenario, 1, share=0.25, frame="local")
    rows = np.zeros((1, 3, *scenario.observation_layout.shape), np.float32)
    rows[0, 0] = [[1.0, 0.0], [0.0, 1.0]]
    rows[0, 1, 0] = [0.0, 1.0]
    rows[0, 2] = [[1.0, 0.0], [-1.0, 0.0]]
    links.hold([[[0.5, 0.5], [0.0, -1.0], [0.3, 0.4]]])
    actions = links.apply(rows)[0]
    np.testing.assert_allclose(actions[0], np.array([1.0, 1.0]) * 0.25 + 0.75 * 1.5, rtol=1e-6)
    np.testing.assert_allclose(actions[1], [0.0, 0.25], atol=1e-6)  # away is not allowed at all
    assert not actions[2].any()  # between two robots nobody moves
    assert links.alignment[0, 0] == pytest.approx(1.0) and np.isnan(links.alignment[0, 2])
    assert links.lyapunov_rate[0, 1] == pytest.approx(-0.5)
