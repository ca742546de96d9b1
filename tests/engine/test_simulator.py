"""Symmetries, batching, state and refusals of the simulator."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from conftest import MODELS, UNEQUAL, assert_same_state, five, law_of, refusing

from rendezvous_env import ObstacleField, Scenario, Simulator, graphs
from rendezvous_env.compilation import compiled
from rendezvous_env.engine import batch_runner, threads
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
    seen, places, sim = follow(near, options={"positions": STARTS[near.dim]})
    seen_far, places_far, _ = follow(far, options={"positions": 4 * STARTS[near.dim]})
    np.testing.assert_array_equal(seen_far, seen)
    np.testing.assert_array_equal(places_far, 4 * places)
    assert not sim.active.all()


def test_rotating_and_moving_the_world_changes_no_observation(kind):
    scenario = five(kind)
    d, nonholonomic = scenario.dim, scenario.model.nonholonomic
    turn = TURN_ABOUT_Z[:d, :d] if nonholonomic else rotation(d)
    shift = np.array([7.0, -3.0, 11.0])[:d]
    if nonholonomic:
        given = {"headings": attitudes(scenario)}
        turned = {"headings": attitudes(scenario, np.arctan2(0.8, 0.6))}
    else:
        frames = Simulator(scenario, 32)
        frames.reset(5)
        given, turned = {"frames": frames.frames}, {"frames": turn @ frames.frames}
    positions = STARTS[d]
    seen, places, sim = follow(scenario, options={"positions": positions, **given})
    turned["positions"] = positions @ turn.T + shift
    seen_turned, places_turned, _ = follow(scenario, options=turned)
    assert not sim.active.all()
    np.testing.assert_allclose(seen_turned, seen, atol=2e-4)
    np.testing.assert_allclose(places_turned - shift, places @ turn.T, atol=1e-4)
    np.testing.assert_allclose(seen_turned[0], seen[0], atol=3e-7)


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


# ---- batches ------------------------------------------------------------------------------------

BATCHED = {
    **{kind: five(kind, graph=graphs.erdos_renyi(0.4, (0.5, 1.5))) for kind in MODELS},
    "obstacles": Scenario(
        n_robots=5,
        graph=graphs.random_tree((0.5, 2.0)),
        obstacles=ObstacleField(count=(1, 4), radius=(0.4, 1.0), region=8.0, keep_out=0.2),
    ),
}


@pytest.fixture
def widths(monkeypatch):
    """How many threads each step was shared among, from here on; none if it was not."""
    given, real_share = [], threads.share

    def share(calls_of, blocks, most, ahead=0.0):
        given.append(most)
        real_share(calls_of, blocks, most, ahead)

    monkeypatch.setattr(threads, "share", share)
    return given


@pytest.mark.skipif(not compiled(), reason="plain Python has no threads")
def test_little_work_is_not_shared(widths):
    for n, shared in ((8, []), (32, [2])):
        simulator = Simulator(Scenario(n_robots=n, spawn_size=1e3), 512, num_threads=2)
        simulator.reset(0)
        widths.clear()
        simulator.step(np.zeros((512, n, 2), np.float32))
        assert widths == shared


@pytest.mark.parametrize("name", BATCHED)
def test_the_place_in_the_batch_and_the_number_of_threads_do_not_matter(name, widths, monkeypatch):
    scenario, count = BATCHED[name], 40
    seeds = np.arange(70, 70 + count)
    order = np.random.default_rng(2).permutation(count)
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    one = follow(scenario, count, seed=seeds.tolist(), num_threads=1)
    two = follow(scenario, count, seed=seeds[order].tolist(), num_threads=2)
    assert widths == [2] * 60
    for x, y in zip(one[:2], two[:2], strict=True):
        np.testing.assert_array_equal(y, x[:, order])
    assert_same_state(two[2], {name: x[order] for name, x in one[2].get_state().items()})


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
    sim, fresh = Simulator(Scenario(n_robots=2), 2), Simulator(Scenario(n_robots=2), 2)
    sim.reset(0)

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
    sim = Simulator(Scenario(n_robots=2, start_positions=((0.0, 0.0), (0.1, 0.0))))
    sim.reset(0)
    sim.restart(np.array([True]))
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
    assert_same_state(sim, state)


def test_set_max_steps():
    sim = Simulator(five("unicycle"))
    sim.set_max_steps(2)
    sim.reset(0)
    statuses = [int(sim.step(np.zeros((1, 5, 2))).status[0]) for _ in range(2)]
    assert statuses == [RUNNING, TIME_OUT] and copy.deepcopy(sim).max_steps == 2
    with pytest.raises(ValueError, match="max_cycles is None"):
        sim.set_max_steps(None)


# ---- state --------------------------------------------------------------------------------------


def halfway(kind: str, **changes: object) -> Simulator:
    sim = Simulator(five(kind, **changes), 20)
    policy, observations = law_of(sim.scenario), sim.reset(6)
    while sim.active.sum() > 90:
        observations = sim.step(policy(observations, sim.time)).observations
    assert (sim.active.sum(axis=1) > 1).any()
    return sim


def test_a_wrong_state_is_refused_and_changes_nothing():
    sim = halfway("unicycle")
    good = sim.get_state()
    for state, message in (
        ({k: v for k, v in good.items() if k != "memory"}, "'memory' is missing"),
        (good | {"speed": good["steps"]}, "'speed' is unknown; it must be one of positions"),
        (good | {"positions": good["positions"][:3]}, r"is float64 of shape \(3, 5, 2\)"),
        (good | {"steps": good["steps"].astype(float)}, "steps is float64 .* must be int64"),
    ):
        with refusing(sim, message):
            sim.set_state(state)


def test_what_the_simulator_hands_out_is_not_its_memory(kind):
    sim = halfway(kind)
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
    assert_same_state(sim, before)
