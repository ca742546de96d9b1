"""Symmetries, batching, state and refusals of the simulator."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from conftest import MODELS, ROOT, UNEQUAL, five, law_of

from rendezvous_env import Disc, ObstacleField, Scenario, Simulator, graphs
from rendezvous_env.compilation import compiled
from rendezvous_env.engine import batch_runner, threads
from rendezvous_env.engine.memory import AWAITING_RESET, RENDEZVOUS, RUNNING, TIME_OUT
from rendezvous_env.engine.stages.step import step_blocks

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


def follow(scenario, num_envs=32, *, steps=60, seed=5, options=None, **how):
    """Observations and positions of every step under the paper's law."""
    sim, policy = Simulator(scenario, num_envs, **how), law_of(scenario)
    observations = sim.reset(seed, options)
    seen, places = [observations], [sim.positions]
    for _ in range(steps):
        observations = sim.step(policy(observations, sim.time)).observations
        seen.append(observations)
        places.append(sim.positions)
    return np.stack(seen), np.stack(places), sim


def assert_same_state(a: Simulator, b: Simulator) -> None:
    for (name, x), y in zip(a.get_state().items(), b.get_state().values(), strict=True):
        np.testing.assert_array_equal(x, y, err_msg=name)


# ---- symmetries ---------------------------------------------------------------------------------


def test_scaling_all_positions_changes_no_observation(kind):
    """The bearing-only proof: with r and τ scaled too, a whole episode looks the same."""
    small = five(kind, spawn_size=10.0, max_turn_rate=1.0)
    for factor in (3.0, 1e-3, 1e4):
        sim = Simulator(small, 32)
        positions = STARTS[small.dim]
        first = sim.reset(5, start(small, positions))
        again = sim.reset(5, start(small, positions * factor))
        np.testing.assert_allclose(again, first, atol=3e-7)
        assert np.abs(first).max() > 0.5


def test_scaling_space_and_time_together_changes_no_observation_of_a_whole_episode():
    for kind in ("single_integrator-2d", "single_integrator-3d"):
        near = five(kind)
        far = near.replace(merge_radius=4 * near.merge_radius)  # τ = r/(2D̄) scales along
        assert far.tau == 4 * near.tau
        seen, places, sim = follow(near, options={"positions": STARTS[near.dim]})
        seen_far, places_far, _ = follow(far, options={"positions": 4 * STARTS[near.dim]})
        np.testing.assert_array_equal(seen_far, seen)
        np.testing.assert_array_equal(places_far, 4 * places)
        assert not sim.active.all()


def test_rotating_the_world_changes_no_observation(kind):
    scenario = five(kind)
    d, nonholonomic = scenario.dim, scenario.model.nonholonomic
    turn = TURN_ABOUT_Z[:d, :d] if nonholonomic else rotation(d)
    positions, given, turned = STARTS[d], {}, {}
    if nonholonomic:
        given = {"headings": attitudes(scenario)}
        turned = {"headings": attitudes(scenario, np.arctan2(0.8, 0.6))}
    else:
        frames = Simulator(scenario, 32)
        frames.reset(5)
        given = {"frames": frames.frames}
        turned = {"frames": turn @ frames.frames}
    seen, places, sim = follow(scenario, options={"positions": positions, **given})
    seen_turned, places_turned, _ = follow(
        scenario, options={"positions": positions @ turn.T, **turned}
    )
    assert not sim.active.all()
    np.testing.assert_allclose(seen_turned, seen, atol=2e-4)
    np.testing.assert_allclose(places_turned, places @ turn.T, atol=1e-4)
    np.testing.assert_allclose(seen_turned[0], seen[0], atol=3e-7)


def test_gravity_breaks_every_other_rotation():
    scenario = five("nonholonomic_3d")
    sim = Simulator(scenario, 32)
    upright = sim.reset(5, start(scenario, STARTS[3]))
    tilted = sim.reset(5, start(scenario, STARTS[3] @ rotation(3).T))
    assert np.abs(upright - tilted).max() > 0.1
    layout = scenario.observation_layout
    np.testing.assert_array_equal(upright[..., layout.gravity, :], tilted[..., layout.gravity, :])


def test_rotating_one_frame_rotates_that_observation_and_no_other():
    scenario = five("single_integrator-3d", local_frames="global")
    sim = Simulator(scenario, 32)
    plain = sim.reset(5, {"positions": STARTS[3]})
    frames = np.tile(np.eye(3), (5, 1, 1))
    frames[2] = rotation(3)
    turned = sim.reset(5, {"positions": STARTS[3], "frames": frames})
    np.testing.assert_allclose(turned[:, 2], plain[:, 2] @ rotation(3), atol=3e-7)
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(turned[:, others], plain[:, others])


def test_the_frame_of_an_action_is_the_robots_own():
    scenario = five("single_integrator-2d", max_speed=5.0)
    sim = Simulator(scenario)
    frames = np.tile(rotation(2), (5, 1, 1))
    sim.reset(0, {"positions": STARTS[2][0], "frames": frames})
    before = sim.positions
    action = np.zeros((1, 5, 2), np.float32)
    action[0, 3] = (1.0, 2.0)
    sim.step(action)
    moved = (sim.positions - before)[0] / scenario.tau
    np.testing.assert_allclose(moved[3], rotation(2) @ [1.0, 2.0], rtol=1e-6)
    assert not moved[[0, 1, 2, 4]].any()


def test_moving_the_world_changes_no_observation(kind):
    scenario = five(kind)
    shift = np.array([7.0, -3.0, 11.0])[: scenario.dim]
    seen, places, _ = follow(scenario, options=start(scenario, STARTS[scenario.dim]))
    moved, places_moved, _ = follow(scenario, options=start(scenario, STARTS[scenario.dim] + shift))
    np.testing.assert_allclose(moved, seen, atol=2e-4)
    np.testing.assert_allclose(places_moved - shift, places, atol=1e-4)
    np.testing.assert_allclose(moved[0], seen[0], atol=3e-7)


def test_relabelling_the_robots_permutes_the_trajectories():
    """The others before anyone merges, for then the lower index keeps its heading."""
    order = np.array([3, 0, 4, 2, 1])
    for kind, model in MODELS.items():
        scenario = five(kind, local_frames="global")
        renamed = scenario.replace(graph=UNEQUAL[np.ix_(order, order)])
        single = not scenario.model.nonholonomic
        headed = {} if single else {"headings": attitudes(scenario)}
        headed_renamed = {} if single else {"headings": attitudes(scenario)[:, order]}
        positions = STARTS[model["dim"]]
        _, places, sim = follow(scenario, options={"positions": positions, **headed})
        _, renamed_places, renamed_sim = follow(
            renamed, options={"positions": positions[:, order], **headed_renamed}
        )
        # float32 actions add up in another order, so trajectories agree to their rounding
        calm = np.ones(32, bool) if single else sim.active.all(axis=1)
        assert calm.sum() >= 10
        np.testing.assert_allclose(renamed_places[:, calm], places[:, calm][:, :, order], atol=2e-5)
        np.testing.assert_array_equal(
            sim.active.sum(axis=1)[calm], renamed_sim.active.sum(axis=1)[calm]
        )


def test_relabelling_is_exact_but_for_rounding_when_the_actions_are():
    """With actions given rather than computed, positions agree to 1e-9 through all merges."""
    order = np.array([3, 0, 4, 2, 1])
    scenario = five("single_integrator-2d", local_frames="global", max_speed=3.0)
    renamed = scenario.replace(graph=UNEQUAL[np.ix_(order, order)])
    a, b = Simulator(scenario, 32), Simulator(renamed, 32)
    a.reset(0, {"positions": STARTS[2] / 3})
    b.reset(0, {"positions": STARTS[2][:, order] / 3})
    for _ in range(150):
        # everyone heads for the origin, which also merged robots agree about
        a.step(-a.positions.astype(np.float32))
        b.step(-b.positions.astype(np.float32))
        np.testing.assert_allclose(b.positions, a.positions[:, order], atol=1e-9)
    assert not a.active.all(axis=1).any()


# ---- batches ------------------------------------------------------------------------------------

BATCHED = {
    **{kind: five(kind, graph=graphs.erdos_renyi(0.4, (0.5, 1.5))) for kind in MODELS},
    "obstacles": Scenario(
        n_robots=5,
        graph=graphs.random_tree((0.5, 2.0)),
        obstacles=ObstacleField(count=(1, 4), radius=(0.4, 1.0), region=8.0, keep_out=0.2),
    ),
}


@pytest.mark.parametrize("name", BATCHED)
def test_a_batch_is_a_stack_of_singles_bit_for_bit(name):
    scenario, count, steps = BATCHED[name], 40, 50
    seen, places, batch = follow(scenario, count, steps=steps, seed=70)
    assert not batch.active.all()
    for i in (0, 1, 15, 16, 17, 31, 32, 39):  # the ends of the lanes
        seen_1, places_1, single = follow(scenario, 1, steps=steps, seed=70 + i)
        np.testing.assert_array_equal(seen_1[:, 0], seen[:, i])
        np.testing.assert_array_equal(places_1[:, 0], places[:, i])
        for (entry, own), all_teams in zip(
            single.get_state().items(), batch.get_state().values(), strict=True
        ):
            np.testing.assert_array_equal(own[0], all_teams[i], err_msg=entry)


@pytest.fixture
def widths(monkeypatch):
    """How many threads each step was given to, from here on."""
    given, real_share, real_part = [], threads.share, threads.part_of_all

    def share(run_kernel, blocks, most):
        given.append(most)
        real_share(run_kernel, blocks, most)

    def part_of_all(blocks):
        given.append(1)
        return real_part(blocks)

    monkeypatch.setattr(threads, "share", share)
    monkeypatch.setattr(threads, "part_of_all", part_of_all)
    return given


@pytest.mark.skipif(not compiled(), reason="plain Python has no threads")
def test_little_work_is_not_shared(widths):
    for n, width in ((8, 1), (32, 2)):
        simulator = Simulator(Scenario(n_robots=n, spawn_size=1e3), 512, num_threads=2)
        simulator.reset(0)
        widths.clear()
        simulator.step(np.zeros((512, n, 2), np.float32))
        assert widths == [width]


@pytest.mark.parametrize("name", BATCHED)
def test_the_place_in_the_batch_and_the_number_of_threads_do_not_matter(name, widths, monkeypatch):
    scenario, count = BATCHED[name], 40
    seeds = np.arange(70, 70 + count)
    order = np.random.default_rng(2).permutation(count)
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    one = follow(scenario, count, seed=seeds.tolist(), num_threads=1)
    two = follow(scenario, count, seed=seeds[order].tolist(), num_threads=2)
    observed = [1]  # at the start, by the caller
    assert widths == [*observed, *[1] * 60, *observed, *[2] * 60]
    for x, y in zip(one[:2], two[:2], strict=True):
        np.testing.assert_array_equal(y, x[:, order])
    for (entry, x), y in zip(one[2].get_state().items(), two[2].get_state().values(), strict=True):
        np.testing.assert_array_equal(y, x[order], err_msg=entry)


def test_a_bad_action_in_the_last_block_changes_none(monkeypatch):
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    sim = Simulator(BATCHED["unicycle"], 40, num_threads=2)
    sim.reset(3)
    before, actions = sim.get_state(), np.ones((40, 5, 2), np.float32)
    actions[39, 4, 1] = np.nan
    with pytest.raises(ValueError, match=r"robot_4 in team 39 is \[1\.0, nan\]"):
        sim.step(actions)
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


def test_a_small_batch_stays_in_the_callers_thread(monkeypatch):
    monkeypatch.setattr(threads, "_ensure_workers", lambda _: pytest.fail("a thread was used"))
    sim = Simulator(five("unicycle"), num_threads=8)
    sim.reset(0)
    assert sim.step(np.ones((1, 5, 2))).status[0] == RUNNING


def test_the_law_of_a_large_batch_needs_no_more_than_its_teams(kind):
    """Nothing that one team is given changes another."""
    sim = Simulator(five(kind), 20)
    sim.reset(1)
    other = copy.deepcopy(sim)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 5, sim.scenario.action_size))
    changed = actions.copy()
    changed[7] = 0.5
    sim.step(actions)
    other.step(changed)
    same = np.arange(20) != 7
    np.testing.assert_array_equal(sim.positions[same], other.positions[same])
    assert not np.array_equal(sim.positions[7], other.positions[7])


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
    sim.reset([5, None, 6])
    assert sim.seeds.tolist() == [5, 8, 6]
    np.testing.assert_array_equal(Simulator(five(kind)).reset(np.int64(9))[0], first[1])


def test_a_list_may_seed_some_teams_and_send_the_others_on():
    sim, other = Simulator(five("unicycle"), 2), Simulator(five("unicycle"), 2)
    sim.reset(3)
    mixed = sim.reset([None, 90])
    np.testing.assert_array_equal(mixed[1], Simulator(five("unicycle")).reset(90)[0])
    other.reset(3)
    np.testing.assert_array_equal(mixed[0], other.reset()[0])


def test_without_a_seed_two_simulators_differ():
    a, b = Simulator(five("unicycle"), 2), Simulator(five("unicycle"), 2)
    x, y = a.reset(), b.reset()
    assert not np.array_equal(x, y) and not np.array_equal(x[0], x[1])
    np.testing.assert_array_equal(
        Simulator(five("unicycle"), 2).reset([int(s) for s in a.seeds]), x
    )


def test_a_partial_reset_leaves_the_others_untouched(kind):
    sim = Simulator(five(kind), 20)
    sim.reset(4)
    policy = law_of(sim.scenario)
    for _ in range(30):
        sim.step(policy(sim.observe(), sim.time))
    before, copied = sim.get_state(), copy.deepcopy(sim)
    mask = np.zeros(20, bool)
    mask[[0, 3, 16, 19]] = True
    seen = sim.reset(mask=mask)
    after = sim.get_state()
    for name in before:
        np.testing.assert_array_equal(after[name][~mask], before[name][~mask], err_msg=name)
    assert (sim.steps == np.where(mask, 0, 30)).all() and sim.active[mask].all()
    np.testing.assert_array_equal(seen, sim.observe())
    whole = copied.reset()  # the next episode is the same, reset alone or with all
    np.testing.assert_array_equal(whole[mask], seen[mask])


def test_a_team_that_rests_passes_one_step(kind):
    sim = Simulator(five(kind), 2)
    sim.reset(1, resting=True)
    assert (sim.status == AWAITING_RESET).all()
    before, actions = sim.positions, np.ones((2, 5, sim.scenario.action_size))
    outcome = sim.step(actions)
    np.testing.assert_array_equal(sim.positions, before)
    assert (outcome.status == RUNNING).all() and (outcome.rewards == 0).all()
    assert (sim.steps == 0).all() and (sim.path_length == 0).all()
    sim.step(actions)
    assert (sim.steps == 1).all() and not np.array_equal(sim.positions, before)


def test_a_resting_team_that_starts_within_r_meets_in_its_first_own_step():
    sim = Simulator(Scenario(n_robots=2))
    sim.reset(0, {"positions": [[0.0, 0.0], [0.1, 0.0]]}, resting=True)
    assert sim.step(np.zeros((1, 2, 2))).status.tolist() == [RUNNING]
    assert sim.active.all()
    outcome = sim.step(np.zeros((1, 2, 2)))
    assert outcome.status.tolist() == [RENDEZVOUS] and sim.steps.tolist() == [1]


def test_the_end_of_an_episode():
    duo = Scenario(n_robots=2, time_limit=1.0)
    sim = Simulator(duo, 2)
    sim.reset(0, {"positions": [[[0, 0], [5, 0]], [[0, 0], [0.5, 0]]]})
    policy, steps = law_of(duo), 0
    while (sim.status == RUNNING).any():
        sim.step(policy(sim.observe(), sim.time))
        steps += 1
    assert steps == duo.max_steps == 10  # τ = 0.1 s
    assert sim.status.tolist() == [TIME_OUT, RENDEZVOUS]
    assert sim.steps.tolist() == [10, 2]  # (0.5 − 0.2)/2 = 0.15 s
    np.testing.assert_allclose(sim.time, [1.0, 0.2])
    np.testing.assert_allclose(sim.path_length, [2.0, 0.3], rtol=1e-6)
    state = sim.get_state()
    outcome = sim.step(np.ones((2, 2, 2)))  # both have finished: nothing happens
    assert (outcome.rewards == 0).all()
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, state[name], err_msg=name)


def test_set_max_steps():
    sim = Simulator(five("unicycle"))
    sim.set_max_steps(2)
    sim.reset(0)
    statuses = [int(sim.step(np.zeros((1, 5, 2))).status[0]) for _ in range(2)]
    assert statuses == [RUNNING, TIME_OUT]
    for wrong in (0, -1, 2.0, True, None):
        with pytest.raises(ValueError, match=f"max_cycles is {wrong!r}"):
            sim.set_max_steps(wrong)
    assert copy.deepcopy(sim).max_steps == 2


# ---- state --------------------------------------------------------------------------------------


def _halfway(kind: str, **changes: object) -> Simulator:
    sim = Simulator(five(kind, **changes), 20)
    policy, observations = law_of(sim.scenario), sim.reset(6)
    while sim.active.sum() > 90:
        observations = sim.step(policy(observations, sim.time)).observations
    assert (sim.active.sum(axis=1) > 1).any()
    return sim


def _continue(sim: Simulator, steps: int = 40) -> np.ndarray:
    policy, observations, seen = law_of(sim.scenario), sim.observe(), []
    for _ in range(steps):
        outcome = sim.step(policy(observations, sim.time))
        observations = outcome.observations
        seen.append(np.concatenate([observations.reshape(20, -1), outcome.rewards[:, None]], 1))
    return np.stack([*seen, np.concatenate([sim.reset().reshape(20, -1), np.zeros((20, 1))], 1)])


def _restored(sim: Simulator) -> Simulator:
    fresh = Simulator(sim.scenario, 20)
    fresh.reset(99)
    fresh.set_state(sim.get_state())
    return fresh


@pytest.mark.parametrize(
    "duplicate",
    [copy.deepcopy, copy.copy, lambda sim: pickle.loads(pickle.dumps(sim)), _restored],
    ids=["deepcopy", "copy", "pickle", "set_state"],
)
def test_an_episode_goes_on_from_a_copy(kind, duplicate):
    sim = _halfway(kind)
    twin = duplicate(sim)
    assert_same_state(sim, twin)
    np.testing.assert_array_equal(twin.lyapunov(), sim.lyapunov())
    state = twin.get_state()
    future = _continue(sim)
    for name, array in twin.get_state().items():  # independent of the original
        np.testing.assert_array_equal(array, state[name], err_msg=name)
    np.testing.assert_array_equal(_continue(twin), future)
    assert_same_state(sim, twin)


def test_a_state_from_before_the_last_step_takes_it_back(kind):
    sim = _halfway(kind)
    state, seen = sim.get_state(), sim.observe()
    future = _continue(sim)
    sim.set_state(state)
    np.testing.assert_array_equal(sim.observe(), seen)
    np.testing.assert_array_equal(_continue(sim), future)


def test_a_wrong_state_is_refused_and_changes_nothing():
    sim = _halfway("unicycle")
    good = sim.get_state()
    wrong = [
        ({k: v for k, v in good.items() if k != "memory"}, "'memory' is missing or unknown"),
        ({**good, "speed": good["steps"]}, "'speed' is missing or unknown"),
        (
            {**good, "positions": good["positions"][:3]},
            r"positions is float64 of shape \(3, 5, 2\)",
        ),
        ({**good, "steps": good["steps"].astype(float)}, "steps is float64 .* must be int64"),
    ]
    for state, message in wrong:
        with pytest.raises(ValueError, match=message):
            sim.set_state(state)
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, good[name], err_msg=name)


def test_what_the_simulator_hands_out_is_not_its_memory(kind):
    sim = _halfway(kind)
    outcome = sim.step(np.zeros((20, 5, sim.scenario.action_size)))
    before = sim.get_state()
    handed = [getattr(sim, name) for name in (
        "positions", "headings", "frames", "weights", "obstacles", "merged_into", "active",
        "status", "steps", "time", "seeds", "initial_lyapunov", "path_length",
        "contacts", "min_clearance",
    )]  # fmt: skip
    handed += [getattr(outcome, name) for name in (
        "observations", "contact", "clearance", "active", "status", "rewards",
        "lyapunov_before_merge",
    )]  # fmt: skip
    for array in [*handed, sim.lyapunov(), sim.observe(), *sim.get_state().values()]:
        array[...] = 1
    assert sim.all_running and not sim.ended.any() and (sim.status == RUNNING).all()
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


def _step_in_child(sim: Simulator, actions: np.ndarray, pipe) -> None:
    sim.step(actions)
    pipe.send(sim.positions)
    pipe.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_fork_after_a_threaded_step_works(monkeypatch):
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    sim = Simulator(five("unicycle"), 64, num_threads=2)
    sim.reset(0)
    actions = np.ones((64, 5, 2), np.float32)
    sim.step(actions)
    assert sim._runner.width == 2 and len(threads._workers) >= 1
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_step_in_child, args=(sim, actions, sender))
    child.start()
    assert receiver.poll(60), "the forked child hangs"
    positions = receiver.recv()
    child.join(20)
    assert child.exitcode == 0
    sim.step(actions)
    np.testing.assert_array_equal(positions, sim.positions)


# ---- what is given ------------------------------------------------------------------------------


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
    sim.reset(0)
    np.testing.assert_array_equal(sim.weights[31], UNEQUAL)
    assert not np.array_equal(sim.positions, STARTS[scenario.dim])


def test_one_start_for_all_teams_and_yaw_without_an_axis():
    sim = Simulator(five("unicycle"), 3)
    sim.reset(0, {"positions": STARTS[2][0], "headings": [0.1, 0.2, 0.3, 0.4, 0.5]})
    for team in range(3):
        np.testing.assert_array_equal(sim.positions[team], STARTS[2][0])
        assert sim.headings[team, :, 0].tolist() == [0.1, 0.2, 0.3, 0.4, 0.5]


def test_given_parts_leave_the_draws_of_the_others_as_they_were(kind):
    scenario = five(kind, graph=graphs.random_tree((0.5, 2.0)))
    drawn, given = Simulator(scenario, 4), Simulator(scenario, 4)
    drawn.reset(3)
    given.reset(3, {"positions": STARTS[scenario.dim][:4]})
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
    "positions-text": ("unicycle", {"positions": "here"}, "positions is .*must be numbers"),
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
    "misspelt": ("unicycle", {"position": STARTS[2][0]},
        "'position' is not an option; did you mean 'positions'"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_OPTIONS)
def test_bad_options_are_refused_by_name_and_change_nothing(name):
    kind, options, message = BAD_OPTIONS[name]
    sim = Simulator(five(kind), 3)
    sim.reset(1)
    sim.step(np.ones((3, 5, sim.scenario.action_size)))
    before = sim.get_state()
    with pytest.raises(ValueError, match=message):
        sim.reset(2, options)
    for entry, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[entry], err_msg=entry)
    fresh = Simulator(five(kind), 3)
    fresh.reset(1)
    np.testing.assert_array_equal(sim.reset(), fresh.reset())  # the episode count did not move


def test_an_unknown_option_is_ignored():
    sim = Simulator(five("unicycle"))
    np.testing.assert_array_equal(sim.reset(1, {"colour": "red", "options": 1}), sim.reset(1))


def test_given_obstacles_and_robots_inside_them():
    scenario = five("single_integrator-2d", obstacle_slots=2)
    sim = Simulator(scenario, 2)
    disc = Disc((9.0, 9.0), 0.5)
    sim.reset(0, {"obstacles": [disc], "positions": STARTS[2][0]})
    assert sim.obstacles.shape[1] == 2 and (sim.obstacles[:, 0, 0] >= 0).all()
    with pytest.raises(ValueError, match=r"positions: robot.0 at .* inside Disc"):
        sim.reset(0, {"obstacles": [Disc((0.0, 0.0), 9.0)], "positions": STARTS[2][0]})


def test_bad_seeds_and_masks_are_refused_and_change_nothing():
    sim = Simulator(five("unicycle"), 3)
    sim.reset(1)
    before = sim.get_state()
    for seed, message in (
        (-1, "seed -1 must be"),
        (1.5, "seed 1.5 must be a whole number"),
        (True, "seed True must be a whole number"),
        ([1, 2], "seed has 2 entries; it must be one number, or 3"),
        ([1, 2, -3], "seed -3 must be a whole number"),
        ([1, 2, "x"], "seed 'x' must be a whole number"),
        (2**63, "must be a whole number"),
    ):
        with pytest.raises(ValueError, match=message):
            sim.reset(seed)
    for mask in (np.ones(2, bool), np.ones(3), [0, 1, 1]):
        with pytest.raises(ValueError, match=r"mask is .* must be bool"):
            sim.reset(mask=mask)
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


def test_a_start_without_room_is_refused_and_changes_nothing():
    crowded = five("unicycle", spawn_size=0.3, graph=graphs.complete())
    sim = Simulator(crowded, 3)
    sim.reset(0, {"positions": STARTS[2][0]})
    sim.step(np.ones((3, 5, 2)))
    before = sim.get_state()
    with pytest.raises(RuntimeError, match=r"no room for the start of team 0.*spawn_size of 0\.3"):
        sim.reset(5)
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


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


def test_if_one_team_finds_no_room_none_begins_anew():
    sim = Simulator(five("unicycle", spawn_size=0.8, graph=graphs.complete()), 3)
    sim.reset([0, 1, 4])
    sim.step(np.ones((3, 5, 2)))
    before = sim.get_state()
    with pytest.raises(RuntimeError, match="no room for the start of team 2"):
        sim.reset([4, 9, 2])
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


@pytest.mark.parametrize("name", ["num_envs", "num_threads"])
@pytest.mark.parametrize("value", [0, -2, 1.0, "2"])
def test_impossible_sizes(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value!r}; it must be a whole number"):
        Simulator(five("unicycle"), **{name: value})


def test_a_step_before_the_first_reset():
    with pytest.raises(RuntimeError, match="call reset"):
        Simulator(five("unicycle")).step(np.zeros((1, 5, 2)))


# ---- actions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_actions_that_are_not_finite_change_nothing(kind, value):
    sim = _halfway(kind)
    before = sim.get_state()
    actions = np.ones((20, 5, sim.scenario.action_size), np.float32)
    actions[6, 3, 1] = value
    with pytest.raises(ValueError, match=r"action of robot_3 in team 6 is .* must be finite"):
        sim.step(actions)
    with pytest.raises(ValueError, match=r"actions have shape \(5, 2\); they must be \(B, n, a\)"):
        sim.step(np.ones((5, 2)))
    for name, array in sim.get_state().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


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
    sim = _halfway(kind)
    other, gone = copy.deepcopy(sim), ~sim.active
    actions = np.zeros((20, 5, sim.scenario.action_size))
    sim.step(actions)
    actions[gone] = 3.0
    other.step(actions)
    assert gone.any()
    assert_same_state(sim, other)


# ---- without compilation ------------------------------------------------------------------------

PLAIN_PYTHON = """
import sys
import numpy as np
import numba
from rendezvous_env import Disc, Scenario, Simulator
from rendezvous_env.engine.stages import step as kernels

assert numba.config.DISABLE_JIT == (sys.argv[1] == "plain")
assert hasattr(kernels.step_blocks, "py_func") == (sys.argv[1] != "plain")
arrays = {}
for model, dim in (("single_integrator", 2), ("unicycle", 2), ("nonholonomic_3d", 3)):
    world = [Disc((0.0, 0.6), 0.5)] if dim == 2 else []
    scenario = Scenario(n_robots=3, dim=dim, robot_model=model, spawn_size=3.0, obstacles=world,
                        merge_radius=0.4, graph="path", local_frames="global", time_step=0.1,
                        allow_long_step=True)
    simulator = Simulator(scenario, 2)
    arrays[f"{model}-seen"] = simulator.reset(3)
    inputs = np.random.default_rng(0)
    for k in range(10):
        towards = -simulator.positions if model == "single_integrator" else 0.0
        actions = inputs.uniform(-1, 1, (2, 3, scenario.action_size)) + towards
        outcome = simulator.step(np.round(actions, 3))
        arrays[f"{model}-seen-{k}"] = outcome.observations
        arrays[f"{model}-places-{k}"] = simulator.positions
        arrays[f"{model}-rewards-{k}"] = outcome.rewards
    arrays[f"{model}-active"] = simulator.active
np.savez(sys.argv[2], **arrays)
"""


def test_plain_python_gives_the_same_trajectories(tmp_path):
    results = {}
    for mode, disable in (("compiled", "0"), ("plain", "1")):
        path = tmp_path / f"{mode}.npz"
        subprocess.run(
            [sys.executable, "-W", "error", "-c", PLAIN_PYTHON, mode, str(path)],
            check=True,
            cwd=ROOT,
            env={**os.environ, "NUMBA_DISABLE_JIT": disable},
            timeout=300,
        )
        results[mode] = dict(np.load(path))
    assert results["plain"].keys() == results["compiled"].keys()
    for name, array in results["compiled"].items():
        tolerance = 3e-7 if array.dtype == np.float32 else 1e-12
        np.testing.assert_allclose(results["plain"][name], array, atol=tolerance, err_msg=name)
    assert not results["plain"]["single_integrator-active"].all()
