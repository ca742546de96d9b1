"""Equations over arrays against the numba kernels, one number at a time."""

import importlib

import numpy as np
import pytest
from parameters import slow

import rendezvous_env as rv
from rendezvous_env.obstacles import obstacle_set
from rendezvous_env.physics import random_streams as engine_streams
from rendezvous_env.physics.crossings import first_crossing
from rendezvous_env.robots.double_integrator import mean_speed
from rendezvous_env.robots.unicycle import mean_cos_sin
from rendezvous_env.safety.heading import (
    HeadingFilter,
    certified_heading,
    certify_one,
    turn_limit,
)
from rendezvous_env.sensors.chance import cosine_and_sine, gaussian


@pytest.mark.slow
def test_random_streams_equal_the_engine_bit_by_bit(rj):
    import jax.numpy as jnp

    streams = importlib.import_module("rendezvous_env.jax.arrays.random_streams")
    seeds = [0, 1, 2**32 - 1, 2**32, 0x9E3779B97F4A7C15, 2**63 - 1]
    for seed in seeds:
        for purpose in (0, 3):
            (key,) = streams.stream_keys(streams.word(seed), jnp.int32(70_000), purpose)
            with np.errstate(over="ignore"):
                expected = engine_streams.stream_key(np.uint64(seed), 70_000, purpose)
                drawn = [engine_streams.uniform(np.uint64(expected), k) for k in range(50)]
            assert int(key[0]) << 32 | int(key[1]) == int(expected)
            np.testing.assert_array_equal(streams.uniform(key, jnp.arange(50), jnp.float64), drawn)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", [first_crossing, mean_speed, mean_cos_sin])
def test_forms_that_select_equal_kernels_that_branch(kernel, rj):
    array_form = importlib.import_module("rendezvous_env.jax.arrays.array_form").array_form
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1.0, 1.0, (2, 400, 3))
    b[::3] *= 1e-4
    b[::5], b[::13] = -a[::5], 0.0  # head-on, and at rest
    if kernel is mean_cos_sin:
        swept = np.where(rng.random(400) < 0.3, 1e-9 * b[:, 0], 4.0 * b[:, 0])
        given = [(x, y) for x, y in zip(a[:, 0], swept, strict=True)]
        arrays = (a[:, 0], swept)
    else:
        more = (0.6,) if kernel is first_crossing else ()
        scale = 3.0 if kernel is first_crossing else 1.0
        given = [(tuple(p), tuple(scale * q), *more) for p, q in zip(a, b, strict=True)]
        arrays = (tuple(a.T), tuple(scale * b.T), *more)
    expected = np.array([kernel(*one) for one in given])
    found = np.asarray(array_form(kernel)(*arrays))
    np.testing.assert_allclose(found if found.ndim == 1 else found.T, expected, rtol=1e-9)
    assert len(np.unique(expected)) > 50


@pytest.mark.slow
def test_frames_among_many_obstacles_equal_those_of_the_engine(rj):
    heading = importlib.import_module("rendezvous_env.jax.filters.heading")
    engine = rv.make_vec("slab-3d", num_envs=3)
    rows = np.moveaxis(engine.reset(seed=4)[0], 0, -1).astype(float)
    n, count, d, batch = rows.shape
    assert count > 100, "the rows do not fit into a few passes of the loop"
    form = heading.Heading(HeadingFilter(engine.unwrapped.scenario, 1), rows.dtype)
    found, _ = form.observe(rows, form.begin(n, d, (batch,), rows.dtype))
    expected, _ = rv.vector.GuaranteeWrapper(engine, "heading").reset(seed=4)
    np.testing.assert_allclose(np.moveaxis(np.asarray(found), -1, 0), expected, atol=1e-6)
    assert np.abs(expected - np.moveaxis(rows, -1, 0)).max() > 0.5


def _shapes(kind, dim):
    """Obstacles of a kind, as a set of the engine and as arrays of one environment."""
    shapes = importlib.import_module("rendezvous_env.jax.obstacles.shapes")
    centre = (0.3, -0.2, 0.1)[:dim]
    made = {
        "disc": [rv.Disc((0.3, -0.2), 0.7)],
        "sphere": [rv.Sphere((0.3, -0.2, 0.1), 0.7)],
        "capsule": [rv.Capsule((centre, (1.0, 0.6, -0.4)[:dim]), 0.5)],
        "polygon": [
            rv.Polygon(((0.0, 0.0), (1.0, 0.0), (0.8, 0.9))),
            rv.Polygon(((-1.0, -1.0), (0.0, -1.0), (0.2, -0.3), (-0.4, 0.1), (-1.0, -0.2))),
        ],
    }[kind]
    world = obstacle_set.world_of(obstacle_set.pack(made, len(made)), dim=dim)
    present = np.ones((len(made), 1), bool)
    arrays = shapes.World(present, world.shapes[..., None], world.skins[:, None])
    form = shapes.Shapes(world.kinds, world.corners, dim, shapes.EXACT, False)
    return world, form, form.with_edges(arrays)


SHAPES = [("capsule", 2), ("polygon", 2), ("sphere", 3), ("capsule", 3)]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "dim"), [("disc", 2), *SHAPES])
def test_shapes_equal_the_kernels(kind, dim, rj):
    world, shapes, arrays = _shapes(kind, dim)
    rng = np.random.default_rng(2)
    points, ways = rng.uniform(-2.0, 2.0, (2, 200, 3))
    points[:, dim:], ways[:, dim:] = 0.0, 0.0
    point, way = tuple(points.T[:dim]), tuple(ways.T[:dim])
    distance, normal = shapes.surface(arrays, point)
    entries = {depth: shapes.entry(arrays, point, way, depth) for depth in (1e-6, -0.3)}
    for m in range(len(world.kinds)):
        expected = [obstacle_set.surface(world, m, tuple(one)) for one in points]
        np.testing.assert_allclose(distance[m], [one[0] for one in expected], atol=1e-12)
        normals = np.stack([part[m] for part in normal], axis=1)
        np.testing.assert_allclose(normals, [one[1][:dim] for one in expected], atol=1e-9)
        for depth, entry in entries.items():
            pairs = [(tuple(p), tuple(w)) for p, w in zip(points, ways, strict=True)]
            found = [obstacle_set.entry(world, m, p, w, depth) for p, w in pairs]
            np.testing.assert_allclose(entry[m], found, atol=1e-9)
            assert 5 < np.isfinite(found).sum() < 200
    outside = np.asarray((distance > 0.0).all(axis=0))
    net, axes = tuple(rng.standard_normal((3, 200))), tuple(np.eye(3)[:2])
    edges = shapes.silhouettes(arrays, point, net, axes)
    out = np.zeros((2 if dim == 2 else 8, dim))
    for k in np.flatnonzero(outside)[:40]:
        for m in range(len(world.kinds)):
            if dim == 2:
                obstacle_set.silhouette_2d(world, m, tuple(points[k]), out)
            else:
                f = tuple(part[k] for part in net)
                obstacle_set.silhouette_3d(world, m, tuple(points[k]), f, *map(tuple, axes), out)
            found = [[part[m, k] for part in one] for one in edges]
            np.testing.assert_allclose(found, out, atol=1e-9)


@pytest.mark.slow
def test_skins_of_balls_equal_the_kernels(rj):
    import jax.numpy as jnp

    fields = importlib.import_module("rendezvous_env.jax.obstacles.fields")
    rng = np.random.default_rng(3)
    env = rj.make("clutter-3d", n_robots=2)
    assert env._fields is not None
    seams = 0
    for gap in (-1.3e-6, -0.9e-6, 0.7e-6, 1.1e-6):
        for size in (2, 3):
            table = np.zeros((12, 6))
            table[:, 0], table[:, 2] = 1, 0.1
            table[:, 3:] = 100.0 + 10.0 * np.arange(12)[:, None]
            table[:size, 3:] = rng.standard_normal((size, 3))
            meeting = np.average(table[:size, 3:], axis=0, weights=rng.random(size) + 0.2)
            reach = np.linalg.norm(table[:size, 3:] - meeting, axis=1)
            table[:size, 2] = reach - gap
            world = obstacle_set.world_of(table, dim=3)
            found = env._fields._skins(
                fields.World(
                    jnp.ones((12, 1), bool),
                    jnp.asarray(table[:, 2:])[..., None],
                    jnp.zeros((12, 1)),
                )
            )
            np.testing.assert_array_equal(np.asarray(found)[:, 0], world.skins)
            seams += int((world.skins > 0.0).sum())
    assert seams == 10


def test_a_branch_that_is_not_supported_is_refused(rj):
    form = importlib.import_module("rendezvous_env.jax.arrays.array_form").array_form

    def first_negative(values):
        for value in values:
            if value < 0.0:
                return value
        return 0.0

    with pytest.raises(NotImplementedError, match="first_negative has no array form: For"):
        form(first_negative)


@pytest.mark.parametrize("kernel", [gaussian, cosine_and_sine])
def test_random_rotations_equal_the_kernels_when_compiled(kernel, rj):
    import jax
    import jax.numpy as jnp

    importlib.import_module("rendezvous_env.jax.imperfections")
    form = importlib.import_module("rendezvous_env.jax.arrays.array_form").array_form
    words = np.random.default_rng(4).integers(0, 2**32, 300, dtype=np.uint32)
    words[:4] = 0, 1, 2**32 - 1, 2**31
    given, more = (words, ()) if kernel is gaussian else (words.view(np.int32) * 1e-9, (False,))
    given = given if kernel is gaussian else given.astype(np.float32)
    found = jax.jit(lambda x: form(kernel)(x, *more))(jnp.asarray(given))
    expected = np.array([kernel(x, *more) for x in given]).T
    np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, slow(3)])
def test_certified_headings_equal_the_filter(dim, rj):
    form = importlib.import_module("rendezvous_env.jax.arrays.array_form").array_form
    rng = np.random.default_rng(1)
    raw, f, previous = rng.standard_normal((3, 300, dim))
    raw[::5], f[::7], previous[::11] = 0.0, 0.0, 0.0
    raw[1::5], previous[1::7] = -f[1::5], -raw[1::7]
    f[2::9] *= 1e-3
    for most in (0.05, 1.0, np.inf):
        settings = {"min_alignment": 0.2, "dead_zone": 0.1, "max_turn": most}
        expected = certified_heading(raw, f, previous, **settings)
        limit = form(turn_limit)(most)
        found = form(certify_one)(tuple(raw.T), tuple(f.T), tuple(previous.T), 0.2, 0.1, limit)
        np.testing.assert_allclose(np.stack(found, axis=1), expected, atol=1e-9)
