"""Equations over arrays against the numba kernels, one number at a time."""

import importlib

import numpy as np
import pytest

from rendezvous_env.physics import random_streams as engine_streams
from rendezvous_env.physics.crossings import first_crossing
from rendezvous_env.robots.double_integrator import mean_speed
from rendezvous_env.robots.unicycle import mean_cos_sin
from rendezvous_env.safety.heading import certified_heading


def test_random_streams_equal_the_engine_bit_by_bit(rj):
    import jax.numpy as jnp

    streams = importlib.import_module("rendezvous_env.jax.random_streams")
    seeds = [0, 1, 2**32 - 1, 2**32, 0x9E3779B97F4A7C15, 2**63 - 1]
    for seed in seeds:
        for purpose in (0, 3):
            key = streams.stream_key(streams.word(seed), jnp.int32(70_000), purpose)
            with np.errstate(over="ignore"):
                expected = engine_streams.stream_key(np.uint64(seed), 70_000, purpose)
                drawn = [engine_streams.uniform(np.uint64(expected), k) for k in range(50)]
            assert int(key[0]) << 32 | int(key[1]) == int(expected)
            np.testing.assert_array_equal(streams.uniform(key, jnp.arange(50), jnp.float64), drawn)


@pytest.mark.parametrize("kernel", [first_crossing, mean_speed, mean_cos_sin])
def test_forms_that_select_equal_kernels_that_branch(kernel, rj):
    array_form = importlib.import_module("rendezvous_env.jax.array_form").array_form
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


@pytest.mark.parametrize("dim", [2, 3])
def test_certified_headings_equal_the_filter(dim, rj):
    heading = importlib.import_module("rendezvous_env.jax.heading")
    rng = np.random.default_rng(1)
    raw, f, previous = rng.standard_normal((3, 300, dim))
    raw[::5], f[::7], previous[::11] = 0.0, 0.0, 0.0
    raw[1::5], previous[1::7] = -f[1::5], -raw[1::7]
    f[2::9] *= 1e-3
    for most in (0.05, 1.0, np.inf):
        settings = {"min_alignment": 0.2, "dead_zone": 0.1, "max_turn": most}
        expected = certified_heading(raw, f, previous, **settings)
        limit = heading.turn_limit(most)
        found = heading.certify(tuple(raw.T), tuple(f.T), tuple(previous.T), 0.2, 0.1, limit)
        np.testing.assert_allclose(np.stack(found, axis=1), expected, atol=1e-9)
