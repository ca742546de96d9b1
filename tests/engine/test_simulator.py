"""Symmetries, batching, state and refusals of the simulator."""

import copy

import numpy as np
import pytest
from conftest import UNEQUAL, actions_shape, assert_same_state, five, law_of, started
from test_restart import halfway

from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING, TIME_OUT

RANDOM = np.random.default_rng(11)
STARTS = {d: RANDOM.uniform(-4, 4, size=(32, 5, d)) for d in (2, 3)}
TURN_ABOUT_Z = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def rotation(d: int) -> np.ndarray:
    """A rotation about no special axis."""
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.28, -0.96], [0.0, 0.96, 0.28]])
    return (TURN_ABOUT_Z @ tilt @ TURN_ABOUT_Z)[:3, :3] if d == 3 else TURN_ABOUT_Z[:2, :2]


def attitudes(scenario: Scenario, yaw_offset: float = 0.0) -> np.ndarray:
    """Given headings, the same in each of 32 teams up to a shift."""
    width = scenario.model.n_angles
    angles = np.linspace(-1.0, 2.3, 32)[:, None, None] + np.linspace(0, 0.9, 5)[:, None]
    angles = np.broadcast_to(angles, (32, 5, 1)) + yaw_offset
    return np.concatenate([angles, np.full((32, 5, 1), 0.3)], axis=-1)[..., :width]


def start(scenario: Scenario, positions: np.ndarray, **more: object) -> dict:
    headed = {"headings": attitudes(scenario)} if scenario.model.nonholonomic else {}
    return {"positions": positions, **headed, **more}


def follow(scenario: Scenario, options: dict) -> tuple[np.ndarray, np.ndarray, Simulator]:
    """Observations and positions of every step under the paper's law."""
    sim, policy = Simulator(scenario, 32), law_of(scenario)
    observations = sim.reset(5, options)
    seen, places = [observations], [sim.positions]
    for _ in range(60):
        observations = sim.step(policy(observations, sim.time)).observations
        seen.append(observations)
        places.append(sim.positions)
    return np.stack(seen), np.stack(places), sim


# ---- symmetries ---------------------------------------------------------------------------------


def test_scaling_all_positions_changes_no_observation(kind):
    """The bearing-only proof."""
    scenario = five(kind, max_turn_rate=1.0)
    sim, positions = Simulator(scenario, 32), STARTS[scenario.dim]
    first = sim.reset(5, start(scenario, positions))
    assert np.abs(first).max() > 0.5
    for factor in (3.0, 1e-3, 1e4):
        again = sim.reset(5, start(scenario, positions * factor))
        np.testing.assert_allclose(again, first, atol=3e-7)


@pytest.mark.parametrize("kind", ["single_integrator-2d", "single_integrator-3d"])
def test_scaling_r_and_the_step_too_a_whole_episode_looks_the_same(kind):
    near = five(kind)
    far = near.replace(merge_radius=4 * near.merge_radius)  # τ = r/(2D̄) scales along
    assert far.tau == 4 * near.tau
    seen, places, sim = follow(near, {"positions": STARTS[near.dim]})
    seen_far, places_far, _ = follow(far, {"positions": 4 * STARTS[near.dim]})
    np.testing.assert_array_equal(seen_far, seen)
    np.testing.assert_array_equal(places_far, 4 * places)
    assert not sim.active.all()


def test_rotating_and_moving_the_world_changes_no_observation(kind):
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
    seen, places, sim = follow(scenario, begin)
    seen_turned, places_turned, _ = follow(scenario, turned)
    assert not sim.active.all()
    np.testing.assert_allclose(seen_turned, seen, atol=2e-4)
    np.testing.assert_allclose(places_turned - shift, places @ turn.T, atol=1e-4)
    np.testing.assert_allclose(seen_turned[0], seen[0], atol=3e-7)


def test_relabelling_the_robots_permutes_the_trajectories(kind):
    """The others before anyone merges, for then the lower index keeps its heading."""
    order, scenario = np.array([3, 0, 4, 2, 1]), five(kind, local_frames="global")
    begin = start(scenario, STARTS[scenario.dim])
    renamed = {name: table[:, order] for name, table in begin.items()}
    graph = UNEQUAL[np.ix_(order, order)]
    _, places, sim = follow(scenario, begin)
    _, renamed_places, renamed_sim = follow(scenario.replace(graph=graph), renamed)
    # float32 actions add up in another order, so trajectories agree to their rounding
    calm = sim.active.all(axis=1) | (not scenario.model.nonholonomic)
    assert calm.sum() >= 10
    np.testing.assert_allclose(renamed_places[:, calm], places[:, calm][:, :, order], atol=2e-5)
    merged, renamed_merged = (each.active[calm].sum(axis=1) for each in (sim, renamed_sim))
    np.testing.assert_array_equal(merged, renamed_merged)


# ---- seeds and episodes -------------------------------------------------------------------------


def test_seeds_and_episodes(kind):
    sim = Simulator(five(kind), 3)
    first = sim.reset(8)
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


def test_without_a_seed_two_simulators_differ():
    a, b, again = (Simulator(five("unicycle"), 2) for _ in range(3))
    x, y = a.reset(), b.reset()
    assert not np.array_equal(x, y) and not np.array_equal(x[0], x[1])
    np.testing.assert_array_equal(again.reset([int(s) for s in a.seeds]), x)


def test_no_team_steps_before_each_has_been_reset():
    sim, still = Simulator(Scenario(n_robots=2), 3), np.zeros((3, 2, 2))
    for mask, words in ((None, ""), ([True, False, True], ": team 1 has had none")):
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


def test_no_team_steps_whose_state_was_put_back_but_not_observed(monkeypatch):
    """What may be met is known from the last observation, which Ctrl-C may prevent."""
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


def test_a_resting_team_that_starts_within_r_meets_in_its_first_own_step():
    sim = started(Scenario(n_robots=2, start_positions=((0.0, 0.0), (0.1, 0.0))))
    sim.restart(np.array([True]))
    assert sim.step(np.zeros((1, 2, 2))).status.tolist() == [RUNNING]
    assert sim.active.all()
    outcome = sim.step(np.zeros((1, 2, 2)))
    assert outcome.status.tolist() == [RENDEZVOUS] and sim.steps.tolist() == [1]


def test_the_end_of_an_episode():
    duo = Scenario(n_robots=2, time_limit=1.0)
    sim = started(duo, 2, positions=[[[0, 0], [5, 0]], [[0, 0], [0.5, 0]]])
    policy, steps = law_of(duo), 0
    while (sim.status == RUNNING).any():
        sim.step(policy(sim.observe(), sim.time))
        steps += 1
    assert steps == duo.max_steps == 10  # τ = 0.1 s
    assert sim.status.tolist() == [TIME_OUT, RENDEZVOUS]
    assert sim.steps.tolist() == [10, 2]  # (0.5 − 0.2)/2 = 0.15 s
    np.testing.assert_allclose(sim.time, [1.0, 0.2])
    np.testing.assert_allclose(sim.path_length, [2.0, 0.3], rtol=1e-6)
    sim.set_max_steps(2)
    sim.reset(0)
    statuses = [sim.step(np.zeros((2, 2, 2))).status.tolist() for _ in range(2)]
    assert statuses == [[RUNNING] * 2, [TIME_OUT] * 2] and copy.deepcopy(sim).max_steps == 2


# ---- state --------------------------------------------------------------------------------------


def test_what_the_simulator_hands_out_is_not_its_memory(kind):
    sim, _ = halfway(five(kind, spawn_size=6.0, merge_radius=0.4))
    outcome = sim.step(np.zeros(actions_shape(sim)))
    before = sim.get_state()
    handed = [getattr(sim, name) for name in (
        "positions", "headings", "frames", "weights", "obstacles", "merged_into", "active",
        "status", "steps", "time", "seeds", "initial_lyapunov", "path_length",
        "contacts", "min_clearance",
    )]  # fmt: skip
    for array in [*handed, *outcome[:-1], sim.lyapunov(), sim.observe(), *sim.get_state().values()]:
        array[...] = 1
    assert sim.all_running and not sim.ended.any() and (sim.status == RUNNING).all()
    assert_same_state(sim, before)
