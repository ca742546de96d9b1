"""Observations of fixed size for any team and map: padding, or nearest rows."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, baselines

DISCS = tuple(rv.Disc((float(x), float(y)), 0.4) for x in range(-6, 7, 3) for y in (-6, -3, 3, 6))
TEAM = Scenario(n_robots=5, sensing=rv.Sensing(dropout=0.2), spawn_size=4.0)


def steps_of(scenario, count=15, seed=3, num_envs=3):
    """Simulator after each step of law (1) with all rows, and its observations."""
    full = scenario.with_all_rows
    law = baselines.make("bearing-only", full)
    own, other = Simulator(scenario, num_envs), Simulator(full, num_envs)
    seen, all_seen = own.reset(seed), other.reset(seed)
    for _ in range(count):
        yield own, seen, all_seen
        actions = law(all_seen, other.time)
        seen, all_seen = own.step(actions).observations, other.step(actions).observations


def test_rows_beyond_the_team_are_zero():
    wide, plain = TEAM.replace(neighbour_slots=9), TEAM.replace(neighbour_slots=4)
    assert wide.observation_layout.shape == (9, 2)
    for (_, seen, _), (_, narrow, _) in zip(steps_of(wide), steps_of(plain), strict=True):
        np.testing.assert_array_equal(seen[..., :4, :], narrow)
        assert not seen[..., 4:, :].any()


def test_rows_beyond_the_team_change_no_law_and_no_certificate():
    for name in ("bearing-only", "smallest-sector", "learned"):
        found = [
            rv.rollout(one, baselines.make(name, one), seed=1, num_envs=2)
            for one in (TEAM, TEAM.replace(neighbour_slots=12))
        ]
        np.testing.assert_array_equal(*(one.positions for one in found))
    wide = TEAM.replace(neighbour_slots=12, sensing=rv.Sensing())
    assert rv.certificate(wide) == rv.certificate(TEAM.replace(sensing=rv.Sensing()))
    wrapped = rv.HeadingVectorWrapper(rv.parallel_env(wide))
    observations, _ = wrapped.reset(seed=0)
    assert observations["robot_0"].shape == (12, 2)
    wrapped.step({name: wrapped.action_space(name).sample() for name in wrapped.agents})


@pytest.mark.parametrize("graph", ["complete", "star", rv.graphs.directed_cycle(), "random_tree"])
def test_nearest_neighbours_are_shown_in_their_order(graph):
    scenario = Scenario(
        n_robots=6, graph=graph, spawn_size=4.0, neighbour_slots=2, neighbour_overflow="nearest",
        sensing=rv.Sensing(range=3.0),
    )  # fmt: skip
    dropped = 0
    for own, seen, all_seen in steps_of(scenario):
        assert seen.shape == (3, 6, 2, 2)
        others = [[j for j in range(6) if j != i] for i in range(6)]
        for env in range(3):
            for i in range(6):
                rows = all_seen[env, i, :5] if all_seen.shape[2] >= 5 else None
                if rows is None:  # nothing can be dropped
                    np.testing.assert_array_equal(seen[env, i], all_seen[env, i])
                    continue
                there = [k for k in range(5) if rows[k].any()]
                offsets = own.positions[env, others[i]] - own.positions[env, i]
                near = sorted(there, key=lambda k: np.linalg.norm(offsets[k]))[:2]
                wanted = np.zeros((2, 2), np.float32)
                if near:
                    wanted[: len(near)] = rows[sorted(near)]
                np.testing.assert_array_equal(seen[env, i], wanted)
                dropped += len(there) > 2
    assert dropped > 0 or graph not in ("complete", "star")


def test_nearest_neighbours_of_large_sparse_teams():
    scenario = Scenario(
        n_robots=60, graph="star", neighbour_slots=3, neighbour_overflow="nearest", spawn_size=60.0
    )
    own = Simulator(scenario, 1)
    seen = own.reset(0)[0]
    hub = own.positions[0, 1:] - own.positions[0, 0]
    order = np.sort(np.argsort(np.linalg.norm(hub, axis=-1))[:3])
    frame = own.frames[0, 0]
    wanted = (hub[order] / np.linalg.norm(hub[order], axis=-1, keepdims=True)) @ frame
    np.testing.assert_allclose(seen[0], wanted, atol=1e-6)


@pytest.mark.kernels
@pytest.mark.parametrize("fields", [{}, {"robot_model": "double_integrator"}])
def test_nearest_obstacles_are_shown_in_their_order(fields):
    scenario = Scenario(
        n_robots=4, obstacles=DISCS, obstacle_slots=3, obstacle_overflow="nearest",
        obstacle_range=4.0, spawn_size=14.0, **fields,
    )  # fmt: skip
    layout, full = scenario.observation_layout, scenario.with_all_rows.observation_layout
    assert layout.obstacle_slots == 3 and full.obstacle_slots == len(DISCS)
    own, other = Simulator(scenario, 3), Simulator(scenario.with_all_rows, 3)
    seen, all_seen = own.reset(2), other.reset(2)
    centres = np.array([disc.centre for disc in DISCS])
    assert own.obstacles.shape[1] == len(DISCS)
    few, many = layout.split(seen), full.split(all_seen)
    np.testing.assert_array_equal(few.neighbours, many.neighbours)
    if fields:
        np.testing.assert_array_equal(few.velocity, many.velocity)
    dropped = 0
    for env in range(3):
        for i in range(4):
            near = np.linalg.norm(centres - own.positions[env, i], axis=-1)
            there = [m for m in range(len(DISCS)) if many.obstacles[env, i, m].any()]
            order = sorted(sorted(there, key=lambda m: near[m])[:3])
            wanted = np.zeros((3, 2, 2), np.float32)
            if order:
                wanted[: len(order)] = many.obstacles[env, i, order]
            np.testing.assert_array_equal(few.obstacles[env, i], wanted)
            dropped += len(there) > 3
    assert dropped > 0


def test_a_large_map_has_small_observations():
    cells = rv.WallField("rooms", (10.0, 14.0), (0.8, 1.2), 0.5, 2.0, 0.5)
    rooms = Scenario(
        n_robots=4, obstacles=cells, spawn_size=14.0, neighbour_slots=7,
        neighbour_overflow="nearest", obstacle_slots=4, obstacle_overflow="nearest",
    )  # fmt: skip
    free = rooms.replace(obstacles=(), n_robots=8)
    assert rooms.observation_layout == free.observation_layout
    for scenario in (rooms, free):
        env = rv.make_vec(scenario, num_envs=6)
        seen, _ = env.reset(seed=0)
        assert seen.shape[2:] == (7 + 8, 2)
        for _ in range(5):
            seen, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
            assert env.observation_space.contains(seen)


def test_one_team_and_many_see_the_same_with_autoreset_and_from_a_state():
    scenario = Scenario(
        n_robots=4, obstacles=rv.ObstacleField(6), obstacle_slots=2, obstacle_overflow="nearest",
        neighbour_slots=2, neighbour_overflow="nearest", time_limit=0.5,
    )  # fmt: skip
    law = baselines.make("zero", scenario)
    many = rv.make_vec(scenario, num_envs=3, autoreset_mode="SameStep")
    seen, _ = many.reset(seed=5)
    alone = [rv.make_vec(scenario, num_envs=1, autoreset_mode="SameStep") for _ in range(3)]
    first = [one.reset(seed=5 + k)[0] for k, one in enumerate(alone)]
    np.testing.assert_array_equal(seen, np.concatenate(first))
    for _ in range(25):
        seen, *_ = many.step(law(seen, many.simulator.time))
        single = [one.step(law(seen[k : k + 1], 0.0))[0] for k, one in enumerate(alone)]
        np.testing.assert_array_equal(seen, np.concatenate(single))
    again = rv.Simulator(scenario, 3)
    again.set_state(many.simulator.get_state())
    np.testing.assert_array_equal(again.observe(), many.simulator.observe())


def test_custom_imperfections_see_all_rows_before_the_nearest_are_chosen():
    shapes = []

    @rv.sensor_imperfection("notes-the-shape")
    def notes(seen):
        shapes.append(seen.neighbours.shape)
        seen.neighbours[...] = 0.0

    scenario = Scenario(
        n_robots=5, neighbour_slots=2, neighbour_overflow="nearest",
        sensing=rv.Sensing(custom=("notes-the-shape",)),
    )  # fmt: skip
    simulator = Simulator(scenario, 2)
    assert not simulator.reset(0).any()
    assert set(shapes) == {(2, 5, 4, 2)}


def test_files_keep_the_overflow(tmp_path):
    scenario = Scenario(neighbour_slots=2, neighbour_overflow="nearest", obstacle_slots=8)
    scenario.to_toml(tmp_path / "own.toml")
    assert Scenario.from_toml(tmp_path / "own.toml").replace(name="custom") == scenario
    assert "overflow" not in str(Scenario().to_plain())


def test_no_guarantee_where_neighbours_are_left_out():
    scenario = Scenario(n_robots=5, neighbour_slots=2, neighbour_overflow="nearest")
    assert scenario.drops_neighbours
    for by in ("law", "heading", "tank", "gains", "links"):
        margin = 0.1 if by == "heading" else 1.0
        found = rv.certificate(scenario, margin, by=by)
        assert not found.guaranteed and found.promises == {}
        assert "neighbour_overflow='nearest'" in found.theorem
    for wrapper in (rv.HeadingVectorWrapper, rv.EnergyTankWrapper, rv.GainWrapper):
        with pytest.raises(ValueError, match=r"neighbour_slots 2 .* give it neighbour_slots=4"):
            wrapper(rv.parallel_env(scenario))
    with pytest.raises(ValueError, match="neighbour_slots=4"):
        baselines.HeadingPolicy(scenario, lambda seen: seen[..., 0, :])
    ring = scenario.replace(graph="cycle")
    assert not ring.drops_neighbours and rv.certificate(ring).guaranteed


def test_overflow_is_an_error_unless_nearest_is_asked_for():
    star = Scenario(n_robots=5, graph="star", neighbour_slots=2)
    with pytest.raises(RuntimeError, match="more than neighbour_slots = 2"):
        Simulator(star, 1).reset(0)
    with pytest.raises(ValueError, match="unless obstacle_overflow is 'nearest'"):
        Scenario(obstacles=DISCS, obstacle_slots=3)
