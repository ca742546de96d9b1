"""What a learned policy is shown, against observations written by hand."""

import numpy as np
import pytest

import baselines
from baselines.learned.features import (
    CONTEXT_COLUMNS,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    FeatureLayout,
    Features,
)
from rendezvous_env import Scenario, Simulator
from rendezvous_env.scenario import scenarios

TEAMS = 6
CLUTTER = scenarios.get("clutter-16")
NO_HEADINGS = np.zeros((TEAMS, CLUTTER.n_robots, 2))
PAIR = Scenario(n_robots=3, obstacles=CLUTTER.obstacles)
"""Two neighbour rows and sixteen obstacles."""


def unit(degrees):
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def one(rows):
    """Observations (1, 3, rows, 2): robot 0 sees these rows, the others nothing."""
    observations = np.zeros((1, 3, *PAIR.observation_layout.shape), dtype=np.float32)
    for row, vector in rows.items():
        observations[0, 0, row] = vector
    return observations


def perceive(perception, observations, which=None):
    scenario = PAIR if observations.shape[1] == 3 else CLUTTER
    headings = np.zeros((len(observations), scenario.n_robots, 2))
    return perception.layout.split(perception.see(observations, headings, which))


def cluttered(steps=40):
    """Observations of teams in the middle of clutter."""
    simulator = Simulator(CLUTTER, TEAMS)
    observations = simulator.reset(3)
    for _ in range(steps):
        law = baselines.make("bearing-only", CLUTTER)
        observations = simulator.step(law(observations, 0.0)).observations
    return observations


def test_columns():
    layout = FeatureLayout(3, 5)
    assert layout.size == 3 * NEIGHBOUR_COLUMNS + 5 * OBSTACLE_COLUMNS + CONTEXT_COLUMNS
    numbers = np.arange(2 * layout.size).reshape(2, layout.size)
    parts = layout.split(numbers)
    assert [part.shape[1:] for part in parts] == [(3, 3), (5, 6), (CONTEXT_COLUMNS,)]
    joined = np.concatenate([part.reshape(2, -1) for part in parts], axis=1)
    np.testing.assert_array_equal(joined, numbers)


def test_a_robot_by_hand():
    """Neighbours along 30° and 150°, gains 1 and 1: f points to 90° with length 1."""
    perception = Features(PAIR, 1, decision_time=0.2)
    edges = {2: unit(100), 3: unit(85)}
    shown = perceive(perception, one({0: unit(30), 1: unit(150)} | edges))
    np.testing.assert_allclose(
        shown.neighbours[0, 0], [[0.5, -np.sqrt(0.75), 1], [0.5, np.sqrt(0.75), 1]], atol=1e-6
    )
    np.testing.assert_allclose(shown.obstacles[0, 0, 0], [*unit(10), *unit(-5), 0, 0], atol=1e-6)
    assert not shown.obstacles[0, 0, 1:].any()
    expected = [
        0.5, 1.0, 0.5, 0.0, 1.0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0,
        0.0, 1.0, *np.radians([10, -5, 345, 345]),
    ]  # fmt: skip
    np.testing.assert_allclose(shown.context[0, 0], expected, atol=1e-5)
    assert not any(part[0, 1:].any() for part in shown)  # robots without neighbours


def test_how_fast_edges_turn():
    """The counter-clockwise edge turns by 4° in 0.2 s, f with the frame by −30°."""
    perception = Features(PAIR, 1, decision_time=0.2)
    perceive(perception, one({0: unit(0), 2: unit(50), 3: unit(20)}))
    shown = perceive(perception, one({0: unit(-30), 2: unit(54), 3: unit(20)}))
    np.testing.assert_allclose(
        shown.obstacles[0, 0, 0], [*unit(84), *unit(50), np.radians(4) / 0.2, 0], atol=1e-5
    )
    perceive(perception, one({0: unit(0)}))  # out of sight: forgotten
    again = perceive(perception, one({0: unit(0), 2: unit(50), 3: unit(20)}))
    assert not again.obstacles[0, 0, 0, 4:].any()


def test_what_a_robot_remembers_of_its_motion():
    """f along the local y axis and then along x, at 1 m/s; the heading carried is along y."""
    perception = Features(PAIR, 1, decision_time=0.5)
    headings = np.zeros((1, 3, 2))
    perception.see(one({0: unit(90)}), headings)
    headings[0, 0] = unit(90)
    perception.see(one({0: unit(90)}), headings)
    shown = perception.layout.split(perception.see(one({0: unit(0)}), headings)).context[0, 0]
    short, long = np.exp(-0.5), np.exp(-0.1)
    speed = 1.0  # hᵀf in the second decision; in the third h is across f
    for place, kept in ((5, short), (7, long)):
        np.testing.assert_allclose(
            shown[place : place + 2], [0, kept * (1 - kept) * speed], atol=1e-6
        )
    for place, kept in ((9, short), (11, long)):
        np.testing.assert_allclose(shown[place : place + 2], [1 - kept, kept], atol=1e-6)
    np.testing.assert_allclose(shown[3:5], [1.0 / 60, np.exp(-1.0 / 8)], atol=1e-6)
    np.testing.assert_allclose(shown[13], -3.0, atol=1e-6)  # π/2 in half a second, cut off
    np.testing.assert_allclose(shown[14:16], [0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        ({}, [0, 0, 0, 0, 0, 0]),
        ({2: unit(50), 3: unit(40)}, [0, 1, *np.radians([50, 40, 350, 350])]),
        ({2: unit(20), 3: unit(-20), 4: unit(60), 5: unit(10)},
         [0, 1, *np.radians([60, -20, 280, 280])]),
        ({2: unit(20), 3: unit(-20), 4: unit(60), 5: unit(50)},
         [0, 1, *np.radians([20, -20, 30, 280])]),
        ({2: unit(89), 3: unit(-89), 4: unit(-160), 5: unit(70), 6: unit(-70), 7: unit(170)},
         [1, 0, 0, 0, 0, 0]),
    ],
)  # fmt: skip
def test_silhouettes_joined_before_f(edges, expected):
    shown = perceive(Features(PAIR, 1, decision_time=0.2), one({0: unit(0)} | edges))
    np.testing.assert_allclose(shown.context[0, 0, 16:], expected, atol=1e-6)


def test_only_teams_of_the_mask_remember():
    observations, later = cluttered(), cluttered(44)
    which = np.arange(TEAMS) % 2 == 0
    one, other = (Features(CLUTTER, TEAMS, decision_time=0.2) for _ in range(2))
    for perception in (one, other):
        perception.see(observations, NO_HEADINGS)
    part = one.see(later, NO_HEADINGS, which)
    whole = other.see(later, NO_HEADINGS)
    np.testing.assert_array_equal(part[which], whole[which])
    assert not part[~which].any()
    rest = one.see(later, NO_HEADINGS, ~which)
    np.testing.assert_array_equal(rest[~which], whole[~which])


def test_further_obstacle_slots_are_absent():
    observations = cluttered()
    wide = Features(CLUTTER, TEAMS, decision_time=0.2, obstacle_slots=24)
    shown = wide.layout.split(wide.see(observations, NO_HEADINGS))
    own = Features(CLUTTER, TEAMS, decision_time=0.2)
    exact = own.layout.split(own.see(observations, NO_HEADINGS))
    np.testing.assert_array_equal(shown.obstacles[:, :, :16], exact.obstacles)
    assert not shown.obstacles[:, :, 16:].any()
    np.testing.assert_array_equal(shown.context, exact.context)
    with pytest.raises(ValueError, match=r"obstacle_slots is 8.*needs 16 or more"):
        Features(CLUTTER, TEAMS, decision_time=0.2, obstacle_slots=8)


def test_memory_runs_in_seconds_not_in_decisions():
    """Two seconds of the same motion leave the same memory, however they are cut."""
    told, velocities = [], np.zeros((1, 3, 2))
    for cuts in ([0.5] * 4, [0.1, 0.7, 0.04, 1.16], [2.0]):
        perception = Features(PAIR, 1, decision_time=0.2)
        headings, observations = np.zeros((1, 3, 2)), one({0: unit(90)})
        perception.see(observations, headings, velocities=velocities)
        for time in cuts:
            shown = perception.see(
                observations,
                headings,
                velocities=velocities + np.array([0.0, 0.5]),
                elapsed=np.array([time]),
            )
        told.append(shown[0, 0])
    np.testing.assert_allclose(told[1:], [told[0], told[0]], atol=1e-6)
    context = perception.layout.split(told[0]).context
    short = 0.5 * (1 - np.exp(-2.0))  # forward, along f
    np.testing.assert_allclose(context[3:7], [2 / 60, np.exp(-2 / 8), short, 0.0], atol=1e-6)
    with pytest.raises(ValueError, match=r"elapsed have shape \(2,\); they must be \(B,\)"):
        perception.see(one({0: unit(90)}), headings, elapsed=np.ones(2))
