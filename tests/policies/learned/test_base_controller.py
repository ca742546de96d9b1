"""Kernels of the base controller, against the rule of single robots and by hand."""

import numpy as np
import pytest
from geometry import along

from baselines.learned.base_controller_kernels import Rule, aim, room_for_aim, unit_vectors
from baselines.obstacle_rules.merged_intervals_2d import merged_headings_2d
from baselines.obstacle_rules.obstacle_edges import list_seen
from rendezvous_env.compilation import kernel
from rendezvous_env.safety.safety_filter import over_robots

pytestmark = pytest.mark.kernels

K, M = 3, 5
RULE = Rule(K, clearance=0.2, persistence=0.5)


def sights(num_envs, n=4, seed=0):
    """Observations (B, n, K + 2 M, 2): half of the obstacles are visible, in any direction."""
    random = np.random.default_rng(seed)
    seen = np.zeros((num_envs, n, K + 2 * M, 2), np.float32)
    seen[:, :, :K] = random.normal(size=(num_envs, n, K, 2))
    middles = random.uniform(-180, 180, (num_envs, n, M))
    halves = random.uniform(0, 100, (num_envs, n, M))
    edges = along(np.stack((middles + halves, middles - halves), axis=-1))[0]
    edges[random.uniform(size=middles.shape) < 0.5] = 0.0
    seen[:, :, K:] = edges.reshape(num_envs, n, 2 * M, 2)
    seen[::5] = -0.0  # robots that see nothing
    return seen


def aimed(seen, turns, carried, raw, rule=RULE):
    part, work = (0, len(seen), 0), room_for_aim(seen.shape[2], K)
    arrays = seen, seen.view(np.int64), turns, carried, raw
    for one in over_robots(aim, part, rule, *arrays, work=work):
        one()
    return raw


@pytest.mark.parametrize("clearance", [0.0, 0.2, 1.0, 2.0])
@pytest.mark.parametrize("num_envs", [1, 9, 40])
def test_aim_equals_rule_of_single_robots(num_envs, clearance):
    seen, random = sights(num_envs), np.random.default_rng(1)
    rule, robots = RULE._replace(clearance=clearance), seen.shape[0] * seen.shape[1]
    turns, carried = (along(random.uniform(-180, 180, seen.shape[:2]))[0] for _ in range(2))
    carried[::3] = 0.0
    f = np.zeros(turns.shape)
    for k in range(K):
        f += seen[:, :, k]
    (c, s), (x, y) = np.moveaxis(turns, -1, 0), np.moveaxis(f, -1, 0)
    turned = np.stack((c * x - s * y, s * x + c * y), axis=-1).reshape(robots, 2)
    silhouettes = seen[:, :, K:].reshape(robots, M, 2, 2)
    wanted = np.empty((robots, 2))
    given = clearance, carried.reshape(robots, 2), rule.persistence
    merged_headings_2d(turned, silhouettes, *given, wanted)
    found = aimed(seen, turns, carried, np.empty_like(turns), rule)
    # angles in lanes differ in the last digit
    np.testing.assert_allclose(found.reshape(robots, 2), wanted, rtol=0, atol=4e-15)
    own = carried.copy()  # the headings may be overwritten
    np.testing.assert_array_equal(aimed(seen, turns, own, own, rule), found)


@pytest.mark.parametrize(
    ("edges", "carried", "heading"),
    [
        ((30, -40), None, 41.5),  # 30 < 40
        ((30, -40), -170, -51.5),  # 30 + 160/2 > 40 + 130/2
        ((30, -40), 10, 41.5),  # 30 + 20/2 < 40 + 50/2
        ((60, -5), 60, -16.5),  # 60 > 5 + 65/2, as for any carried heading
        ((5, -60), -60, 16.5),
    ],
)
def test_aim_leaves_by_edge_that_costs_less(edges, carried, heading):
    """f along 0° into an obstacle; half of the angle from the carried heading counts too."""
    seen = np.zeros((1, 1, K + 2 * M, 2), np.float32)
    seen[0, 0, 0], seen[0, 0, K : K + 2] = along(0), along(*edges)
    before = np.zeros((1, 1, 2)) if carried is None else along(carried).reshape(1, 1, 2)
    rule = RULE._replace(clearance=np.radians(11.5))
    raw = aimed(seen, along(0).reshape(1, 1, 2), before, np.empty((1, 1, 2)), rule)
    np.testing.assert_allclose(raw[0], along(heading), atol=1e-6)


@kernel
def listed(bits, first, obstacles, out):
    return list_seen(bits, first, obstacles, out)


def test_visible_obstacles_are_listed_in_order():
    rows = np.zeros((2 + 8, 2), np.float32)
    rows[2:] = -0.0
    rows[4, 1], rows[8, 0] = -1e-44, 0.5  # denormal numbers are no zeros
    rows[7] = 1.0  # a second edge alone shows nothing
    out = np.full(5, -1)
    assert listed(rows.view(np.int64), 2, 4, out) == 2
    assert out[:2].tolist() == [4, 8]


def test_unit_vectors_keep_direction_and_report_infinite_numbers():
    given = np.array([[[3.0, 4.0], [0.0, 0.0]], [[0.0, -2.0], [1e-300, 0.0]]])
    out = np.empty_like(given)
    assert unit_vectors(given, out, (0.0, 1.0))
    np.testing.assert_array_equal(out[:, 0], [[0.6, 0.8], [0.0, -1.0]])
    np.testing.assert_array_equal(out[:, 1], [[0.0, 1.0], [0.0, 1.0]])  # squares vanish
    for wrong in (np.inf, -np.inf, np.nan):
        given[1, 1, 1] = wrong
        assert not unit_vectors(given, out, (0.0, 1.0))
