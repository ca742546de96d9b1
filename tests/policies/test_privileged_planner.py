"""Oracle planner with the map: inputs, paths, and success."""

import math

import numpy as np
import pytest
from parameters import slow

import baselines
import rendezvous_env as rv
from baselines.references.privileged_planner import NAME, meeting_place
from baselines.references.roadmap import PathsTo, Roadmap
from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator, Sphere
from rendezvous_env.obstacles.obstacle_set import pack

BOX = Polygon(((-0.5, -2), (0.5, -2), (0.5, 2), (-0.5, 2)))
BAR = Capsule(((-4, -3), (-2, -4)), 0.5)
AT_A_SURFACE = ((-0.5, 0.0), (0.5, 0.3), (0.500001, 2.0))
CLUTTER = rv.scenarios.get("clutter-8")
SLOW = {"max_speed": 1.0, "time_step": 0.05, "allow_long_step": True, "time_limit": 60.0}


def planner(scenario):
    return baselines.make(NAME, scenario)


def clean(found):
    return found.success & ~found.contacts.any(axis=(0, 2))


def shortest(roadmap, here, there):
    """Length of the shortest path between two points, m."""
    here, there = np.atleast_2d(here), np.atleast_2d(there)
    return roadmap.distances(here, roadmap.to_corners(here)[0], there)[0, 0]


def round_a_ball():
    """Length of the tangents and the arc round a unit ball with a clearance of 0.1 m.

    The end points are 3 m away on opposite sides.
    """
    angle = math.acos(1.1 / 3)
    return 2 * math.sqrt(9 - 1.1**2) + 1.1 * (math.pi - 2 * angle)


class TestWays:
    def test_path_around_box_matches_hand_computation(self):
        roadmap = Roadmap(pack([BOX], 1), 0.1)
        here, there = np.array([-2.0, 0.5]), np.array([2.0, 0.5])
        expected = 2 * math.hypot(1.4, 1.6) + 1.2  # over (∓0.6, 2.1)
        assert shortest(roadmap, here, there) == pytest.approx(expected)
        way = PathsTo(roadmap, there).way(here)
        np.testing.assert_allclose(way, [(-0.6, 2.1), (0.6, 2.1), (2.0, 0.5)])
        assert np.isinf(roadmap.straight(here[None], there[None])).all()
        free = Roadmap(pack([], 0), 0.1)
        assert shortest(free, [1.0, 1.0], [3.0, 4.0]) == math.hypot(2, 3)
        assert PathsTo(free, there).way(here).tolist() == [[2.0, 0.5]]

    @pytest.mark.parametrize("round_one", [Disc((0, 0), 1), Capsule(((0, 0), (0, 1e-3)), 1)])
    def test_path_around_disc_is_nearly_optimal(self, round_one):
        found = shortest(Roadmap(pack([round_one], 1), 0.1), [-3.0, 0.0], [3.0, 0.0])
        assert round_a_ball() <= found * (1 + 1e-3) and found < 1.01 * round_a_ball()

    @pytest.mark.parametrize(
        "round_one", [Sphere((0, 0, 0), 1), Capsule(((0, 0, 0), (0, 1e-3, 0)), 1)]
    )
    def test_path_around_ball_is_nearly_optimal(self, round_one):
        roadmap = Roadmap(pack([round_one], 1), 0.1, dim=3)
        for here in np.random.default_rng(0).normal(size=(20, 3)):
            here *= 3 / np.linalg.norm(here)
            found = shortest(roadmap, here, -here)
            assert round_a_ball() <= found < 1.15 * round_a_ball()
            turns = np.array([here, *PathsTo(roadmap, -here).way(here)])
            along = np.linspace(turns[:-1], turns[1:], 200)
            assert np.linalg.norm(along, axis=-1).min() >= 1.09 - 1e-3
            assert np.linalg.norm(np.diff(turns, axis=0), axis=-1).sum() == pytest.approx(found)

    def test_polygons_are_simplified_within_clearance(self):
        """A roadmap connects all corners: 49 such polygons took hours for ten thousand."""
        around = 2 * np.pi * np.arange(200) / 200
        ring = np.stack([np.cos(around), np.sin(around)], axis=-1)
        roadmap = Roadmap(pack([Polygon(ring + np.array([3 * k, 0.0])) for k in range(8)], 8), 0.1)
        assert 8 * 8 <= len(roadmap.corners) <= 8 * 20
        off = np.linalg.norm(roadmap.corners[:, None] - [(3 * k, 0) for k in range(8)], axis=-1)
        assert (off.min(axis=1) >= 1.1 - 1e-3).all() and (off.min(axis=1) <= 1.2).all()
        assert 25.0 < shortest(roadmap, [-2.0, 0.0], [23.0, 0.0]) < 25.8

    def test_too_many_corners_are_rejected(self):
        discs = [Disc((3.0 * k, 0.0), 1.0) for k in range(300)]
        with pytest.raises(ValueError, match="4800 corners; the planner supports at most 4000"):
            Roadmap(pack(discs, 300), 0.1)

    def test_pointed_obstacle_blocks_beyond_bounding_ball(self):
        """An enlarged corner is pointed, and paths must respect all of it."""
        needle = Polygon(((0.0, -0.05), (4.0, 0.0), (0.0, 0.05)))
        roadmap = Roadmap(pack([needle], 1), 0.1)
        straight = roadmap.straight(np.array([[4.5, -1.0], [19.5, -1.0]]), np.array([[4.5, 1.0]]))
        assert np.isinf(straight[0, 0]) and np.isfinite(straight[1, 0])

    def test_meeting_place_is_nearly_optimal(self):
        random = np.random.default_rng(3)
        roadmap = Roadmap(pack([BOX, Disc((2, 2), 1)], 2), 0.1)
        team = np.array([[-2.0, 0.0], [2.0, 0.0], [2.0, 4.0], [-1.0, -3.0]])
        to_corners, _ = roadmap.to_corners(team)
        meeting = meeting_place(roadmap, team)
        chosen = roadmap.distances(team, to_corners, meeting.place[None]).max()
        others = roadmap.distances(team, to_corners, random.uniform(-4, 5, (3000, 2)))
        assert meeting.left_out == 0
        assert chosen <= 1.03 * others.max(axis=0).min()


class TestItPasses:
    @pytest.mark.parametrize(
        ("name", "starts", "fails"),
        [
            ("trap", 40, "tangent-merged-tuned"), ("clutter-3d-96", 2, ""),
            *(slow(name, 40, "tangent-merged-tuned")
              for name in ("corridor", "rooms", "clutter-32")),
            slow("clutter-3d-32", 10, ""), slow("slab-3d", 20, "bearing-only"),
            slow("bowl-3d", 10, ""), slow("window-3d", 10, ""), slow("uav-clutter-16", 3, ""),
            slow("unicycle-clutter-24-slower", 20, ""), slow("unicycle-rooms", 20, ""),
        ],
    )  # fmt: skip
    def test_planner_solves_every_scenario(self, name, starts, fails):
        """Includes scenarios in which law (4) fails."""
        scenario = rv.scenarios.get(name)
        for policy in (NAME, fails) if fails else (NAME,):
            law = baselines.make(policy, scenario)
            passed = clean(rv.rollout(scenario, law, 2000, num_envs=starts))
            assert passed.all() if policy == NAME else passed.mean() <= 0.8

    @pytest.mark.nightly
    @pytest.mark.parametrize("name", ["clutter-3d-32", "slab-3d", "bowl-3d", "uav-clutter-16"])
    def test_planner_solves_99_percent_of_initial_conditions(self, name):
        scenario = rv.scenarios.get(name)
        found = rv.rollout(scenario, planner(scenario), 1_000_000, num_envs=100)
        assert clean(found).mean() >= 0.99

    @pytest.mark.slow
    def test_planner_is_collision_free_within_speed_limit(self):
        found = rv.rollout(CLUTTER, planner(CLUTTER), 0, num_envs=50, record="actions")
        assert clean(found).mean() >= 0.99
        assert np.linalg.norm(found.actions, axis=-1).max() <= 1.0 + 1e-6
        steps = np.diff(found.positions, axis=0)[:, found.success]
        kept = found.active[1:, found.success] & found.active[:-1, found.success]
        merging = (found.active[1:] != found.active[:-1]).any(axis=-1)[:, found.success]
        assert np.linalg.norm(steps, axis=-1)[kept & ~merging[..., None]].max() <= 0.05 + 1e-6

    @pytest.mark.parametrize(
        ("scenario", "seed", "starts"),
        [
            (Scenario(n_robots=5, obstacles=(BOX, Disc((3, 3), 1), BAR), spawn_size=12.0, **SLOW),
             3, 40),
            (CLUTTER.replace(graph="cycle", n_robots=6, neighbour_slots=5), 3, 10),
            # the midpoint of two robots that go round a corner is nearer to it than they were
            (rv.scenarios.get("trap"), 1147, 1),
            (Scenario(n_robots=3, obstacles=(BOX,), start_positions=AT_A_SURFACE, **SLOW), 0, 1),
        ],
        ids=["every kind of obstacle", "a ring", "a merge beside a corner", "from a surface"],
    )  # fmt: skip
    def test_planner_is_collision_free(self, scenario, seed, starts):
        assert clean(rv.rollout(scenario, planner(scenario), seed, num_envs=starts)).all()

    @pytest.mark.kernels
    def test_two_robots_meet_in_minimum_time(self):
        scenario = Scenario(n_robots=2, start_positions=((-2, 0), (2, 0)), **SLOW)
        found = rv.rollout(scenario, planner(scenario))
        assert found.rendezvous_time[0] == pytest.approx((4.0 - 0.2) / 2, abs=0.051)

    def test_enclosed_robot_stays_and_others_meet(self):
        wall = [((-2, -2), (2, -2)), ((2, -2), (2, 2)), ((2, 2), (-2, 2)), ((-2, 2), (-2, -2))]
        scenario = Scenario(
            n_robots=3,
            obstacles=tuple(Capsule(ends, 0.2) for ends in wall),
            start_positions=((0, 0), (-5, 0), (5, 0)),
            **SLOW | {"time_limit": 20.0},
        )
        found = rv.rollout(scenario, planner(scenario))
        assert not found.success[0] and not found.contacts.any()
        assert found.active[-1, 0].tolist() == [True, True, False]
        assert found.positions[-1, 0, 0].tolist() == [0, 0]


class TestItWatches:
    def test_planner_rejects_other_observations(self):
        policy, simulator = planner(CLUTTER), Simulator(CLUTTER, 2)
        seen = simulator.reset(0)
        policy.watch(simulator)
        assert policy(seen, simulator.time).shape == (2, 4, 2)
        with pytest.raises(ValueError, match=r"watches have shape .* must be \(2, 4, 19, 2\)$"):
            policy(seen[:1], 0.0)
        with pytest.raises(ValueError, match="observations have shape"):
            policy(np.zeros((2, 4, 3, 2)), 0.0)
        with pytest.raises(ValueError, match="mask"):
            policy.reset(np.ones(3, bool))

    def test_next_episode_is_replanned(self):
        scenario = rv.scenarios.get("rooms")
        simulator, policy = Simulator(scenario, 3), planner(scenario)
        seen = simulator.reset(5)
        policy.watch(simulator)
        for _ in range(2):
            while not simulator.ended.all():
                seen = simulator.step(policy(seen, simulator.time)).observations
            assert (simulator.contacts == 0).all() and (simulator.active.sum(axis=1) == 1).all()
            seen = simulator.reset()
