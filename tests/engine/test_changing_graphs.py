"""Directed and changing graphs: compared with NumPy and undirected graphs, and as state.

The state can be read, restored and reset.
"""

import itertools

import numpy as np
import pytest
from conftest import UNEQUAL, started
from parameters import marked

import baselines
import rendezvous_env as rv
from rendezvous_env import graphs

ARCS = np.array(
    [
        [0.0, 1.5, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.7, 0.0, 0.0],
        [0.0, 0.4, 0.0, 1.0, 0.6],
        [0.0, 0.0, 0.0, 0.0, 2.0],
        [0.8, 0.0, 0.0, 0.0, 0.0],
    ]
)
"""Bidirectional pairs with unequal gains, and unidirectional pairs."""
TURNS = graphs.switching(["path", graphs.directed_cycle(1.5), graphs.from_edges([(0, 4)], 5)], 0.3)
RANGE, FIELD = 2.5, 4.0
SIGHT = rv.Sensing(range=RANGE, field_of_view=FIELD)
FREE = {"require_connected": False}
KINDS = {
    "directed": FREE | {"graph": graphs.directed(ARCS)},
    "switching": FREE | {"graph": TURNS},
    "proximity": FREE | {"graph": graphs.proximity(0.8), "sensing": SIGHT},
}
"""Graph types with the corresponding scenario fields."""


def scenario(**fields):
    """Five robots in a small area, with global frames."""
    usual = {"n_robots": 5, "spawn_size": 4.0, "time_limit": 8.0, "local_frames": "global"}
    return rv.Scenario(**(usual | fields))


class Reference:
    """Slow reference implementation of one team under ṗ = f.

    Groups of merged robots share a position, and every number is recomputed from the original arcs.
    """

    def __init__(self, kind, positions, radius, duration):
        self.kind, self.r, self.tau = kind, radius, duration
        self.places = {frozenset([i]): p.copy() for i, p in enumerate(positions)}
        self.steps = 0

    def base(self):
        """Arcs between the initial robots at this time."""
        if self.kind == "directed":
            return ARCS
        if self.kind == "proximity":
            return 0.8 * (1 - np.eye(5))
        turn = int(self.steps * self.tau / 0.3 + 1e-9) % 3
        return TURNS.graphs[turn].base_weights(5) * TURNS.graphs[turn].weight_range[1]

    def gain(self, a, b):
        heaviest = max(self.base()[i, j] for i in a for j in b)
        if self.kind == "proximity":
            way = self.places[b] - self.places[a]
            angle = abs(np.arctan2(way[1], way[0]))
            if np.linalg.norm(way) > RANGE or angle > FIELD / 2:
                return 0.0
        return heaviest

    def look(self):
        """Weights, f of every group by its lowest robot, and V."""
        weights, f, v = np.zeros((5, 5)), np.zeros((5, 2)), 0.0
        for a, b in itertools.permutations(self.places, 2):
            gain, way = self.gain(a, b), self.places[b] - self.places[a]
            weights[min(a), min(b)] = gain
            f[min(a)] += gain * way / np.linalg.norm(way)
            v += gain * np.linalg.norm(way)
        return weights, f, v

    def step(self, velocities):
        """Merge linked pairs that come within r, in order of time.

        Pairs within r at the end of the step merge then.
        """
        arcs, _, _ = self.look()
        linked = {
            frozenset([a, b])
            for a, b in itertools.combinations(self.places, 2)
            if arcs[min(a), min(b)] > 0 or arcs[min(b), min(a)] > 0
        }
        way = {a: self.tau * velocities[min(a)] for a in self.places}
        moving = set(self.places)
        while True:
            meetings = [(self.moment(a, b, way), a, b) for a, b in map(tuple, linked)]
            meetings = [m for m in meetings if m[0] <= 1 and m[1] in moving and m[2] in moving]
            if not meetings:
                break
            moment, a, b = min(meetings, key=lambda m: m[0])
            ends = [self.places[g] + moment * way[g] for g in (a, b)]
            linked = self.merge(a, b, ends, linked, way)
            moving -= {a, b}
        for a in moving:
            self.places[a] = self.places[a] + way[a]
        while near := [pair for pair in linked if self.apart(*pair) < self.r]:
            a, b = min(near, key=lambda pair: self.apart(*pair))
            linked = self.merge(a, b, [self.places[a], self.places[b]], linked, way)
        self.steps += 1

    def apart(self, a, b):
        return np.linalg.norm(self.places[a] - self.places[b])

    def moment(self, a, b, way):
        offset, velocity = self.places[b] - self.places[a], way[b] - way[a]
        square, slope = velocity @ velocity, offset @ velocity
        gap = offset @ offset - self.r**2
        if gap <= 0:
            return 0.0
        root = slope**2 - square * gap
        return np.inf if slope >= 0 or root < 0 else (-slope - np.sqrt(root)) / square

    def merge(self, a, b, ends, linked, way):
        """A merge unites the links of both robots; the targets of links are kept."""
        both = a | b
        del self.places[a], self.places[b]
        self.places[both] = (ends[0] + ends[1]) / 2
        way[both] = np.zeros(2)
        renamed = (frozenset(both if g in (a, b) else g for g in pair) for pair in linked)
        return {pair for pair in renamed if len(pair) == 2}


@pytest.mark.kernels
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_law_1_matches_numpy_reference(kind, seed):
    sim = rv.Simulator(scenario(**KINDS[kind]))
    rows = sim.reset(seed)
    reference = Reference(kind, sim.positions[0], sim.scenario.merge_radius, sim.scenario.tau)
    seen = []
    for _ in range(480):
        weights, f, v = reference.look()
        k = sim.scenario.observation_layout.neighbours
        np.testing.assert_allclose(rows[0, :, k].sum(axis=1), f, atol=1e-5)
        np.testing.assert_allclose(sim.weights[0], weights, rtol=1e-12)
        np.testing.assert_allclose(sim.lyapunov()[0], v, rtol=1e-9, atol=1e-12)
        for group, place in reference.places.items():
            assert all(sim.merged_into[0, i] == min(group) for i in group)
            np.testing.assert_allclose(sim.positions[0, min(group)], place, atol=1e-7)
        seen.append((set(reference.places), (weights > 0).tolist()))
        if sim.ended[0]:
            break
        actions = f.astype(np.float32)
        reference.step(actions.astype(float))
        rows = sim.step(actions[None]).observations
    assert len({len(robots) for robots, _ in seen}) >= 3, "no merges"
    changes = [a[0] == b[0] and a[1] != b[1] for a, b in itertools.pairwise(seen)]
    assert any(changes) == (kind != "directed")


STEP = {"time_step": 0.015, "allow_long_step": True, "max_speed": 3.0, "neighbour_slots": 4}
"""The same for graphs with less accurate worst cases than undirected ones."""
MATRIX = graphs.directed(UNEQUAL)
SIGHTED = rv.Sensing(noise=0.1, range=3.0, field_of_view=4.0, occlusion="robots", sectors=16)
FAR = rv.Sensing(range=1e3, noise=0.1, bias=0.05, dropout=0.1, delay=1)
BALLS = rv.ObstacleField(count=3, radius=(0.3, 0.6), region=5.0, keep_out=0.3)
DRAWN = graphs.path((0.5, 2.0))
ALIKE = {
    "arcs both ways": (UNEQUAL, MATRIX, {}),
    "those present first": (UNEQUAL, MATRIX, {"neighbour_slots": 3}),
    "a list of one": (DRAWN, graphs.switching([DRAWN], 0.3), {}),
    "far sight": (graphs.complete((0.5, 2)), graphs.proximity((0.5, 2)), {"sensing": FAR}),
    "a sensor": (UNEQUAL, graphs.switching([MATRIX], 0.3), {"sensing": SIGHTED}),
    "a sensor, those present first": (
        *(UNEQUAL, graphs.switching([MATRIX], 0.3)),
        {"sensing": SIGHTED, "neighbour_slots": 3},
    ),
    # the first ray of a silhouette stands on f
    "space": (UNEQUAL, MATRIX, {"dim": 3, "obstacles": BALLS}),
}
"""Equivalent definitions of undirected graphs with the corresponding scenario fields."""


@pytest.mark.parametrize("name", marked(ALIKE, slow=["space", "a sensor, those present first"]))
def test_undirected_graph_in_any_form_moves_alike(name):
    *both, fields = ALIKE[name]
    teams = [scenario(graph=graph, **STEP | fields) for graph in both]
    one, other = (
        rv.rollout(team, baselines.make("bearing-only", team), seed=3, num_envs=2, record="all")
        for team in teams
    )
    for field in ("positions", "active", "lyapunov", "lyapunov_after_merge", "rewards", "actions"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), err_msg=field)
    assert one.active[-1].sum() < 10, "no merges"


def test_directed_visibility_merges_both_robots():
    graph, places = graphs.directed([(1, 0)], 2), ((0, 0), (1, 0))
    made = scenario(n_robots=2, graph=graph, start_positions=places)
    found = rv.rollout(made, lambda seen, time: seen[:, :, 0], record="observations")
    assert found.observations[0, 0].tolist() == [[[0.0, 0.0]], [[-1.0, 0.0]]]
    assert found.lyapunov[0] == pytest.approx(1.0), "an arc counts once"
    assert found.active[-1, 0].tolist() == [True, False]
    # robot 0 never moved; they met at a distance r, and stand in the middle
    assert found.positions[-1, 0, :, 0] == pytest.approx(made.merge_radius / 2)
    assert found.rendezvous_time == pytest.approx(0.8, abs=made.tau)


@pytest.mark.parametrize("graph", ["proximity", "complete"])
def test_range_boundary_is_mutual(graph):
    """For any orientation of the frames: 3² + 4² = 5² rounds only in rotated frames."""
    near_and_far = ((0.0, 0.0), (3.0, 4.0), (1.0, 1.0))
    made = scenario(
        n_robots=3, graph=graph, sensing=rv.Sensing(range=5.0), start_positions=near_and_far,
        local_frames="random",
    )  # fmt: skip
    sim = rv.Simulator(made, 100)
    assert sim.reset(0)[:, :, :2].any(axis=-1).all()
    there = np.broadcast_to(~np.eye(3, dtype=bool), (100, 3, 3))
    np.testing.assert_array_equal(sim.weights > 0, there)


def graph_of_each_step(order, seed=0, steps=60):
    listed = [graphs.from_edges([(0, j)], 4) for j in (1, 2, 3)]
    turns = graphs.switching(listed, 0.5, order)
    made = scenario(n_robots=4, graph=turns, time_step=0.1, max_speed=1.0)
    sim, found = started(made, 3, seed), []
    for _ in range(steps):
        found.append(np.argmax(sim.weights[:, 0], axis=1))
        sim.step(np.zeros((3, 4, 2), np.float32))
    return np.array(found)


def test_switching_graphs_follow_order():
    found = graph_of_each_step("cyclic")
    for team in range(3):
        np.testing.assert_array_equal(found[:, team], np.repeat([1, 2, 3] * 4, 5))


def test_switches_occur_at_multiples_of_dwell_time():
    """Times are 0.3, 0.5, 0.8, 1 s; a delay does not accumulate to 0.3, 0.6, 0.9 s."""
    turns = graphs.switching(["path", graphs.from_edges([(1, 2)])], 0.25)
    places, long = ((0, 0), (100, 0), (0, 100)), {"time_step": 0.1, "allow_long_step": True}
    sim = started(scenario(n_robots=3, graph=turns, start_positions=places, **long))
    linked = [sim.step(np.zeros((1, 3, 2))) and sim.weights[0, 0, 1] > 0 for _ in range(10)]
    assert (np.flatnonzero(np.diff(linked)) + 2).tolist() == [3, 5, 8, 10]


def test_random_switching_is_per_environment_and_reproducible():
    found = graph_of_each_step("random", steps=400)
    blocks = found.reshape(80, 5, 3)
    assert (blocks == blocks[:, :1]).all(), "one holds for its dwell time"
    assert not np.array_equal(found[:, 0], found[:, 1])
    counts = np.bincount(blocks[:, 0].reshape(-1), minlength=4)
    assert counts[0] == 0 and (abs(counts[1:] / 240 - 1 / 3) < 0.12).all()
    np.testing.assert_array_equal(found[:, 1:], graph_of_each_step("random", 1, 400)[:, :2])


def test_progress_is_zero_without_initial_edges():
    turns, places = graphs.switching([np.zeros((3, 3)), "complete"], 0.5), ((0, 0), (1, 0), (0, 1))
    made = scenario(n_robots=3, graph=turns, start_positions=places)
    found = rv.rollout(made, lambda seen, time: seen.sum(axis=2))
    assert found.lyapunov[0] == 0.0 and found.success.all()
    passed, reward = found.times[-1] / made.time_limit, made.reward
    earned = reward.rendezvous_bonus - reward.time_penalty * passed
    assert found.rewards.sum() == pytest.approx(earned, abs=1e-6)


def test_proximity_starts_are_connected_after_merges():
    made = scenario(n_robots=6, graph="proximity", sensing=rv.Sensing(range=2.0), spawn_size=5.0)
    assert made.start_reach == pytest.approx(1.5)
    for required in (True, False):
        sim = started(made.replace(require_connected=required), 40)
        gaps = np.linalg.norm(sim.positions[:, :, None] - sim.positions[:, None], axis=-1)
        assert (np.linalg.matrix_power((gaps <= 1.5).astype(int), 6) > 0).all() == required
        assert gaps[gaps > 0].min() >= 2 * made.merge_radius or not required
    with pytest.raises(RuntimeError, match=r"links of at most .* = 1\.5 m.*spawn_size smaller"):
        rv.Simulator(made.replace(spawn_size=200.0)).reset(0)


@pytest.mark.kernels
def test_directed_cycle_weights_are_sampled_or_given():
    graph = graphs.directed_cycle((0.5, 2.0))
    sim = started(scenario(graph=graph), 3)
    first = sim.weights
    there = np.broadcast_to(graph.base_weights(5) > 0, first.shape)
    np.testing.assert_array_equal(first > 0, there)
    assert len(np.unique(first[there])) == 15 and 0.5 <= first[there].min() <= first.max() <= 2.0
    sim.reset()
    assert not np.any((first == sim.weights) & there)
    given = 1.25 * graph.base_weights(5)
    sim.reset(options={"weights": given})
    np.testing.assert_array_equal(sim.weights, np.tile(given, (3, 1, 1)))
