"""What is given to a simulator: starts, seeds, masks, actions; what of it is refused."""

import copy

import numpy as np
import pytest
from conftest import UNEQUAL, actions_shape, assert_same_state, five, refusing, started
from test_restart import halfway
from test_simulator import STARTS, attitudes, start

from rendezvous_env import Disc, Scenario, graphs
from rendezvous_env.engine.stages.step import step_blocks


def test_a_given_start_is_taken(kind):
    scenario = five(kind)
    weights = UNEQUAL.copy()
    weights[0, 1] = weights[1, 0] = 1.7
    options = start(scenario, STARTS[scenario.dim], weights=weights)
    sim = started(scenario, 32, **options)
    np.testing.assert_array_equal(sim.positions, STARTS[scenario.dim])
    np.testing.assert_array_equal(sim.weights, np.tile(weights, (32, 1, 1)))
    if scenario.model.nonholonomic:
        np.testing.assert_array_equal(sim.headings, attitudes(scenario))
    sim.reset(0, {"positions": STARTS[scenario.dim][0]})  # one for all
    np.testing.assert_array_equal(sim.positions, np.tile(STARTS[scenario.dim][0], (32, 1, 1)))
    sim.reset(0)
    np.testing.assert_array_equal(sim.weights[31], UNEQUAL)
    assert not np.array_equal(sim.positions, STARTS[scenario.dim])


def test_given_parts_leave_the_draws_of_the_others_as_they_were(kind):
    scenario = five(kind, graph=graphs.random_tree((0.5, 2.0)))
    drawn = started(scenario, 32, seed=3)
    given = started(scenario, 32, seed=3, positions=STARTS[scenario.dim])
    np.testing.assert_array_equal(given.frames, drawn.frames)
    np.testing.assert_array_equal(given.weights, drawn.weights)


def spoilt(table: np.ndarray, at: tuple[int, ...], value: float) -> np.ndarray:
    table = table.copy()
    table[at] = value
    return table


PLANE, SPACE, UNICYCLE = "single_integrator-2d", "single_integrator-3d", "unicycle"
PLACES, ALONE = STARTS[2][0], np.outer(np.arange(5) != 4, np.arange(5) != 4)
BAD_OPTIONS = [
    (PLANE, "positions", np.zeros((4, 2)), r"has shape \(4, 2\); it must be \(5, 2\)"),
    (PLANE, "positions", STARTS[2][:7], r"has shape \(7, 5, 2\); it must be \(3, 5, 2\)"),
    (PLANE, "positions", spoilt(PLACES, (3, 1), np.nan), r"of robot_3 is \[.*nan\]; .* finite"),
    (UNICYCLE, "positions", np.zeros((5, 2)), "neighbours robot_0 and robot_1 both stand at"),
    (PLANE, "headings", np.zeros(5), 'single_integrator robots have none; give "frames"'),
    ("nonholonomic_3d", "headings", np.zeros(5), r"has shape \(5,\); it must be \(5, 2\)"),
    (UNICYCLE, "frames", np.tile(np.eye(2), (5, 1, 1)), 'give "headings"'),
    (PLANE, "frames", np.tile(np.diag([1, -1]), (5, 1, 1)), "that of robot_0 is .* be a rotation"),
    (SPACE, "frames", np.tile(2 * np.eye(3), (5, 1, 1)), "must be a rotation"),
    (SPACE, "frames", np.eye(3), r"has shape \(3, 3\); it must be \(5, 3, 3\)"),
    (UNICYCLE, "weights", spoilt(UNEQUAL, (0, 1), 1.0), r"a\[0, 1\] = 1\.0 must equal its mirror"),
    (UNICYCLE, "weights", UNEQUAL[:3], r"have shape \(3, 5\)"),
    (UNICYCLE, "weights", UNEQUAL * ALONE, r"are not connected: .*\[4\]"),
    (UNICYCLE, "weights", 2 * UNEQUAL, r"reach D = \d.*at most 6\.5"),
    (UNICYCLE, "weights", UNEQUAL / 2, r"bottleneck a\* = 0\.45 m/s.*least 0\.9"),
    (PLANE, "obstacles", [Disc((0.0, 0.0), 1.0)], "1 given, but the scenario has room for 0"),
]


@pytest.mark.parametrize(("kind", "option", "value", "message"), BAD_OPTIONS)
def test_bad_options_are_refused_by_name_and_change_nothing(kind, option, value, message):
    sim = started(five(kind), 3, seed=1)
    sim.step(np.ones((3, 5, sim.scenario.action_size)))
    with refusing(sim, f"{option}.*{message}"):
        sim.reset(2, {option: value})
    fresh = started(five(kind), 3, seed=1)
    np.testing.assert_array_equal(sim.reset(), fresh.reset())  # the episode count did not move


def test_given_obstacles_and_robots_inside_them():
    away, around = Disc((9.0, 9.0), 0.5), Disc((0.0, 0.0), 9.0)
    inside = r"positions: robot.0 at .* inside Disc"
    scenario = five("single_integrator-2d", obstacle_slots=2)
    fixed = scenario.replace(start_positions=STARTS[2][0])
    for teams, given in ((fixed, {}), (scenario, {"positions": STARTS[2][0]})):
        sim = started(teams, 2, obstacles=[away], **given)
        assert sim.obstacles.shape[1] == 2 and (sim.obstacles[:, 0, 0] >= 0).all()
        with pytest.raises(ValueError, match=inside):
            sim.reset(0, {"obstacles": [around], **given})
    sim = started(scenario.replace(obstacles=[away]), **given, obstacles=None, weights=None)
    np.testing.assert_array_equal(sim.obstacles[0, 0, 2:5], [0.5, 9.0, 9.0])
    with pytest.raises(ValueError, match=inside):
        sim.reset(0, {"positions": [[9.0, 9.0], *STARTS[2][0][1:]], "obstacles": None})


def test_given_links_join_no_robots_that_stand_in_one_place():
    places = [[-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]
    path = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    sim = started(Scenario(n_robots=3, graph="path", start_positions=places), weights=path)
    with pytest.raises(ValueError, match="neighbours robot_0 and robot_2 both stand at"):
        sim.reset(0, {"weights": [[0, 1, 1], [1, 0, 0], [1, 0, 0]]})


def test_bodies_take_no_obstacles():
    bodies = Scenario(n_robots=3, body_radius=0.1, meeting="pack", obstacle_slots=2)
    sim = started(bodies, obstacles=[])
    with pytest.raises(ValueError, match=r"pack.* is for teams without obstacles"):
        sim.reset(0, {"obstacles": [Disc((9.0, 9.0), 0.5)]})


def test_if_one_team_finds_no_room_none_starts_anew():
    sim = started(five("unicycle", spawn_size=0.8, graph=graphs.complete()), 3, seed=[0, 1, 4])
    sim.step(np.ones((3, 5, 2)))
    with refusing(sim, r"no room for the start of team 2.*spawn_size of 0\.8", RuntimeError):
        sim.reset([4, 9, 2])


def test_actions_that_may_not_be_written_to_are_taken_and_compile_nothing():
    """Arrays of other libraries are often read-only; their contents are what counts."""
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 5, 2)).astype(np.float32)
    outcomes, variants = [], []
    for writeable in (True, False):
        sim = started(five("unicycle"), 3)
        actions.flags.writeable = writeable
        outcomes.append(sim.step(actions))
        variants.append(len(getattr(step_blocks, "overloads", ())))
    assert variants[0] == variants[1]
    np.testing.assert_array_equal(outcomes[0].observations, outcomes[1].observations)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_actions_that_are_not_finite_change_nothing(kind, value):
    sim = started(five(kind), 40)  # two blocks
    actions = np.ones((40, 5, sim.scenario.action_size), np.float32)
    actions[38, 3, 1] = value
    with refusing(sim, r"action of robot_3 in team 38 is .* must be finite"):
        sim.step(actions)
    with refusing(sim, r"actions have shape \(5, 2\); they must be \(B, n, a\)"):
        sim.step(np.ones((5, 2)))


@pytest.mark.parametrize("dim", [2, 3])
def test_the_speed_limit_keeps_the_direction(dim):
    scenario = five(f"single_integrator-{dim}d", max_speed=0.7, local_frames="global")
    sim = started(scenario, 32, positions=STARTS[dim] * 10)
    velocities = np.random.default_rng(1).normal(size=(32, 5, dim))
    velocities[:, 0] *= 0.1
    velocities[:, 1] *= 1e30  # finite in float32
    sim.step(velocities)
    moved = (sim.positions - STARTS[dim] * 10) / scenario.tau
    wanted = np.linalg.norm(velocities, axis=-1, keepdims=True)
    expected = velocities / wanted * np.minimum(wanted, 0.7)
    np.testing.assert_allclose(moved, expected, rtol=1e-5, atol=1e-7)


def test_the_inputs_of_nonholonomic_robots_are_clipped_one_by_one():
    slow = {"max_speed": 0.5, "max_turn_rate": 0.4, "merge_radius": 0.01, "time_step": 0.1}
    unicycle = five("unicycle", **slow, allow_long_step=True)
    sim = started(unicycle, positions=STARTS[2][0], headings=np.zeros(5))
    sim.step([[(9, 0), (-9, 0), (0.2, 9), (0, -9), (0.3, 0.1)]])
    np.testing.assert_allclose(sim.headings[0, :, 0], [0, 0, 0.04, -0.04, 0.01], rtol=1e-6)
    speeds = np.linalg.norm(sim.positions[0] - STARTS[2][0], axis=-1) / 0.1
    np.testing.assert_allclose(speeds, [0.5, 0.5, 0.2, 0, 0.3], rtol=1e-3)
    flyer = five("nonholonomic_3d", **slow, allow_long_step=True)
    sim = started(flyer, positions=STARTS[3][0], headings=np.zeros((5, 2)))
    sim.step([[(9, 0, 0), (0, 99, 99), (0, -99, -99), (0, 3.0, 0.3), (-9, 0, 0)]])
    expected = [[0, 0], [0.4, 0.04], [-0.4, -0.04], [0.3, 0.03], [0, 0]]
    np.testing.assert_allclose(sim.headings[0], expected, rtol=1e-6)
    np.testing.assert_allclose((sim.positions[0] - STARTS[3][0])[[0, 4], 0], [0.05, -0.05])


def test_what_merged_away_robots_are_given_is_ignored(kind):
    sim, _ = halfway(five(kind, spawn_size=6.0, merge_radius=0.4))
    other, gone = copy.deepcopy(sim), ~sim.active
    actions = np.zeros(actions_shape(sim))
    sim.step(actions)
    actions[gone] = 3.0
    other.step(actions)
    assert gone.any()
    assert_same_state(sim, other)
