"""Spatial index of obstacles: bitwise the numbers of an engine that visits every obstacle."""

import numpy as np
import pytest
from geometry import world
from parameters import slow

import rendezvous_env as rv
from rendezvous_env import Capsule, Disc, Polygon, Scenario
from rendezvous_env.obstacles import spatial_index
from rendezvous_env.obstacles.obstacle_set import distance_to
from rendezvous_env.obstacles.spatial_index import gather, index_of, nearest_group, shape_of

NEAREST = {"obstacle_slots": 6, "obstacle_overflow": "nearest"}
NOISY = {**NEAREST, "sensing": rv.Sensing(noise=0.1)}


def random_shapes(count, size, kinds="dpc", seed=0):
    """Small discs, rectangles and capsules in a square, and a long wall among polygons."""
    random = np.random.default_rng(seed)
    found = []
    for k in range(count):
        x, y = random.uniform(-size / 2, size / 2, 2).tolist()
        w, h = random.uniform(0.05, 0.4, 2).tolist()
        kind = kinds[k % len(kinds)]
        if kind == "d":
            found.append(Disc((x, y), w))
        elif kind == "c":
            found.append(Capsule(((x, y), (x + w, y - h)), 0.1))
        else:
            found.append(Polygon(((x, y), (x + w, y), (x + w, y + h), (x, y + h))))
    if "p" in kinds:
        found.append(Polygon(((-size, -size), (size, -size), (size, -size + 0.1))))
    return tuple(found)


def trajectory(scenario, num_envs, steps=40):
    """Everything that a simulator reports in some steps with random actions."""
    simulator = rv.Simulator(scenario, num_envs)
    found, random = [simulator.reset(seed=3)], np.random.default_rng(1)
    for step in range(steps):
        if step == steps // 2:
            simulator.set_state(simulator.get_state())
        actions = random.normal(size=(num_envs, scenario.n_robots, scenario.action_size))
        output = simulator.step(3.0 * (np.abs(actions) if step % 8 < 5 else actions))
        found += [output.observations, output.contact, output.clearance, output.scores]
        found.append(simulator.positions)
    return found, simulator


@pytest.mark.parametrize("model", ["single_integrator", slow("unicycle")])
@pytest.mark.parametrize(
    ("kinds", "more"),
    [
        slow("dpc", {}),
        ("d", {}),
        ("dpc", NEAREST),
        ("d", NEAREST),
        slow("dpc", NOISY),
        pytest.param(
            "dpc", {"obstacle_contact": "stop"}, marks=[pytest.mark.slow, pytest.mark.kernels]
        ),
    ],
    ids=["any", "discs", "nearest", "nearest-discs", "noisy", "stop"],
)
def test_index_changes_no_number(monkeypatch, model, kinds, more):
    scenario = Scenario(
        n_robots=4, merge_radius=0.1, time_step=0.1, max_speed=4.0, max_turn_rate=6.0,
        allow_long_step=True, robot_model=model, obstacles=random_shapes(90, 8.0, kinds), **more,
    )  # fmt: skip
    for num_envs in (1, 6):
        indexed, simulator = trajectory(scenario, num_envs)
        assert simulator._state.index is not None
        with monkeypatch.context() as patch:
            patch.setattr(spatial_index, "INDEX_FROM", 1000)
            every, simulator = trajectory(scenario.replace(), num_envs)  # no cached layout
        assert simulator._state.index is None
        assert sum(contact.sum() for contact in indexed[2::5]) > 0
        for ours, theirs in zip(indexed, every, strict=True):
            assert np.array_equal(ours, theirs)


@pytest.mark.kernels
def test_index_follows_given_obstacles(monkeypatch):
    scenario = Scenario(obstacles=random_shapes(80, 30.0), n_robots=3)
    options = {"obstacles": random_shapes(70, 8.0, seed=5)}
    found = []
    for least in (64, 1000):
        monkeypatch.setattr(spatial_index, "INDEX_FROM", least)
        simulator = rv.Simulator(scenario.replace(), 2)  # no cached layout
        simulator.reset(seed=0)
        found.append(simulator.reset(seed=1, options=options, mask=np.array([False, True])))
        found.append(simulator.clearance)
    assert np.array_equal(found[0], found[2]) and np.array_equal(found[1], found[3])


def test_environments_share_scenario_obstacles():
    scenario = Scenario(obstacles=random_shapes(80, 30.0), n_robots=3)
    other = random_shapes(70, 8.0, seed=5)
    simulator = rv.Simulator(scenario, 3)
    sources = [simulator._state.index.source]
    simulator.reset(seed=0)
    assert sources[0].tolist() == [3, 3, 3]
    simulator.reset(seed=1, options={"obstacles": other}, mask=np.array([False, True, False]))
    assert sources[0].tolist() == [3, 1, 3]
    twin = rv.Simulator(scenario, 3)
    twin.reset(seed=9)
    twin.set_state(simulator.get_state())
    assert twin._state.index.source.tolist() == [3, 1, 3]
    for _ in range(5):
        actions = np.ones((3, 3, 2))
        assert np.array_equal(simulator.step(actions).observations, twin.step(actions).observations)
    simulator.reset(seed=1, options={"obstacles": scenario.obstacles})
    given = simulator.reset(seed=1)
    assert sources[0].tolist() == [3, 3, 3]
    assert np.array_equal(given, rv.Simulator(scenario, 3).reset(seed=1))


def test_failed_reset_keeps_obstacles():
    scenario = Scenario(obstacles=random_shapes(80, 30.0), n_robots=3)
    simulator = rv.Simulator(scenario, 2)
    simulator.reset(seed=1, options={"obstacles": random_shapes(70, 8.0, seed=5)})
    state, source = simulator.get_state(), simulator._state.index.source.copy()
    with pytest.raises(RuntimeError, match="no room"):
        simulator.reset(seed=2, options={"obstacles": (Disc((0.0, 0.0), 1e4),)})
    assert source.tolist() == simulator._state.index.source.tolist() == [0, 1]
    assert np.array_equal(state["obstacles"], simulator.get_state()["obstacles"])


@pytest.mark.kernels
@pytest.mark.parametrize("slots", [0, 1, 2, 63, 64, 65, 2000])
def test_groups_have_room_for_all_slots(slots):
    groups, places = shape_of(slots)
    assert groups * places >= slots and (groups - 1) * places < max(slots, 1)


@pytest.mark.kernels
def test_gather_finds_every_near_obstacle_in_order():
    scene = world(random_shapes(150, 12.0), 170)
    table = type(scene)(*(array[None] for array in scene))
    near = type(scene)(*(np.zeros_like(array) for array in scene))
    index, listed = index_of(table), np.zeros(170, np.int64)
    random = np.random.default_rng(2)
    for _ in range(200):
        point, reach = (*random.uniform(-8, 8, 2).tolist(), 0.0), random.uniform(0, 3)
        count = gather(scene, index, 0, point, reach, near, listed)
        chosen = listed[:count].tolist()
        assert chosen == sorted(set(chosen))
        distances = [distance_to(scene, m, point) for m in range(170)]
        assert set(np.flatnonzero(np.array(distances) <= reach)) <= set(chosen)
        assert np.array_equal(near.shapes[:count], scene.shapes[chosen])
        group = nearest_group(index, 0, point)
        assert 0 <= group < index.groups.shape[1]


@pytest.mark.kernels
def test_few_or_sampled_obstacles_have_no_index():
    few = Scenario(obstacles=random_shapes(20, 8.0))
    sampled = Scenario(obstacles=rv.ObstacleField(80), spawn_size=60.0)
    for scenario in (few, sampled, Scenario()):
        assert rv.Simulator(scenario)._state.index is None
