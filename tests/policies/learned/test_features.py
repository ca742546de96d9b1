"""Features of learned policies, with and without a tank, computed by hand."""

import numpy as np
import pytest
from geometry import along

from baselines.learned.feature_kernels import CONTEXT_COLUMNS, LEVEL_COLUMNS, WALL_COLUMNS
from baselines.learned.features import Features
from rendezvous_env import Scenario, Simulator
from rendezvous_env.scenario import scenarios

pytestmark = pytest.mark.kernels

TEAMS = 6
CLUTTER = scenarios.get("clutter-16")
NO_HEADINGS = np.zeros((TEAMS, CLUTTER.n_robots, 2))
PAIR = Scenario(n_robots=3, obstacles=CLUTTER.obstacles)
"""Two neighbour rows and sixteen obstacles."""
NOTHING = np.zeros((1, 3, 2))
TIME = 0.5


def look(f, *edges, other=None):
    """Observations (1, 3, rows, 2) with data of robot 0 only.

    It has a neighbour along f, optionally another, and obstacles between edges, in degrees.
    """
    observations = np.zeros((1, 3, *PAIR.observation_layout.shape), dtype=np.float32)
    for row, angle in enumerate((f, other, *edges)):
        observations[0, 0, row] = 0.0 if angle is None else along(angle)
    return observations


def perceive(perception, observations):
    return perception.layout.split(perception.see(observations, NOTHING))


def test_features_match_hand_computation():
    """Neighbours along 30° and 150°, gains 1 and 1: f points to 90° with length 1."""
    perception = Features(PAIR, 1, decision_time=0.2)
    shown = perceive(perception, look(30, 100, 85, other=150))
    np.testing.assert_allclose(
        shown.neighbours[0, 0], [[0.5, -np.sqrt(0.75), 1], [0.5, np.sqrt(0.75), 1]], atol=1e-6
    )
    np.testing.assert_allclose(shown.obstacles[0, 0, 0], [*along(10, -5).ravel(), 0, 0], atol=1e-6)
    assert not shown.obstacles[0, 0, 1:].any()
    expected = [
        0.5, 1.0, 0.5, 0.0, 1.0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0,
        0.0, 1.0, *np.radians([10, -5, 345, 345]),
    ]  # fmt: skip
    np.testing.assert_allclose(shown.context[0, 0], expected, atol=1e-5)
    assert not any(part[0, 1:].any() for part in shown)  # robots without neighbours


def test_edge_rates_are_measured():
    """The counter-clockwise edge rotates by 4° in 0.2 s, f with the frame by −30°."""
    perception = Features(PAIR, 1, decision_time=0.2)
    perceive(perception, look(0, 50, 20))
    shown = perceive(perception, look(-30, 54, 20))
    np.testing.assert_allclose(
        shown.obstacles[0, 0, 0], [*along(84, 50).ravel(), np.radians(4) / 0.2, 0], atol=1e-5
    )
    perceive(perception, look(0))  # out of sight: forgotten
    again = perceive(perception, look(0, 50, 20))
    assert not again.obstacles[0, 0, 0, 4:].any()


def test_motion_memory_matches_hand_computation():
    """f along the local y axis, then along x, at 1 m/s; the carried heading is along y."""
    perception = Features(PAIR, 1, decision_time=TIME)
    headings = NOTHING.copy()
    perception.see(look(90), headings)
    headings[0, 0] = along(90)
    perception.see(look(90), headings)
    shown = perception.layout.split(perception.see(look(0), headings)).context[0, 0]
    short, long = np.exp(-0.5), np.exp(-0.1)
    speed = 1.0  # hᵀf in the second decision; in the third h is across f
    expected = [
        1.0 / 60, np.exp(-1.0 / 8), 0, short * (1 - short) * speed, 0, long * (1 - long) * speed,
        1 - short, short, 1 - long, long, -3.0, 0, 1,  # π/2 in half a second, cut off
    ]  # fmt: skip
    np.testing.assert_allclose(shown[3:16], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        ((), [0, 0, 0, 0, 0, 0]),
        ((50, 40), [0, 1, *np.radians([50, 40, 350, 350])]),
        ((20, -20, 60, 10), [0, 1, *np.radians([60, -20, 280, 280])]),
        ((20, -20, 60, 50), [0, 1, *np.radians([20, -20, 30, 280])]),
        ((89, -89, -160, 70, -70, 170), [1, 0, 0, 0, 0, 0]),
    ],
)
def test_silhouettes_before_f_are_merged(edges, expected):
    shown = perceive(Features(PAIR, 1, decision_time=0.2), look(0, *edges))
    np.testing.assert_allclose(shown.context[0, 0, 16:], expected, atol=1e-6)


def test_unused_obstacle_slots_are_absent():
    observations = Simulator(CLUTTER, TEAMS).reset(3)
    wide = Features(CLUTTER, TEAMS, decision_time=0.2, obstacle_slots=24)
    shown = wide.layout.split(wide.see(observations, NO_HEADINGS))
    own = Features(CLUTTER, TEAMS, decision_time=0.2)
    exact = own.layout.split(own.see(observations, NO_HEADINGS))
    np.testing.assert_array_equal(shown.obstacles[:, :, :16], exact.obstacles)
    assert exact.obstacles.any()
    assert not shown.obstacles[:, :, 16:].any()
    np.testing.assert_array_equal(shown.context, exact.context)
    with pytest.raises(ValueError, match=r"obstacle_slots is 8.*needs 16 or more"):
        Features(CLUTTER, TEAMS, decision_time=0.2, obstacle_slots=8)


def tank_features(columns):
    return Features(PAIR, 1, decision_time=TIME, tank_columns=columns)


def see_tank(perception, observations, level=0.0, heading=0.0, velocity=None):
    """Columns of robot 0 in addition to those of ``Features``."""
    headings, velocities = NOTHING.copy(), NOTHING.copy()
    headings[0, 0] = along(heading)
    velocities[0, 0] = [0.0, 0.0] if velocity is None else velocity
    levels = np.array([[level, 7.0, 7.0]])
    shown = perception.see(observations, headings, velocities=velocities, levels=levels)
    assert not shown[0, 1:].any()  # no neighbour: nothing, not even a level
    return shown[0, 0, -perception.layout.tank_columns :]


@pytest.mark.parametrize("walls", [0, WALL_COLUMNS])
def test_tank_adds_energy_columns(walls):
    own = Features(PAIR, 1, decision_time=TIME)
    tank = tank_features(LEVEL_COLUMNS + walls)
    velocities, headings = NOTHING + 0.3, NOTHING + np.sqrt(0.5)
    for f, level in ((0, 0.0), (20, 0.01), (40, 33.3)):
        given = {"velocities": velocities, "levels": np.full((1, 3), level)}
        plain = own.see(look(f, f + 10, f - 20), headings, velocities=velocities)
        shown = tank.see(look(f, f + 10, f - 20), headings, **given)
        np.testing.assert_array_equal(shown[..., : plain.shape[-1]], plain)
        context = tank.layout.split(shown).context[0, 0]
        assert len(context) == CONTEXT_COLUMNS + LEVEL_COLUMNS + walls
        assert context[CONTEXT_COLUMNS] == pytest.approx(np.log1p(level), rel=1e-6)


def test_wall_memory_tracks_contact_with_wall():
    """The wall blocks f for two decisions; f rotates by 30° and the heading by −90°."""
    perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    away = see_tank(perception, look(0), level=3.0)
    assert not away[1:7].any()
    met = see_tank(perception, look(0, 20, -20), level=3.0)
    first = [1, np.log1p(3), TIME / 30, np.exp(-TIME / 8), 0, 0]
    np.testing.assert_allclose(met[1:7], first, rtol=1e-6)
    perception.note(np.array([[0.6, 0.0, 0.0]]))
    beside = see_tank(perception, look(30, 60, 0), level=1.0, heading=-90)
    expected = [
        np.log1p(1), 1, np.log1p(3), 2 * TIME / 30, np.exp(-2 * TIME / 8), 1 / 6, -0.5,
        np.cos(0.6), np.sin(0.6),
    ]  # fmt: skip
    np.testing.assert_allclose(beside[:9], expected, rtol=1e-5)
    for k in range(4):  # two seconds without a wall, and it is still the same wall
        assert see_tank(perception, look(30))[1] == 1, k
    left = see_tank(perception, look(30))
    assert not left[1:7].any()
    again = see_tank(perception, look(30, 40, 20), level=9.0)
    np.testing.assert_allclose(again[1:4], [1, np.log1p(9), TIME / 30], rtol=1e-6)


def test_long_averages_rotate_with_f():
    perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    kept = np.exp(-TIME / 20)
    np.testing.assert_allclose(see_tank(perception, look(0), velocity=[0.0, 0.0])[9:], [0, 0, 1, 0])
    turned = see_tank(perception, look(90), velocity=[0.0, 1.0])
    expected = [1 - kept, 0, 1 - kept, -kept]  # along and across f, which now is local y
    np.testing.assert_allclose(turned[9:], expected, atol=1e-6)


def test_memory_decays_in_seconds():
    """Five seconds of equal motion along a wall, for any decision period."""
    told, headings, moving = [], NOTHING.copy(), NOTHING.copy()
    headings[0, 0], moving[0, 0] = along(150), [0.0, 0.5]
    seen, levels = look(90, 120, 60), np.array([[2.0, 0.0, 0.0]])
    for cuts in ([1.25] * 4, [0.3, 3.1, 0.05, 1.55], [5.0]):
        perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
        shown = perception.see(seen, headings, levels=levels, velocities=NOTHING)
        for time in cuts:
            more = {"levels": levels, "velocities": moving, "elapsed": np.array([time])}
            shown = perception.see(seen, headings, **more)
        told.append(shown[0, 0])
    np.testing.assert_allclose(told[1:], [told[0]] * 2, atol=1e-6)
    context = perception.layout.split(told[0]).context
    short = 0.5 * (1 - np.exp(-5.0))  # forward, along f
    np.testing.assert_allclose(context[3:7], [5 / 60, np.exp(-5 / 8), short, 0.0], atol=1e-6)
    since = context[CONTEXT_COLUMNS + LEVEL_COLUMNS + 2]
    np.testing.assert_allclose(since, (TIME + 5.0) / 30.0, rtol=1e-6)  # since it was met
    with pytest.raises(ValueError, match=r"elapsed has shape \(2,\); it must be \(B,\)"):
        perception.see(seen, headings, elapsed=np.ones(2))
