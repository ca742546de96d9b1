"""What a tank adds to perception, against observations written by hand."""

import numpy as np
import pytest

from baselines.learned.features import CONTEXT_COLUMNS, LEVEL_COLUMNS, Features
from baselines.learned.wall_memory import WALL_COLUMNS
from rendezvous_env import Scenario
from rendezvous_env.scenario import scenarios

PAIR = Scenario(n_robots=2, obstacles=scenarios.get("clutter-4").obstacles)
TIME = 0.5
NOTHING = np.zeros((1, 2, 2))


def tank_features(columns):
    return Features(PAIR, 1, decision_time=TIME, tank_columns=columns)


def unit(degrees):
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def look(f, *edges):
    """Observations of two robots; robot 0 sees its neighbour at f and an obstacle, in degrees."""
    observations = np.zeros((1, 2, *PAIR.observation_layout.shape), dtype=np.float32)
    for row, angle in enumerate((f, *edges)):
        observations[0, 0, row] = unit(angle)
    return observations


def see(perception, observations, level=0.0, heading=0.0, velocity=None):
    """The columns of robot 0 beyond those of ``Features``."""
    headings, velocities = NOTHING.copy(), NOTHING.copy()
    headings[0, 0] = unit(heading)
    velocities[0, 0] = [0.0, 0.0] if velocity is None else velocity
    levels = np.array([[level, 7.0]])
    shown = perception.see(observations, headings, velocities=velocities, levels=levels)
    assert not shown[0, 1].any()  # no neighbour: nothing, not even a level
    return shown[0, 0, -perception.layout.tank_columns :]


def test_the_level_keeps_its_resolution():
    perception = tank_features(LEVEL_COLUMNS)
    assert perception.layout.tank_columns == LEVEL_COLUMNS
    for level in (0.0, 0.01, 33.3):
        np.testing.assert_allclose(see(perception, look(0), level), [np.log1p(level)], rtol=1e-6)


def test_the_other_columns_are_those_of_perception():
    own = Features(PAIR, 1, decision_time=TIME)
    tank = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    velocities, headings = np.full((1, 2, 2), 0.3), np.full((1, 2, 2), np.sqrt(0.5))
    for f in (0, 20, 40):
        plain = own.see(look(f, f + 10, f - 20), headings, velocities=velocities)
        shown = tank.see(
            look(f, f + 10, f - 20), headings, velocities=velocities, levels=np.ones((1, 2))
        )
        np.testing.assert_array_equal(shown[..., : plain.shape[-1]], plain)
        parts = tank.layout.split(shown)
        assert parts.context.shape[-1] == CONTEXT_COLUMNS + LEVEL_COLUMNS + WALL_COLUMNS


def test_a_wall_is_met_walked_along_and_left():
    """It stands before f for two decisions, while f turns by 30° and the heading by −90°."""
    perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    away = see(perception, look(0), level=3.0)
    assert not away[1:7].any()
    met = see(perception, look(0, 20, -20), level=3.0)
    first = [1, np.log1p(3), TIME / 30, np.exp(-TIME / 8), 0, 0]
    np.testing.assert_allclose(met[1:7], first, rtol=1e-6)
    perception.note(np.array([[0.6, 0.0]]))
    along = see(perception, look(30, 60, 0), level=1.0, heading=-90)
    expected = [
        np.log1p(1), 1, np.log1p(3), 2 * TIME / 30, np.exp(-2 * TIME / 8), 1 / 6, -0.5,
        np.cos(0.6), np.sin(0.6),
    ]  # fmt: skip
    np.testing.assert_allclose(along[:9], expected, rtol=1e-5)
    for k in range(4):  # two seconds without a wall, and it is still the same wall
        assert see(perception, look(30))[1] == 1, k
    left = see(perception, look(30))
    assert not left[1:7].any()
    again = see(perception, look(30, 40, 20), level=9.0)
    np.testing.assert_allclose(again[1:4], [1, np.log1p(9), TIME / 30], rtol=1e-6)


def test_long_averages_are_in_the_frame_along_f():
    perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    kept = np.exp(-TIME / 20)
    np.testing.assert_allclose(see(perception, look(0), velocity=[0.0, 0.0])[9:], [0, 0, 1, 0])
    turned = see(perception, look(90), velocity=[0.0, 1.0])
    expected = [1 - kept, 0, 1 - kept, -kept]  # along and across f, which now is local y
    np.testing.assert_allclose(turned[9:], expected, atol=1e-6)


def test_memory_is_kept_put_back_and_forgotten():
    perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    fresh = see(perception, look(0, 20, -20), level=2.0)
    perception.note(np.array([[1.0, 0.0]]))
    state = perception.get_state()
    later = see(perception, look(40, 60, 0), level=1.0)
    other = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
    other.set_state(state)
    np.testing.assert_array_equal(see(other, look(40, 60, 0), level=1.0), later)
    perception.forget(np.array([True]))
    np.testing.assert_array_equal(see(perception, look(0, 20, -20), level=2.0), fresh)
    with pytest.raises(ValueError, match="wall_since must be an array of shape"):
        other.set_state({**state, "wall_since": np.zeros(3)})


def test_the_wall_is_remembered_in_seconds_not_in_decisions():
    """Five seconds along the same wall, however they are cut."""
    told, headings, moving = [], NOTHING.copy(), NOTHING.copy()
    headings[0, 0], moving[0, 0] = unit(60), 0.5 * unit(60)
    levels = np.array([[2.0, 0.0]])
    for cuts in ([1.25] * 4, [0.3, 3.1, 0.05, 1.55], [5.0]):
        perception = tank_features(LEVEL_COLUMNS + WALL_COLUMNS)
        seen = {"levels": levels, "velocities": NOTHING}
        shown = perception.see(look(0, 30, -30), headings, **seen)
        for time in cuts:
            shown = perception.see(
                look(0, 30, -30),
                headings,
                levels=levels,
                velocities=moving,
                elapsed=np.array([time]),
            )
        told.append(shown[0, 0, -perception.layout.tank_columns :])
    np.testing.assert_allclose(told[1:], [told[0]] * 2, atol=1e-6)
    np.testing.assert_allclose(told[0][3], (TIME + 5.0) / 30.0, rtol=1e-6)  # since it was met
