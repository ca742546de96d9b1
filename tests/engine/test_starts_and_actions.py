"""What is given to a simulator: starts, seeds, masks, actions; what of it is refused."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from conftest import UNEQUAL, assert_same_state, five, refusing
from test_simulator import STARTS, attitudes, halfway, start

from rendezvous_env import Disc, Scenario, Simulator, graphs
from rendezvous_env.engine.stages.step import step_blocks


def test_a_given_start_is_taken(kind):
    scenario = five(kind)
    weights = UNEQUAL.copy()
    weights[0, 1] = weights[1, 0] = 1.7
    options = start(scenario, STARTS[scenario.dim], weights=weights)
    sim = Simulator(scenario, 32)
    sim.reset(0, options)
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
    drawn, given = Simulator(scenario, 32), Simulator(scenario, 32)
    drawn.reset(3)
    given.reset(3, {"positions": STARTS[scenario.dim]})
    np.testing.assert_array_equal(given.frames, drawn.frames)
    np.testing.assert_array_equal(given.weights, drawn.weights)


def _bad(field: str, at: tuple[int, ...], value: float) -> np.ndarray:
    tables = {"positions": STARTS[2][0].copy(), "weights": UNEQUAL.copy()}
    tables[field][at] = value
    return tables[field]


BAD_OPTIONS = {
    "positions-shape": ("single_integrator-2d", {"positions": np.zeros((4, 2))},
        r"positions has shape \(4, 2\); it must be \(5, 2\)"),
    "positions-dim": ("single_integrator-3d", {"positions": STARTS[2][0]},
        r"positions has shape \(5, 2\); it must be \(5, 3\)"),
    "positions-batch": ("single_integrator-2d", {"positions": STARTS[2][:7]},
        r"positions has shape \(7, 5, 2\); it must be \(3, 5, 2\)"),
    "positions-nan": ("single_integrator-2d", {"positions": _bad("positions", (3, 1), np.nan)},
        r"positions of robot_3 is \[.*nan\]; it must be finite"),
    "positions-coincide": ("unicycle", {"positions": np.zeros((5, 2))},
        "neighbours robot_0 and robot_1 both stand at"),
    "headings-none": ("single_integrator-2d", {"headings": np.zeros(5)},
        'headings: single_integrator robots have none; give "frames"'),
    "headings-shape": ("nonholonomic_3d", {"headings": np.zeros(5)},
        r"headings has shape \(5,\); it must be \(5, 2\)"),
    "frames-model": ("unicycle", {"frames": np.tile(np.eye(2), (5, 1, 1))}, 'give "headings"'),
    "frames-reflection": ("single_integrator-2d", {"frames": np.tile(np.diag([1, -1]), (5, 1, 1))},
        "frames: that of robot_0 is .* must be a rotation"),
    "frames-scale": ("single_integrator-3d", {"frames": np.tile(2 * np.eye(3), (5, 1, 1))},
        "must be a rotation"),
    "frames-shape": ("single_integrator-3d", {"frames": np.eye(3)},
        r"frames has shape \(3, 3\); it must be \(5, 3, 3\)"),
    "weights-asymmetric": ("unicycle", {"weights": _bad("weights", (0, 1), 1.0)},
        r"weights: weight a\[0, 1\] = 1\.0 must equal its mirror image"),
    "weights-negative": ("unicycle", {"weights": -UNEQUAL},
        r"a\[0, 1\] = -2\.0 must not be negative"),
    "weights-diagonal": ("unicycle", {"weights": _bad("weights", (2, 2), 1.0)},
        r"a\[2, 2\] = 1\.0"),
    "weights-shape": ("unicycle", {"weights": UNEQUAL[:3]}, r"weights have shape \(3, 5\)"),
    "weights-disconnected": ("unicycle", {"weights": UNEQUAL * (np.arange(5) != 4) *
        (np.arange(5) != 4)[:, None]}, r"weights are not connected: .*\[4\]"),
    "weights-heavy": ("unicycle", {"weights": 2 * UNEQUAL}, r"weights reach D = \d.*at most 6\.5"),
    "weights-light": ("unicycle", {"weights": UNEQUAL / 2},
        r"bottleneck a\* = 0\.45 m/s.*least 0\.9"),
    "obstacles-many": ("single_integrator-2d", {"obstacles": [Disc((0.0, 0.0), 1.0)]},
        "1 given, but the scenario has room for 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_OPTIONS)
def test_bad_options_are_refused_by_name_and_change_nothing(name):
    kind, options, message = BAD_OPTIONS[name]
    sim = Simulator(five(kind), 3)
    sim.reset(1)
    sim.step(np.ones((3, 5, sim.scenario.action_size)))
    with refusing(sim, message):
        sim.reset(2, options)
    fresh = Simulator(five(kind), 3)
    fresh.reset(1)
    np.testing.assert_array_equal(sim.reset(), fresh.reset())  # the episode count did not move


def test_given_obstacles_and_robots_inside_them():
    scenario = five("single_integrator-2d", obstacle_slots=2)
    sim = Simulator(scenario, 2)
    disc = Disc((9.0, 9.0), 0.5)
    sim.reset(0, {"obstacles": [disc], "positions": STARTS[2][0]})
    assert sim.obstacles.shape[1] == 2 and (sim.obstacles[:, 0, 0] >= 0).all()
    with pytest.raises(ValueError, match=r"positions: robot.0 at .* inside Disc"):
        sim.reset(0, {"obstacles": [Disc((0.0, 0.0), 9.0)], "positions": STARTS[2][0]})
    sim = Simulator(scenario.replace(start_positions=STARTS[2][0]), 2)  # of the scenario, likewise
    sim.reset(0, {"obstacles": [disc]})
    with pytest.raises(ValueError, match=r"positions: robot.0 at .* inside Disc"):
        sim.reset(0, {"obstacles": [Disc((0.0, 0.0), 9.0)]})


def test_none_is_as_if_an_option_were_not_given():
    scenario = five("single_integrator-2d", obstacles=[Disc((9.0, 9.0), 0.5)])
    sim = Simulator(scenario)
    sim.reset(0, {"positions": STARTS[2][0], "obstacles": None, "weights": None})
    np.testing.assert_array_equal(sim.obstacles[0, 0, 2:5], [0.5, 9.0, 9.0])
    with pytest.raises(ValueError, match=r"positions: robot.0 at .* inside Disc"):
        sim.reset(0, {"positions": [[9.0, 9.0], *STARTS[2][0][1:]], "obstacles": None})


def test_given_links_join_no_robots_that_stand_in_one_place():
    places = [[-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]
    sim = Simulator(Scenario(n_robots=3, graph="path", start_positions=places))
    sim.reset(0, {"weights": [[0, 1, 0], [1, 0, 1], [0, 1, 0]]})
    with pytest.raises(ValueError, match="neighbours robot_0 and robot_2 both stand at"):
        sim.reset(0, {"weights": [[0, 1, 1], [1, 0, 0], [1, 0, 0]]})


def test_bodies_take_no_obstacles():
    sim = Simulator(Scenario(n_robots=3, body_radius=0.1, meeting="pack", obstacle_slots=2))
    sim.reset(0, {"obstacles": []})
    with pytest.raises(ValueError, match=r"pack.* is for teams without obstacles"):
        sim.reset(0, {"obstacles": [Disc((9.0, 9.0), 0.5)]})


def test_bad_seeds_and_masks_are_refused_and_change_nothing():
    sim = Simulator(five("unicycle"), 3)
    sim.reset(1)
    for seed, message in (
        (1.5, "seed is 1.5; it must be a whole number"),
        ([1, 2], "seed has 2 entries; it must be one number, or 3"),
        ([1, 2, "x"], "seed is 'x'; it must be a whole number"),
    ):
        with refusing(sim, message):
            sim.reset(seed)
    for mask in (np.ones(2, bool), np.ones(3), [0, 1, 1]):
        with refusing(sim, r"mask is .* must be bool"):
            sim.reset(mask=mask)


def test_if_one_team_finds_no_room_none_starts_anew():
    sim = Simulator(five("unicycle", spawn_size=0.8, graph=graphs.complete()), 3)
    sim.reset([0, 1, 4])
    sim.step(np.ones((3, 5, 2)))
    with refusing(sim, r"no room for the start of team 2.*spawn_size of 0\.8", RuntimeError):
        sim.reset([4, 9, 2])


def test_actions_that_may_not_be_written_to_are_taken_and_compile_nothing():
    """Arrays of other libraries are often read-only; their contents are what counts."""
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 5, 2)).astype(np.float32)
    outcomes, variants = [], []
    for writeable in (True, False):
        sim = Simulator(five("unicycle"), 3)
        sim.reset(0)
        actions.flags.writeable = writeable
        outcomes.append(sim.step(actions))
        variants.append(len(getattr(step_blocks, "overloads", ())))
    assert variants[0] == variants[1]
    np.testing.assert_array_equal(outcomes[0].observations, outcomes[1].observations)


def test_a_step_before_the_first_reset():
    with pytest.raises(RuntimeError, match="call reset"):
        Simulator(five("unicycle")).step(np.zeros((1, 5, 2)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_actions_that_are_not_finite_change_nothing(kind, value):
    sim = Simulator(five(kind), 40)  # two blocks
    sim.reset(6)
    actions = np.ones((40, 5, sim.scenario.action_size), np.float32)
    actions[38, 3, 1] = value
    with refusing(sim, r"action of robot_3 in team 38 is .* must be finite"):
        sim.step(actions)
    with refusing(sim, r"actions have shape \(5, 2\); they must be \(B, n, a\)"):
        sim.step(np.ones((5, 2)))


@pytest.mark.parametrize("dim", [2, 3])
def test_the_speed_limit_keeps_the_direction(dim):
    scenario = five(f"single_integrator-{dim}d", max_speed=0.7, local_frames="global")
    sim = Simulator(scenario, 32)
    sim.reset(0, {"positions": STARTS[dim] * 10})
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
    sim = Simulator(unicycle)
    sim.reset(0, {"positions": STARTS[2][0], "headings": np.zeros(5)})
    sim.step([[(9, 0), (-9, 0), (0.2, 9), (0, -9), (0.3, 0.1)]])
    np.testing.assert_allclose(sim.headings[0, :, 0], [0, 0, 0.04, -0.04, 0.01], rtol=1e-6)
    speeds = np.linalg.norm(sim.positions[0] - STARTS[2][0], axis=-1) / 0.1
    np.testing.assert_allclose(speeds, [0.5, 0.5, 0.2, 0, 0.3], rtol=1e-3)
    flyer = five("nonholonomic_3d", **slow, allow_long_step=True)
    sim = Simulator(flyer)
    sim.reset(0, {"positions": STARTS[3][0], "headings": np.zeros((5, 2))})
    sim.step([[(9, 0, 0), (0, 99, 99), (0, -99, -99), (0, 3.0, 0.3), (-9, 0, 0)]])
    expected = [[0, 0], [0.4, 0.04], [-0.4, -0.04], [0.3, 0.03], [0, 0]]
    np.testing.assert_allclose(sim.headings[0], expected, rtol=1e-6)
    np.testing.assert_allclose((sim.positions[0] - STARTS[3][0])[[0, 4], 0], [0.05, -0.05])


def test_what_merged_away_robots_are_given_is_ignored(kind):
    sim = halfway(kind)
    other, gone = copy.deepcopy(sim), ~sim.active
    actions = np.zeros((20, 5, sim.scenario.action_size))
    sim.step(actions)
    actions[gone] = 3.0
    other.step(actions)
    assert gone.any()
    assert_same_state(sim, other)
