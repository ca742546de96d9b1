"""Contacts and merges among obstacles against the kernels, robot by robot."""

import importlib

import numpy as np
import pytest
from parameters import first_fast

import rendezvous_env as rv
from rendezvous_env.graphs.merging import merge_swept
from rendezvous_env.obstacles import obstacle_set
from rendezvous_env.obstacles.contact import SLIDE, STOP, move_straight
from rendezvous_env.obstacles.obstacle_set import SKIN

WORLDS = {
    "mixed": [
        rv.Capsule(((-1.0, -1.0), (1.0, 1.5)), 0.4),
        rv.Disc((1.5, -1.0), 0.6),
        rv.Polygon(((-2.0, 1.0), (-1.0, 1.0), (-1.0, 2.0), (-2.0, 2.0))),
    ],
    "seams": [
        rv.Polygon(((-2.0, -1.0), (0.0, -1.0), (0.0, 1.0), (-2.0, 1.0))),
        rv.Polygon(((0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0))),
        rv.Disc((0.0, 1.5), 0.5),
    ],
    "space": [
        rv.Capsule(((-1.0, -1.0, 0.3), (1.0, 1.5, -0.2)), 0.6),
        rv.Sphere((1.0, -0.4, 0.5), 0.8),
        rv.Sphere((0.0, 0.0, 0.0), 0.9),
    ],
}
LONG = [("mixed", SLIDE), ("mixed", STOP), ("space", SLIDE)]


def fields_of(name):
    """Obstacles of the JAX form, and as the engine keeps them."""
    import jax.numpy as jnp

    fields = importlib.import_module("rendezvous_env.jax.obstacles.fields")
    given = WORLDS[name]
    scenario = rv.Scenario(n_robots=2, dim=given[0].dim, obstacles=given)
    world = obstacle_set.world_of(obstacle_set.pack(given, len(given)), dim=given[0].dim)
    return fields.Fields(scenario, jnp.float64), world


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), [("seams", SLIDE), *LONG])
def test_contacts_equal_the_kernels(name, mode, rj):
    import jax

    contact = importlib.import_module("rendezvous_env.jax.obstacles.contact")
    fields, world = fields_of(name)
    dim, rng = WORLDS[name][0].dim, np.random.default_rng(0)
    count = 600 if dim == 2 else 2400
    points, ways = rng.uniform(-2.5, 2.5, (count, 3)), rng.uniform(-1.0, 1.0, (count, 3))
    points[:, dim:], ways[:, dim:] = 0.0, 0.0
    for k in range(0, count // 2, 2):  # on a surface, or within a skin
        points[k + 1] = obstacle_set.push_out(tuple(points[k]), world, -1e-13)[1]
        for m in range(len(world.kinds)):
            distance, normal = obstacle_set.surface(world, m, tuple(points[k + 1]))
            if k % 4 == 0 and distance < 3e-6:
                points[k + 1] -= 0.5 * distance * np.array(normal)
    outside = [min(obstacle_set.distance_to(world, m, tuple(p)) for m in range(3)) for p in points]
    chosen = np.array(outside) > -1e-12
    points, ways = points[chosen], ways[chosen]
    normals, expected = np.zeros((6, 3)), []
    for point, way in zip(points, ways, strict=True):
        expected.append(move_straight(tuple(point), tuple(way), world, mode, normals))
    move = contact.Contact(fields.shapes, mode).move_straight
    met, executed = jax.jit(lambda p, w: move(fields.world(None, 1), p, w))(
        tuple(points.T[:dim]), tuple(ways.T[:dim])
    )
    np.testing.assert_array_equal(met, [one[0] for one in expected])
    apart = np.abs(np.stack(executed, axis=1) - [one[1][:dim] for one in expected]).max(axis=1)
    # on the surface of a skin rounding decides, and the compiler may contract products and sums
    assert (apart < 1e-9).mean() > 0.99 and apart.max() < SKIN
    assert 50 < np.sum(met) < len(points)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), first_fast(LONG))
def test_gradients_of_contacts_equal_differences(name, mode, rj):
    """Where differences on both sides agree, so that no decision changes; elsewhere finite."""
    import jax
    import jax.numpy as jnp

    contact = importlib.import_module("rendezvous_env.jax.obstacles.contact")
    fields, world = fields_of(name)
    dim, rng, h = WORLDS[name][0].dim, np.random.default_rng(0), 1e-5
    given = np.array([rng.uniform(-2.5, 2.5, (3, 400)), rng.uniform(-1.0, 1.0, (3, 400))])
    given[:, dim:] = 0.0
    for k in range(0, 100, 2):  # on a surface
        given[0, :, k] = obstacle_set.push_out(tuple(given[0, :, k]), world, -1e-13)[1]
    move = contact.Contact(fields.shapes, mode, bounded=True).move_straight
    factors = rng.uniform(0.5, 1.0, 3)

    def along(given):
        met, executed = move(fields.world(None, 1), tuple(given[0, :dim]), tuple(given[1, :dim]))
        return sum(f * part for f, part in zip(factors, executed, strict=False)), met

    value = jax.jit(lambda given: along(given)[0])
    slopes, met = jax.jit(jax.grad(lambda given: (lambda a, m: (a.sum(), m))(*along(given)),
                                   has_aux=True))(jnp.asarray(given))  # fmt: skip
    assert np.isfinite(slopes).all()
    clearance = np.full(400, np.inf)
    for m in range(len(world.kinds)):
        distances = [obstacle_set.distance_to(world, m, tuple(p)) for p in given[0].T]
        clearance = np.minimum(clearance, distances)
    smooth = np.array(met) & (clearance > -1e-12)
    found = np.zeros((2, dim, 400))
    for part, axis in np.ndindex(2, dim):
        step = np.zeros_like(given)
        step[part, axis] = h
        ahead, here, behind = (value(given + k * step) for k in (1, 0, -1))
        found[part, axis] = (ahead - behind) / (2 * h)
        smooth &= np.abs(ahead - 2 * here + behind) < 1e-4 * h
    apart = smooth & (clearance > 2 * h)  # a start moved by h must not be inside an obstacle
    for part, chosen in ((0, apart), (1, smooth)):
        ours, expected = slopes[part, :dim, chosen], found[part][:, chosen].T
        np.testing.assert_allclose(ours, expected, rtol=1e-4, atol=1e-4)
        assert chosen.sum() > 9, "hardly a contact"


@pytest.mark.slow
def test_pairs_behind_obstacles_do_not_merge(rj):
    import jax
    import jax.numpy as jnp

    merging = importlib.import_module("rendezvous_env.jax.merging")
    fields, world = fields_of("mixed")
    n, radius, rng = 4, 0.9, np.random.default_rng(1)
    first, second = np.triu_indices(n, 1)
    starts, ways = rng.uniform(-2.2, 2.2, (2, 150, n, 2))
    ways *= 0.3
    merge = jax.jit(merging.Merging(n, radius, False, False, fields, through=False))
    moving = merging.MergeArrays(
        jnp.moveaxis(jnp.asarray(starts), 0, -1),
        jnp.moveaxis(jnp.asarray(ways), 0, -1),
        jnp.ones((n, 150)),
        jnp.broadcast_to(1.0 - jnp.eye(n)[..., None], (n, n, 150)),
        jnp.broadcast_to(jnp.arange(n)[:, None], (n, 150)),
    )
    found, hidden = merge(moving), 0
    for k in range(150):
        results = []
        for through in (False, True):
            places, left, lengths = starts[k].copy(), ways[k].copy(), np.ones(n)
            links = first.copy(), second.copy(), np.ones(len(first))
            into, work = np.arange(n), (np.zeros(6), np.zeros((n, 2)), np.zeros(n, bool))
            given = places, left, lengths, links, None, into, world, radius
            merge_swept(*given, (*work, np.zeros(4)), through)
            results.append((places[into], into, lengths))
        places, into, lengths = results[0]
        np.testing.assert_array_equal(found.merged_into[:, k], into)
        np.testing.assert_allclose(found.lengths[:, k], lengths, atol=1e-9)
        np.testing.assert_allclose(np.asarray(found.positions)[into, :, k], places, atol=1e-9)
        hidden += int((into != results[1][1]).any())
    assert hidden > 5, "no obstacle prevented a merge"
