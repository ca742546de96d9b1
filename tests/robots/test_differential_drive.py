"""Differential drive under a policy: wheel speeds, and velocities that avoid collisions."""

import itertools

import numpy as np
import pytest

from rendezvous_env.robots.differential_drive import DifferentialDrive, Machine, keep_apart

PIONEER = Machine(0.1, 0.4, 0.2, 8.0, 20.0, 0.3)
FREE = PIONEER._replace(wheel_acceleration=np.inf)


def test_point_ahead_follows_velocity():
    """A body with rates ω and v moves P with v (c, s) + l ω (−s, c)."""
    drive = DifferentialDrive(FREE._replace(wheel_speed=1e3))
    for x, y, yaw in itertools.product((-0.3, 0.2), (-0.1, 0.4), (0.0, 1.0, 3.0, -2.0)):
        v, omega = drive.command((x, y), yaw, 0.1)
        c, s = np.cos(yaw), np.sin(yaw)
        moved = v * np.array([c, s]) + 0.2 * omega * np.array([-s, c])
        np.testing.assert_allclose(moved, [x, y], atol=1e-12)


def test_wheel_speeds_match_hand_computation():
    """L = 0.4 m, R = 0.1 m: at 0.5 m/s and 1 rad/s the rims move at 0.3 and 0.7 m/s."""
    drive = DifferentialDrive(FREE)
    assert drive.command((0.5, 0.2), 0.0, 0.05) == pytest.approx((0.5, 1.0))
    assert drive.wheels == pytest.approx((3.0, 7.0))


def test_wheel_speed_limit_preserves_direction():
    drive = DifferentialDrive(FREE)
    v, omega = drive.command((3.0, 1.0), 0.0, 0.05)
    assert 8.0 > max(np.abs(drive.wheels)) == pytest.approx(8.0)
    assert omega * FREE.lead / v == pytest.approx(1.0 / 3.0)


def test_acceleration_limit_synchronises_wheels():
    """20 rad/s² for 0.05 s is 1 rad/s per tick: the faster wheel, at 7 rad/s, needs 7 ticks."""
    drive, wheels = DifferentialDrive(PIONEER), []
    for _ in range(10):
        drive.command((0.5, 0.2), 0.0, 0.05)
        wheels.append(drive.wheels)
    shares = np.minimum(np.arange(1, 11), 7) / 7
    np.testing.assert_allclose(wheels, np.outer(shares, (3.0, 7.0)), atol=1e-12)


def test_missing_command_holds_then_brakes():
    drive = DifferentialDrive(PIONEER)
    for _ in range(20):
        moving = drive.command((0.5, 0.0), 0.0, 0.05)
    assert [drive.hold(0.1), drive.hold(0.1)] == [moving, moving]
    after = [drive.hold(0.1)[0] for _ in range(4)]
    assert after == pytest.approx([0.3, 0.1, 0.0, 0.0])
    assert drive.command((0.5, 0.0), 0.0, 0.1)[0] == pytest.approx(0.2)


def test_invalid_machine_is_rejected():
    for field, value in (("wheel_radius", 0.0), ("lead", -0.1), ("wheel_speed", np.inf)):
        with pytest.raises(ValueError, match=f"{field} is {value}; it must be a positive"):
            DifferentialDrive(Machine(**{field: value}))
    with pytest.raises(ValueError, match=r"machine is 0\.05; it must be a Machine"):
        DifferentialDrive(0.05)


@pytest.mark.parametrize(
    ("told", "message"),
    [
        (((np.nan, 0.0), 0.0, 0.1), r"velocity is \[nan, 0\.0\]; it must be two finite numbers"),
        (((1e308, 1e308), 0.0, 0.1), r"velocity is \[1e\+308, 1e\+308\]; it must be two finite"),
        (((1.0, 0.0), np.inf, 0.1), "yaw is inf; it must be a finite number"),
        (((1.0, 0.0), 0.0, 0.0), r"dt is 0\.0; it must be a positive"),
    ],
)
def test_invalid_command_changes_nothing(told, message):
    drive = DifferentialDrive(PIONEER)
    before = drive.command((0.1, 0.0), 0.0, 1.0)
    with pytest.raises(ValueError, match=message):
        drive.command(*told)
    assert drive.hold(0.01) == before


class TestKeepApart:
    def test_keep_apart_matches_hand_computation(self):
        assert keep_apart((1.0, 2.0), []) == (1.0, 2.0)
        assert keep_apart((1.0, 2.0), [(1.0, 0.0)]) == pytest.approx((0.0, 2.0))
        assert keep_apart((1.0, 2.0), [(1.0, 0.0)], 0.4) == pytest.approx((0.4, 2.0))
        corner = [(1.0, 0.0), (0.0, 1.0)]
        assert keep_apart((1.0, 2.0), corner, (0.4, -1.0)) == pytest.approx((0.4, 0.0))
        all_round = [(1, 0), (0, 1), (-1, 0), (0, -1)]
        assert keep_apart((1.0, 2.0), all_round) == pytest.approx((0.0, 0.0))

    def test_keep_apart_is_closest_admissible(self):
        """Candidates: the desired velocity, its projections on the borders, their intersections."""
        random = np.random.default_rng(0)
        for _ in range(300):
            angles = random.uniform(-np.pi, np.pi, random.integers(1, 8))
            g = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            c, w = random.uniform(0.0, 0.5, len(g)), random.normal(size=2)
            feet = w - (g @ w - c)[:, None] * g
            pairs = [list(pair) for pair in itertools.combinations(range(len(g)), 2)]
            corners = [np.linalg.solve(g[pair], c[pair]) for pair in pairs]
            fitting = [x for x in (w, *feet, *corners) if (g @ x <= c + 1e-9).all()]
            best = min(fitting, key=lambda x, w=w: np.sum((x - w) ** 2))
            np.testing.assert_allclose(keep_apart(w, g, c), best, atol=1e-9)

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            (((1.0, 2.0, 3.0), []), r"velocity is \[1\.0, 2\.0, 3\.0\]; it must be two finite"),
            (((1.0, 0.0), [(np.nan, 0.0)]), r"near is \[\[nan, 0\.0\]\]; it must be unit vectors"),
            (((1.0, 0.5), [(5.0, 0.0)]), r"near is \[\[5\.0, 0\.0\]\]; it must be unit vectors"),
            (((1.0, 0.5), [1, 0, 0]), r"near is \[\[1\.0, 0\.0, 0\.0\]\]; it must be unit vectors"),
            (((0.2, 0.1), [(1.0, 0.0)], np.nan), "rooms is nan; it must be one number"),
            (((0.2, 0.1), [(1.0, 0.0)], (0.1, 0.2)), r"rooms is \[0\.1, 0\.2\]; .* each of 1 dir"),
        ],
    )
    def test_keep_apart_rejects_invalid_input(self, given, message):
        with pytest.raises(ValueError, match=message):
            keep_apart(*given)

    def test_keep_apart_accepts_nearly_unit_vectors_and_no_bound(self):
        ahead = np.float32([[1.0005, 0.0]])
        assert keep_apart((1.0, 2.0), ahead, np.inf) == (1.0, 2.0)
        assert keep_apart((1.0, 2.0), ahead, [0.0]) == pytest.approx((0.0, 2.0))
        assert keep_apart((1.0, 2.0), ahead, 0.5) == pytest.approx((0.5, 2.0))  # and no farther
