"""Theorem C's heading, law (4) and the local step scaling."""

import json
import math

import numpy as np
import pytest
from conftest import run_python
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rendezvous_env.compilation import compiled
from rendezvous_env.safety.heading import (
    certified_heading,
    certify,
    flexible_velocity,
    step_scale,
    turn_limit,
)
from train.verify.monitors import unit

pytestmark = pytest.mark.kernels

CONSTANTS = {"min_alignment": 0.1, "dead_zone": 0.1, "max_turn": 0.2}
numbers = st.floats(-3, 3, allow_nan=False, width=32)


def vectors(dim):
    """Vectors including many zeros, unit axes and subnormal parts."""
    return arrays(
        np.float64, dim, elements=st.one_of(numbers, st.sampled_from([0.0, 1.0, -1.0, 1e-300]))
    )


dims = st.sampled_from([2, 3])
triples = dims.flatmap(lambda d: st.tuples(vectors(d), vectors(d), vectors(d)))
constants = st.fixed_dictionaries(
    {
        "min_alignment": st.floats(0.001, 0.999),
        "dead_zone": st.floats(0.01, 1.0),
        "max_turn": st.floats(1e-6, 4.0),
    }
)


def polar(degrees):
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])


def angle_between(a, b):
    """Angle between unit vectors, accurate for small and large angles."""
    return 2 * math.atan2(np.linalg.norm(a - b), np.linalg.norm(a + b))


def by_angles(raw, f, previous, min_alignment, dead_zone, max_turn):
    """Theorem C in the plane with angles relative to f; f, raw and previous are nonzero."""
    half = math.acos(min_alignment * min(max(math.hypot(*f) / dead_zone - 1, 0), 1))
    relative = lambda v: math.remainder(  # noqa: E731
        math.atan2(v[1], v[0]) - math.atan2(f[1], f[0]), math.tau
    )
    carried = relative(previous)
    if abs(carried) > math.pi / 2:
        carried = math.remainder(carried + math.pi, math.tau)
    carried = min(max(carried, -half), half)
    aim = min(max(relative(raw), -half), half)
    turned = carried + min(max(aim - carried, -max_turn), max_turn)
    world = turned + math.atan2(f[1], f[0])
    return np.array([math.cos(world), math.sin(world)])


def test_flexible_velocity_projects_f_on_heading():
    f = np.array([[3.0, 4.0], [3.0, 4.0], [3.0, 4.0]])
    h = np.array([[1.0, 0.0], [0.0, -1.0], [-0.8, 0.6]])
    np.testing.assert_allclose(flexible_velocity(f, h), [[3, 0], [0, 4], [0, 0]], atol=1e-15)
    np.testing.assert_array_equal(flexible_velocity(f, -h), flexible_velocity(f, h))


def test_step_scale_matches_hand_computation():
    scale = step_scale(np.array([0.0, 1.0, 2.0, 4.0]), merge_radius=0.2, duration=0.05)
    np.testing.assert_allclose(scale, [1.0, 1.0, 1.0, 0.5], rtol=1e-15)
    assert step_scale(4.0, 0.2, 0.05).shape == ()


# With f along x, ‖f‖ = 1 ≥ 2δ and ε = 0.5 the cap is ±60°; the limit is 30°.
@pytest.mark.parametrize(
    ("raw", "previous", "expected"),
    [
        (polar(10), polar(0), 10),  # in reach
        (polar(50), polar(0), 30),  # turns by the limit
        (polar(80), polar(40), 60),  # aims at the cap's edge
        (polar(-80), polar(-40), -60),
        (polar(20), polar(180), 20),  # carried: flipped to 0
        (polar(20), polar(200), 20),  # flipped to 20
        (polar(0), polar(85), 30),  # carried is first projected to 60
        (polar(0), polar(100), -30),  # 100 is the line -80, projected to -60
        (polar(170), polar(0), 30),  # a raw vector is not flipped: aims at +60
        (-polar(0), polar(20), 20),  # along -f: stays with the carried heading
        (0 * polar(0), polar(20), 20),
        (5 * polar(25), 7 * polar(0), 25),  # lengths do not matter
        (polar(50), 0 * polar(0), 30),  # none yet: carries f
        (0 * polar(0), 0 * polar(0), 0),
    ],
)
@pytest.mark.parametrize("tilt", [0, 77, 180])
def test_certified_heading_matches_hand_computation(raw, previous, expected, tilt):
    c, s = polar(tilt)
    rotation = np.array([[c, -s], [s, c]])
    vectors = (rotation @ each for each in (raw, [1.0, 0.0], previous))
    h = certified_heading(*vectors, min_alignment=0.5, dead_zone=0.5, max_turn=math.radians(30))
    np.testing.assert_allclose(h, rotation @ polar(expected), atol=1e-7 if tilt else 1e-14)


def test_any_heading_is_allowed_without_net_bearing():
    options = {**CONSTANTS, "max_turn": 0.3}
    first = certified_heading([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], **options)
    np.testing.assert_array_equal(first, [1, 0])
    back = certified_heading([-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], **{**options, "max_turn": 4.0})
    np.testing.assert_array_equal(back, [-1, 0])
    turning = certified_heading([-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], **options)
    np.testing.assert_allclose(turning, [math.cos(0.3), math.sin(0.3)], atol=1e-15)
    vertical = certified_heading([0, 0, -1.0], [0.0, 0, 0], [0, 0, 1.0], **options)
    np.testing.assert_allclose(vertical, [math.sin(0.3), 0, math.cos(0.3)], atol=1e-15)


@pytest.mark.parametrize("noise", [0.0, 1e-17, -1e-12, 1e-8])
def test_antipodal_aim_turns_through_net_bearing(noise):
    f = np.array([0.05, 0.0, 0.0])  # in the dead zone, where the cap is a half sphere
    h = np.array([0.0, 1.0, 0.0])
    options = {**CONSTANTS, "max_turn": 0.5}
    for _ in range(3):
        h = certified_heading([0.0, -1.0, noise], f, h, **options)
    np.testing.assert_allclose(h, [math.sin(1.5), math.cos(1.5), 0], atol=1e-7)


def test_rounding_near_antipodal_directions_is_removed():
    random = np.random.default_rng(9)
    f, h = unit(random.normal(size=(2, 2000, 3)))
    across = unit(np.cross(f, h))
    for size in (1e-8, 2e-6, 1e-4):
        free = certified_heading(-h + size * across, 0 * f, h, **CONSTANTS)
        np.testing.assert_allclose(np.linalg.norm(free, axis=-1), 1, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.sum(free * h, axis=-1), math.cos(0.2), rtol=0, atol=1e-14)
        bound = certified_heading(-f + size * across, f, h, **{**CONSTANTS, "max_turn": 4.0})
        np.testing.assert_allclose(np.sum(bound * f, axis=-1), 0.1, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(bound, axis=-1), 1, rtol=0, atol=1e-14)


@settings(max_examples=400, deadline=None)
@given(triples, constants)
def test_heading_keeps_margin_norm_and_turn_limit(triple, options):
    raw, f, previous = triple
    h = certified_heading(raw, f, previous, **options)
    fade = np.clip(np.linalg.norm(f) / options["dead_zone"] - 1, 0, 1)
    assert h @ f >= options["min_alignment"] * fade * np.linalg.norm(f) - 1e-12
    assert abs(np.linalg.norm(h) - 1) <= 1e-12
    again = certified_heading(raw, f, h, **options)
    turned = angle_between(h, again)
    if abs(h @ f) <= 1e-12 * np.linalg.norm(f):  # across f rounding decides whether h counts as −h
        turned = min(turned, angle_between(-h, again))
    assert turned <= options["max_turn"] + 1e-9


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.floats(-math.pi, math.pi), min_size=3, max_size=3), st.floats(0.01, 3), constants
)
def test_certified_heading_equals_angular_form(angles, strength, options):
    raw, f, previous = (np.array([math.cos(a), math.sin(a)]) for a in angles)
    f = f * strength
    # at the jumps of the law (raw along -f, previous across f) rounding decides
    if raw @ f < -(1 - 1e-9) * strength or abs(previous @ f) < 1e-9 * strength:
        return
    h = certified_heading(raw, f, previous, **options)
    np.testing.assert_allclose(h, by_angles(raw, f, previous, **options), atol=1e-6)


@given(st.integers(0, 2**32 - 1), dims, st.floats(1e-3, 1e3), constants)
def test_certified_heading_is_scale_and_rotation_invariant(seed, dim, scale, options):
    random = np.random.default_rng(seed)
    raw, f, previous = random.normal(size=(3, dim))
    rotation, _ = np.linalg.qr(random.normal(size=(dim, dim)))
    h = certified_heading(raw, f, previous, **options)
    scaled = certified_heading(raw * scale, f, previous / scale, **options)
    np.testing.assert_allclose(scaled, h, atol=1e-9)
    turned = certified_heading(rotation @ raw, rotation @ f, rotation @ previous, **options)
    np.testing.assert_allclose(turned, rotation @ h, atol=1e-6)
    with_scaled_f = {**options, "dead_zone": options["dead_zone"] * scale}
    stretched = certified_heading(raw, f * scale, previous, **with_scaled_f)
    np.testing.assert_allclose(stretched, h, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(triples)
def test_plane_is_slice_of_3d(triple):
    raw, f, previous = (np.append(v[:2], 0.0) for v in triple)
    in_space = certified_heading(raw, f, previous, **CONSTANTS)
    in_plane = certified_heading(raw[:2], f[:2], previous[:2], **CONSTANTS)
    assert in_space[2] == 0.0
    np.testing.assert_allclose(in_space[:2], in_plane, atol=1e-6)  # what is across f may be tiny


@pytest.mark.parametrize("dim", [2, 3])
def test_batch_equals_singles(dim):
    raw, f, previous = np.random.default_rng(1).normal(size=(3, 4, 5, dim))
    h = certified_heading(raw, f, previous, **CONSTANTS)
    assert h.shape == (4, 5, dim) and h.dtype == np.float64
    single = certified_heading(raw[2, 3], f[2, 3], previous[2, 3], **CONSTANTS)
    np.testing.assert_array_equal(h[2, 3], single)
    swapped = (each.swapaxes(0, 1) for each in (raw, f, previous))
    strided = certified_heading(*swapped, **CONSTANTS)
    np.testing.assert_array_equal(strided.swapaxes(0, 1), h)
    in_place = previous.reshape(-1, dim).copy()
    certify(raw.reshape(-1, dim), f.reshape(-1, dim), in_place, 0.1, 0.1, 0.2, in_place)
    np.testing.assert_array_equal(in_place, h.reshape(-1, dim))
    assert certified_heading(raw[:0], f[:0], previous[:0], **CONSTANTS).shape == (0, 5, dim)


@pytest.mark.parametrize("huge", [1e-300, 1e-160, 1e160, 1e300])
def test_extreme_lengths_are_safe(huge):
    options = {"min_alignment": 0.1, "dead_zone": huge / 4, "max_turn": 4.0}
    with np.errstate(over="ignore"):  # numpy warns where kernels are not compiled
        h = certified_heading([0.6 * huge, 0.8 * huge], [huge, 0], [huge, 0], **options)
    np.testing.assert_allclose(h, [0.6, 0.8], rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"min_alignment": 0.99e-6}, "at least 1e-06"),
        ({"min_alignment": 1.0}, "min_alignment is 1.0"),
        ({"min_alignment": math.nan}, "min_alignment is nan"),
        ({"dead_zone": 0.0}, "dead_zone is 0.0"),
        ({"dead_zone": math.inf}, "dead_zone is inf"),
        ({"max_turn": -0.1}, "max_turn is -0.1"),
        ({"max_turn": math.nan}, "max_turn is nan"),
        ({"raw": np.zeros((5, 2))}, r"raw has shape \(5, 2\)"),
        ({"previous": np.zeros(3)}, r"previous has shape \(3,\)"),
        ({"net_bearing": np.zeros((4, 4))}, r"net_bearing has shape \(4, 4\)"),
        ({"net_bearing": 1.0}, r"net_bearing has shape \(\)"),
        ({"raw": np.full((4, 2), np.nan)}, r"raw is \[nan, nan\]; it must be finite"),
    ],
)
def test_errors_name_argument(change, message):
    good = {"raw": np.ones((4, 2)), "net_bearing": np.ones((4, 2)), "previous": np.ones((4, 2))}
    with pytest.raises(ValueError, match=message):
        certified_heading(**{**good, **CONSTANTS, **change})


def test_unlimited_turn_needs_no_compiler():
    """Python's cosine of infinity is an error."""
    cosine, sine, square = turn_limit.py_func(np.inf) if compiled() else turn_limit(np.inf)
    assert (cosine, square) == (-1.0, np.inf)
    assert sine == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("dim", [2, 3])
def test_interpreted_heading_where_f_is_zero_is_the_compiled_one(dim, tmp_path):
    """Plain Python raises where a compiled kernel computes an unused NaN."""
    ahead, none = np.eye(dim)[0], np.zeros(dim)
    rows = [(q, f, h) for q in (ahead, -ahead, none) for f in (none, ahead) for h in (-ahead, none)]
    given = [list(map(np.ndarray.tolist, row)) for row in rows]
    script = (
        "import json, sys, numpy as np\n"
        "from rendezvous_env import certified_heading\n"
        "told = dict(min_alignment=0.1, dead_zone=0.1, max_turn=0.2)\n"
        "for row in json.loads(sys.argv[1]):\n"
        "    print(json.dumps(certified_heading(*map(np.array, row), **told).tolist()))"
    )
    done = run_python(tmp_path, "-c", script, json.dumps(given), NUMBA_DISABLE_JIT="1")
    wanted = [certified_heading(*row, **CONSTANTS) for row in rows]
    found = [json.loads(line) for line in done.stdout.splitlines()]
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert np.isfinite(wanted).all()
