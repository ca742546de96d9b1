"""Robots with bodies: no overlap, and rendezvous as one packed cluster."""

import itertools

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env.physics.packing import is_packed, move_apart


def distances(positions):
    pairs = np.triu_indices(positions.shape[-2], 1)
    return np.linalg.norm(positions[..., pairs[0], :] - positions[..., pairs[1], :], axis=-1)


def on_arcs(lengths, yaws, turns, share):
    """Displacements (n, 2) after a share of arcs of lengths (n,), m, and turns (n,), rad."""
    mean = yaws + 0.5 * share * turns
    chord = share * lengths * np.sinc(0.5 * share * turns / np.pi)
    return chord[:, None] * np.stack([np.cos(mean), np.sin(mean)], axis=-1)


@pytest.mark.kernels
class TestMoving:
    @pytest.mark.parametrize(
        ("wanted", "ways"),
        [
            ([(0.5, 0.1), (-0.5, 0.2)], [(0.2, 0.1), (-0.2, 0.2)]),  # each takes half of the gap
            ([(0.1, 0.3), (-0.1, 0.0)], [(0.1, 0.3), (-0.1, 0.0)]),  # whoever is far is free
        ],
    )
    def test_two_bodies_match_hand_computation(self, wanted, ways):
        places, moved = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array(wanted)
        lengths = np.linalg.norm(moved, axis=1)
        move_apart(places, moved, lengths, 0.6, (np.zeros((2, 2)), np.zeros(1)))
        np.testing.assert_allclose(moved, ways, atol=1e-8)
        np.testing.assert_allclose(places, np.add([(0, 0), (1, 0)], ways), atol=1e-8)
        np.testing.assert_allclose(lengths, np.linalg.norm(ways, axis=1), atol=1e-8)

    def test_curved_path_near_another_body_becomes_straight(self):
        """The first disc keeps its quarter circle, whose length fits in the gap; the second not."""
        for gap, kept in ((2.0, True), (0.9, False)):
            places, moved = np.array([[0.0, 0.0], [0.6 + gap, 0.0]]), np.array([[0.5, 0.5], [0, 0]])
            lengths = np.array([0.25 * np.pi, 0.0])
            move_apart(places, moved, lengths, 0.6, (np.zeros((2, 2)), np.zeros(1)))
            expected = [0.5, 0.5] if kept else [0.45, 0.5]
            np.testing.assert_allclose(moved[0], expected, atol=1e-8)
            length = 0.25 * np.pi if kept else np.hypot(0.45, 0.5)
            assert lengths[0] == pytest.approx(length, abs=1e-8)

    def test_bodies_on_arcs_never_overlap(self):
        random, size, n = np.random.default_rng(7), 0.3, 6
        places, straight = 0.4 * np.array(list(itertools.product(range(3), range(2))), float), 0
        for _ in range(300):
            before, lengths = places.copy(), random.uniform(0.0, 0.3, n)
            yaws, turns = random.uniform(-3.0, 3.0, n), random.uniform(-3.0, 3.0, n)
            yaws[:] = np.where(random.random(n) < 0.5, yaws, np.arctan2(*-places.T[::-1]))
            ways = on_arcs(lengths, yaws, turns, 1.0)
            given = lengths.copy()
            move_apart(places, ways, lengths, size, (np.zeros((n, 2)), np.zeros(n)))
            curved = lengths == given
            straight += np.count_nonzero(~curved)
            for share in np.linspace(0.1, 1.0, 10):
                arcs = on_arcs(given, yaws, turns, share)
                now = before + np.where(curved[:, None], arcs, share * ways)
                assert distances(now).min() >= size * (1.0 - 1e-12)
        assert 300 < straight < 1500  # of 1,800

    @pytest.mark.parametrize("n", [2, 5, 20])
    def test_bodies_never_overlap(self, n):
        """Also along the path: smallest distance of two straight paths in one step."""
        random, size = np.random.default_rng(n), 0.3
        places = 0.35 * np.array(list(itertools.product(range(5), range(4))), float)[:n]
        for _ in range(200):
            before, ways = places.copy(), random.normal(0.0, 0.2, (n, 2)) - 0.1 * places
            move_apart(places, ways, np.zeros(n), size, (np.zeros((n, 2)), np.zeros(n)))
            for share in (0.25, 0.5, 0.75, 1.0):
                assert distances(before + share * ways).min() >= size * (1.0 - 1e-12)


@pytest.mark.parametrize(
    ("places", "is_so"),
    [
        ([(0, 0), (1, 0)], True),
        ([(0, 0), (1.2, 0)], False),
        ([(0, 0), (1, 0), (2, 0)], False),  # the ends touch a single one
        ([(0, 0), (1, 0), (0.5, 0.87)], True),
        ([(0, 0), (1, 0), (0, 1), (1, 1)], True),
        ([(0, 0), (1, 0), (0.5, 0.87), (9, 0), (10, 0), (9.5, 0.87)], False),  # two clusters
    ],
)
def test_is_packed_detects_clusters(places, is_so):
    work = np.zeros(len(places), np.int64), np.zeros(len(places), np.bool_)
    assert is_packed(np.array(places, float), 1.05, work) is is_so


class TestEpisodes:
    @pytest.mark.parametrize("n", [4, 10])
    def test_packing_reaches_cluster_without_merge_or_overlap(self, n):
        scenario = rv.scenarios.get(f"robotarium-{n}")
        found = rv.rollout(scenario, baselines.make("bearing-only", scenario), num_envs=40)
        assert found.success.all() and found.active.all()
        apart = distances(found.positions)
        assert apart[0].min() > scenario.merge_radius >= apart[-1].min()
        assert apart.min() >= 0.15 - 1e-9 and apart[-1].max() < {4: 0.31, 10: 0.9}[n]
        moved = np.linalg.norm(np.diff(found.positions, axis=0), axis=-1)
        assert moved.max() <= 0.2 * 0.033 + 1e-9

    @pytest.mark.slow
    def test_unicycles_pack_alike_in_any_batch(self):
        scenario = rv.scenarios.get("utias-5-pack").replace(time_limit=400.0)
        policy = baselines.make("search-and-pursue", scenario)
        found = rv.rollout(scenario, policy, seed=0, num_envs=8)
        assert found.success.sum() >= 5 and found.active.all()
        assert distances(found.positions).min() >= 0.34 * (1 - 1e-9)
        last = found.positions[-1, found.success]
        apart = np.linalg.norm(last[:, :, None] - last[:, None], axis=-1)
        assert ((apart <= 0.35).sum(axis=-1) >= 3).all()  # itself and two others
        alone = rv.rollout(scenario, policy, seed=3)
        steps = len(alone.positions)
        np.testing.assert_array_equal(alone.positions[:, 0], found.positions[:steps, 3])
        said = rv.certificate(scenario).theorem
        assert "bodies never overlap under any policy" in said

    @pytest.mark.parametrize("batch", [1, 6])  # a team alone, and lanes side by side
    def test_touched_robots_are_hidden_unless_all_touch(self, batch):
        """Visibility by row: robot 0 touches 1, which touches 0 and 2; robot 3 is separate."""
        four = rv.scenarios.get("robotarium-4").replace(local_frames="global")
        places = ((0.0, 0.0), (0.155, 0.0), (0.31, 0.0), (0.0, 1.0))
        for n, expected in (
            (4, [[0, 1, 1], [0, 0, 1], [1, 0, 1], [1, 1, 1]]),
            (3, [[0, 1], [1, 1], [1, 0]]),
        ):
            row = four.replace(n_robots=n, start_positions=places[:n])
            seen = rv.Simulator(row, num_envs=batch).reset(0)
            np.testing.assert_array_equal(seen.any(axis=-1), [expected] * batch)
            if n == 4:
                to_others = np.array([(1, 0), (0, 1)]) / 15
                np.testing.assert_allclose(seen[0, 0, 1:], to_others, rtol=1e-6)

    def test_bodies_occlude_each_other(self):
        """In a row of three, a body of 0.1 m hides the outer robots from each other."""
        row = ((-1.0, 0.05), (0.0, 0.0), (1.0, 0.05))
        scenario = rv.Scenario(
            n_robots=3, start_positions=row, merge_radius=0.2, local_frames="global",
            sensing=rv.Sensing(occlusion="robots"),
        )  # fmt: skip
        for radius, hidden in ((0.1, True), (0.04, False)):
            seen = rv.Simulator(scenario.replace(body_radius=radius)).reset(0)
            assert (not seen[0, 0, 1].any()) == hidden


BODIES = {"body_radius": 0.1}
PACK = BODIES | {"meeting": "pack"}


class TestScenario:
    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({"body_radius": 0.2}, r"body_radius is 0\.2; it must be at most half the merge_rad"),
            ({"body_radius": -1.0}, "body_radius is -1.0; it must be a positive"),
            ({"meeting": "pack"}, "body_radius is None; it must be given with meeting='pack'"),
            (BODIES | {"meeting": "park"}, "meeting is 'park'; it must be one of"),
            (BODIES | {"graph": "cycle"}, "graph must be complete with a body_radius"),
            (PACK | {"dim": 3}, "robots in 3-D: bodies pack as"),
            (PACK | {"robot_model": "double_integrator"}, "'merge' for double_integrator robots"),
            (PACK | {"obstacles": (rv.Disc((9.0, 9.0), 1.0),)}, "among obstacles: bodies pack"),
            (
                BODIES | {"start_positions": [(i / 10, 0.0) for i in range(5)]},
                r"robot_\d and robot_\d are 0\.1 m apart; it must be at least 0\.2 m",
            ),
        ],
    )
    def test_invalid_bodies_are_rejected(self, fields, message):
        with pytest.raises(ValueError, match=message):
            rv.Scenario(**fields)

    @pytest.mark.parametrize("meeting", ["merge", "pack"])
    def test_overlapping_bodies_are_rejected_at_reset(self, meeting):
        scenario = rv.Scenario(n_robots=3, body_radius=0.05, meeting=meeting)
        simulator = rv.Simulator(scenario, num_envs=2)
        places = np.array([[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]] * 2)
        places[1, 2] = 1.0, 0.04
        message = r"positions: robot_1 and robot_2 are 0\.04 m apart; it must be at least 0\.1 m"
        with pytest.raises(ValueError, match=message):
            simulator.reset(0, {"positions": places})
        assert not simulator.begun
        with pytest.raises(ValueError, match=f"start_{message}"):
            scenario.replace(start_positions=places[1])
        places[1, 2] = 1.0, 0.1 * (1 - 1e-12)  # bodies that touch, as a step can leave them
        simulator.reset(0, {"positions": places})

    def test_weights_unlinking_bodies_are_rejected_at_reset(self):
        """Robots without a link would pass through each other."""
        simulator = rv.Simulator(rv.Scenario(n_robots=3, body_radius=0.1))
        path = rv.graphs.path().base_weights(3)
        with pytest.raises(ValueError, match="weights must link all robots with a body_radius"):
            simulator.reset(0, {"weights": path})
        simulator.reset(0, {"weights": 1.0 - np.eye(3)})

    def test_docking_bodies_keep_guarantees(self):
        docking = rv.Scenario(n_robots=4, body_radius=0.1)
        points = rv.certificate(rv.Scenario(n_robots=4))
        assert rv.certificate(docking).time_bound == points.time_bound
        assert rv.certificate(docking).guaranteed


def test_bodies_of_half_the_merge_radius_pack():
    radius = 0.1  # bodies stop each other at the merge radius, up to rounding
    scenario = rv.Scenario(n_robots=3, merge_radius=0.2, body_radius=radius, meeting="pack")
    for one in (scenario, scenario.replace(body_radius=0.999 * radius)):
        law = baselines.make("bearing-only", one)
        assert rv.rollout(one, law, seed=3, num_envs=8).success.mean() == 1.0
