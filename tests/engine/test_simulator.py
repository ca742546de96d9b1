"""Simulator: symmetries, episodes, state, and validation of initial conditions and actions."""

import copy

import numpy as np
import pytest
from conftest import UNEQUAL, actions_shape, assert_same_state, five, law_of, refusing, started
from test_restart import halfway

from rendezvous_env import Disc, Scenario, Simulator, Trajectory, graphs, rollout
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from rendezvous_env.engine.stages.propose import propose_motion
from rendezvous_env.trajectory import run

RANDOM = np.random.default_rng(11)
STARTS = {d: RANDOM.uniform(-4, 4, size=(32, 5, d)) for d in (2, 3)}
TURN_ABOUT_Z = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def rotation(d: int) -> np.ndarray:
    """Rotation about a generic axis."""
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.28, -0.96], [0.0, 0.96, 0.28]])
    return (TURN_ABOUT_Z @ tilt @ TURN_ABOUT_Z)[:3, :3] if d == 3 else TURN_ABOUT_Z[:2, :2]


def attitudes(scenario: Scenario, yaw_offset: float = 0.0) -> np.ndarray:
    """Given headings, equal in each of 32 environments up to a shift."""
    width = scenario.model.n_angles
    angles = np.linspace(-1.0, 2.3, 32)[:, None, None] + np.linspace(0, 0.9, 5)[:, None]
    angles = np.broadcast_to(angles, (32, 5, 1)) + yaw_offset
    return np.concatenate([angles, np.full((32, 5, 1), 0.3)], axis=-1)[..., :width]


def start(scenario: Scenario, positions: np.ndarray, **more: object) -> dict:
    headed = {"headings": attitudes(scenario)} if scenario.model.nonholonomic else {}
    return {"positions": positions, **headed, **more}


def follow(scenario: Scenario, options: dict) -> Trajectory:
    """Simulate 60 steps under the paper's law."""
    brief = scenario.replace(time_limit=60 * scenario.tau)
    return rollout(brief, law_of(scenario), 5, 32, options, record="observations")


def test_observations_are_scale_invariant(kind):
    """Observations contain bearings only."""
    scenario = five(kind, max_turn_rate=1.0)
    sim, positions = Simulator(scenario, 32), STARTS[scenario.dim]
    first = sim.reset(5, start(scenario, positions))
    assert np.abs(first).max() > 0.5
    for factor in (3.0, 1e-3, 1e4):
        again = sim.reset(5, start(scenario, positions * factor))
        np.testing.assert_allclose(again, first, atol=3e-7)


@pytest.mark.parametrize("kind", ["single_integrator-2d", "single_integrator-3d"])
def test_episodes_are_scale_invariant_with_radius_and_step(kind):
    near = five(kind)
    far = near.replace(merge_radius=4 * near.merge_radius)  # τ = r/(2D̄) scales along
    assert far.tau == 4 * near.tau
    one = follow(near, {"positions": STARTS[near.dim]})
    other = follow(far, {"positions": 4 * STARTS[near.dim]})
    np.testing.assert_array_equal(other.observations, one.observations)
    np.testing.assert_array_equal(other.positions, 4 * one.positions)
    assert not one.active.all()


def test_observations_are_invariant_to_rotation_and_translation(kind):
    scenario = five(kind)
    d, nonholonomic = scenario.dim, scenario.model.nonholonomic
    turn = TURN_ABOUT_Z[:d, :d] if nonholonomic else rotation(d)
    shift = np.array([7.0, -3.0, 11.0])[:d]
    begin = start(scenario, STARTS[d])
    turned = begin | {"positions": STARTS[d] @ turn.T + shift}
    if nonholonomic:
        turned["headings"] = attitudes(scenario, np.arctan2(0.8, 0.6))
    else:
        frames = started(scenario, 32, seed=5)
        begin["frames"], turned["frames"] = frames.frames, turn @ frames.frames
    one, other = follow(scenario, begin), follow(scenario, turned)
    assert not one.active.all()
    np.testing.assert_allclose(other.observations, one.observations, atol=2e-4)
    np.testing.assert_allclose(other.positions - shift, one.positions @ turn.T, atol=1e-4)
    np.testing.assert_allclose(other.observations[0], one.observations[0], atol=3e-7)


def test_relabelling_permutes_trajectories(kind):
    """Other models before the first merge, in which the lower index keeps its heading."""
    order, scenario = np.array([3, 0, 4, 2, 1]), five(kind, local_frames="global")
    begin = start(scenario, STARTS[scenario.dim])
    renamed = {name: table[:, order] for name, table in begin.items()}
    graph = UNEQUAL[np.ix_(order, order)]
    one, other = follow(scenario, begin), follow(scenario.replace(graph=graph), renamed)
    # float32 actions add up in another order, so trajectories agree to their rounding
    calm = one.active[-1].all(axis=1) | (not scenario.model.nonholonomic)
    assert calm.sum() >= 10
    places, renamed_places = one.positions[:, calm], other.positions[:, calm]
    np.testing.assert_allclose(renamed_places, places[:, :, order], atol=2e-5)
    left, renamed_left = (each.active[-1, calm].sum(axis=1) for each in (one, other))
    np.testing.assert_array_equal(left, renamed_left)


def test_seeds_and_episodes_are_reproducible(kind):
    sim = started(five(kind), 3, seed=8)
    first = sim.observe()
    assert sim.seeds.tolist() == [8, 9, 10]
    second = sim.reset()
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(sim.reset(8), first)
    np.testing.assert_array_equal(sim.reset(None), second)
    np.testing.assert_array_equal(sim.reset([10, 8, 9])[[1, 2, 0]], first)
    mixed = sim.reset([5, None, 8])  # who is given none goes on
    assert sim.seeds.tolist() == [5, 8, 8]
    np.testing.assert_array_equal(mixed[1:], [second[0], first[0]])
    np.testing.assert_array_equal(Simulator(five(kind)).reset(np.int64(9))[0], first[1])


def test_simulators_without_seed_differ():
    a, b, again = (Simulator(five("unicycle"), 2) for _ in range(3))
    x, y = a.reset(), b.reset()
    assert not np.array_equal(x, y) and not np.array_equal(x[0], x[1])
    np.testing.assert_array_equal(again.reset([int(s) for s in a.seeds]), x)


def test_step_before_full_reset_raises():
    sim, still = Simulator(Scenario(n_robots=2), 3), np.zeros((3, 2, 2))
    for mask, words in ((None, ""), ([True, False, True], ": environment 1 was not reset")):
        if mask is not None:
            sim.reset(0, mask=np.array(mask))
        for teams in (sim, copy.deepcopy(sim)):
            with pytest.raises(RuntimeError, match=rf"^call reset\(\) before step\(\){words}$"):
                teams.step(still)
    copied = copy.deepcopy(sim)
    copied.restart(np.array([False, True, False]))  # it rests, and is observed with the step
    assert copied.step(still).rewards.shape == (3,) and copied.steps.tolist() == [1, 0, 1]
    sim.reset(0, mask=np.array([False, True, False]))
    assert sim.step(still).rewards.shape == (3,) and sim.steps.tolist() == [1, 1, 1]


def test_step_after_unobserved_state_raises(monkeypatch):
    """Possible merges follow from the last observation, which Ctrl-C may prevent."""
    sim, fresh = started(Scenario(n_robots=2), 2), Simulator(Scenario(n_robots=2), 2)

    def interrupted():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(fresh, "observe", interrupted)
        fresh.set_state(sim.get_state())
    fresh.restart(np.array([False, True]))  # the other is observed no more for it
    with pytest.raises(RuntimeError, match="call reset"):
        fresh.step(np.zeros((2, 2, 2)))
    fresh.set_state(sim.get_state())
    fresh.step(np.zeros((2, 2, 2)))


def test_resting_environment_merges_in_its_first_step():
    sim = started(Scenario(n_robots=2, start_positions=((0.0, 0.0), (0.1, 0.0))))
    sim.restart(np.array([True]))
    assert sim.step(np.zeros((1, 2, 2))).status.tolist() == [RUNNING]
    assert sim.active.all()
    outcome = sim.step(np.zeros((1, 2, 2)))
    assert outcome.status.tolist() == [RENDEZVOUS] and sim.steps.tolist() == [1]


def test_episode_end_is_reported():
    duo = Scenario(n_robots=2, time_limit=1.0)
    sim = started(duo, 2, positions=[[[0, 0], [5, 0]], [[0, 0], [0.5, 0]]])
    steps = list(run(sim, law_of(duo), sim.observe()))
    assert len(steps) == duo.max_steps == 10  # τ = 0.1 s
    assert sim.status.tolist() == [TIME_OUT, RENDEZVOUS]
    assert sim.steps.tolist() == [10, 2]  # (0.5 − 0.2)/2 = 0.15 s
    np.testing.assert_allclose(sim.time, [1.0, 0.2])
    np.testing.assert_allclose(sim.path_length, [2.0, 0.3], rtol=1e-6)
    sim.set_max_steps(2)
    sim.reset(0)
    statuses = [sim.step(np.zeros((2, 2, 2))).status.tolist() for _ in range(2)]
    assert statuses == [[RUNNING] * 2, [TIME_OUT] * 2] and copy.deepcopy(sim).max_steps == 2


def test_returned_arrays_are_copies(kind):
    sim, _ = halfway(five(kind, spawn_size=6.0, merge_radius=0.4))
    outcome = sim.step(np.zeros(actions_shape(sim)))
    before = sim.get_state()
    handed = [getattr(sim, name) for name in (
        "positions", "headings", "frames", "weights", "obstacles", "merged_into", "active",
        "status", "steps", "time", "seeds", "initial_lyapunov", "path_length",
        "contacts", "min_clearance",
    )]  # fmt: skip
    for array in handed:
        if array.size:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 1
    for array in [*outcome[:-1], sim.lyapunov(), sim.observe(), *sim.get_state().values()]:
        array[...] = 1
    assert sim.all_running and not sim.ended.any() and (sim.status == RUNNING).all()
    assert_same_state(sim, before)


def test_given_initial_condition_is_used(kind):
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


def test_given_parts_keep_other_random_draws(kind):
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
    (PLANE, "positions", np.zeros((4, 2)), r"have shape \(4, 2\); they must be \(5, 2\)"),
    (SPACE, "positions", PLACES, r"have shape \(5, 2\); they must be \(5, 3\)"),
    (PLANE, "positions", STARTS[2][:7], r"have shape \(7, 5, 2\); they must be \(3, 5, 2\)"),
    (PLANE, "positions", spoilt(PLACES, (3, 1), np.nan), r"of robot_3 is \[.*nan\]; .* finite"),
    (UNICYCLE, "positions", np.zeros((5, 2)), "neighbours robot_0 and robot_1 are both at"),
    (PLANE, "headings", np.zeros(5), 'single_integrator robots have no heading; give "frames"'),
    ("nonholonomic_3d", "headings", np.zeros(5), r"have shape \(5,\); they must be \(5, 2\)"),
    (UNICYCLE, "frames", np.tile(np.eye(2), (5, 1, 1)), 'give "headings"'),
    (PLANE, "frames", np.tile(np.diag([1, -1]), (5, 1, 1)), "that of robot_0 is .* be a rotation"),
    (SPACE, "frames", np.tile(2 * np.eye(3), (5, 1, 1)), "must be a rotation"),
    (SPACE, "frames", np.eye(3), r"have shape \(3, 3\); they must be \(5, 3, 3\)"),
    (UNICYCLE, "weights", spoilt(UNEQUAL, (0, 1), 1.0), r"a\[0, 1\] = 1\.0 must equal its mirror"),
    (UNICYCLE, "weights", UNEQUAL[:3], r"have shape \(3, 5\)"),
    (UNICYCLE, "weights", UNEQUAL * ALONE, r"are not connected: .*\[4\]"),
    (UNICYCLE, "weights", 2 * UNEQUAL, r"reach D = \d.*at most 6\.5"),
    (UNICYCLE, "weights", UNEQUAL / 2, r"bottleneck a\* = 0\.45 m/s.*least 0\.9"),
    (PLANE, "obstacles", [Disc((0.0, 0.0), 1.0)], "1 given, but the scenario has 0 obstacle slots"),
]


@pytest.mark.parametrize(("kind", "option", "value", "message"), BAD_OPTIONS)
def test_bad_options_are_rejected_and_change_nothing(kind, option, value, message):
    sim = started(five(kind), 3, seed=1)
    sim.step(np.ones((3, 5, sim.scenario.action_size)))
    with refusing(sim, f"{option}.*{message}"):
        sim.reset(2, {option: value})
    fresh = started(five(kind), 3, seed=1)
    np.testing.assert_array_equal(sim.reset(), fresh.reset())  # the episode count did not move


def test_given_obstacles_must_not_contain_robots():
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


def test_given_links_reject_coincident_robots():
    places = [[-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]
    path = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    sim = started(Scenario(n_robots=3, graph="path", start_positions=places), weights=path)
    with pytest.raises(ValueError, match="neighbours robot_0 and robot_2 are both at"):
        sim.reset(0, {"weights": [[0, 1, 1], [1, 0, 0], [1, 0, 0]]})


def test_bodies_reject_obstacles():
    bodies = Scenario(n_robots=3, body_radius=0.1, meeting="pack", obstacle_slots=2)
    sim = started(bodies, obstacles=[])
    with pytest.raises(ValueError, match=r"pack.* does not support obstacles"):
        sim.reset(0, {"obstacles": [Disc((9.0, 9.0), 0.5)]})


def test_failed_reset_of_one_environment_changes_none():
    sim = started(five("unicycle", spawn_size=0.8, graph=graphs.complete()), 3, seed=[0, 1, 4])
    sim.step(np.ones((3, 5, 2)))
    with refusing(
        sim, r"no room for initial positions in environment 2.*spawn_size of 0\.8", RuntimeError
    ):
        sim.reset([4, 9, 2])


def test_read_only_actions_are_accepted_without_compiling():
    """Arrays of other libraries are often read-only; only their contents matter."""
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 5, 2)).astype(np.float32)
    outcomes, variants = [], []
    for writeable in (True, False):
        sim = started(five("unicycle"), 3)
        actions.flags.writeable = writeable
        outcomes.append(sim.step(actions))
        variants.append(len(getattr(propose_motion, "overloads", ())))
    assert variants[0] == variants[1]
    np.testing.assert_array_equal(outcomes[0].observations, outcomes[1].observations)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_actions_change_nothing(kind, value):
    sim = started(five(kind), 40)  # two blocks
    actions = np.ones((40, 5, sim.scenario.action_size), np.float32)
    actions[38, 3, 1] = value
    with refusing(sim, r"action of robot_3 in environment 38 is .* must be finite"):
        sim.step(actions)
    with refusing(sim, r"actions have shape \(5, 2\); they must be \(B, n, a\)"):
        sim.step(np.ones((5, 2)))


@pytest.mark.parametrize("dim", [2, 3])
def test_speed_limit_preserves_direction(dim):
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


def test_nonholonomic_inputs_are_clipped_separately():
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


def test_actions_of_merged_robots_are_ignored(kind):
    sim, _ = halfway(five(kind, spawn_size=6.0, merge_radius=0.4))
    other, gone = copy.deepcopy(sim), ~sim.active
    actions = np.zeros(actions_shape(sim))
    sim.step(actions)
    actions[gone] = 3.0
    other.step(actions)
    assert gone.any()
    assert_same_state(sim, other)
