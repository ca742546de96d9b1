"""Large sparse graphs as lists of links: equal motion, memory proportional to the links."""

import numpy as np
import pytest
from conftest import assert_same_state, refusing, started, unequal_matrix
from geometry import along
from parameters import marked
from test_changing_graphs import ARCS

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, graphs
from rendezvous_env.compilation import compiled
from rendezvous_env.engine import memory_layout

SEED = 4
RING = Scenario(n_robots=60, graph="cycle", spawn_size=12.0)
WEB = Scenario(
    n_robots=60,
    graph=unequal_matrix(60, seed=1, share=0.035),
    spawn_size=12.0,
    merge_radius=0.4,
    time_step=0.02,
    allow_long_step=True,
    max_speed=4.0,
)
ERRORS = "errors among obstacles"
FAST = {
    "ring": RING,
    "web": WEB,
    ERRORS: RING.replace(
        obstacles=[rv.Disc((1.0, 1.0), 0.8), rv.Capsule(((-3.0, -0.5), (-3.0, 0.5)), 1.0)],
        neighbour_slots=59,
        sensing=rv.Sensing(noise=0.1, dropout=0.2, occlusion="both"),
    ),
    "measured": RING.replace(
        neighbour_slots=59,
        sensing=rv.Sensing(
            min_range=0.5,
            detection=((0.5, 1.0), (9.0, 0.3)),
            persistence=1.0,
            outliers=0.1,
            noise=tuple(0.01 * robot for robot in range(60)),
            noise_correlation=1.0,
            observer_bias=0.1,
            sample_period=0.05,
            outlier_kind="robot",
        ),
    ),
    "drawn weights": RING.replace(graph=graphs.path((0.5, 2.0))),
    "tree": RING.replace(
        graph=graphs.random_tree(), max_speed=3.0, time_step=0.02, allow_long_step=True
    ),
}
SLOW = {
    "web with 40 rows": WEB.replace(neighbour_slots=40),
    "ring in space": RING.replace(dim=3),
    "unicycles": RING.replace(robot_model="unicycle"),
}
"""Covered by the other cases, except for compilation."""


def simulators(scenario: Scenario, batch: int, monkeypatch) -> tuple[Simulator, Simulator]:
    """A simulator with lists of links, and one with all pairs."""
    lists = Simulator(scenario, batch)
    with monkeypatch.context() as patch:
        patch.setattr(memory_layout, "_SPARSE_FROM", 10**9)
        pairs = Simulator(scenario, batch)
    assert "first" in lists.get_state() and "first" not in pairs.get_state()
    return lists, pairs


@pytest.mark.parametrize(
    "name",
    marked([*FAST, *SLOW], slow=[ERRORS, *SLOW], kernels=[ERRORS, "web", "web with 40 rows"]),
)
def test_edge_lists_match_dense_pairs(name, monkeypatch):
    scenario = (FAST | SLOW)[name]
    lists, pairs = simulators(scenario, 5, monkeypatch)
    observations = lists.reset(SEED)
    layout = scenario.observation_layout
    seen = pairs.reset(SEED)
    np.testing.assert_array_equal(lists.weights, pairs.weights)
    for _ in range(150 if compiled() else 5):  # plain Python is a thousand times as slow
        mine, theirs = (rows[..., layout.neighbours, :] for rows in (observations, seen))
        there = mine.any(axis=-1)
        np.testing.assert_array_equal(mine[there], theirs[theirs.any(axis=-1)])
        assert (there[..., :-1] >= there[..., 1:]).all()  # those that are seen stand first
        np.testing.assert_array_equal(
            observations[..., layout.obstacles, :], seen[..., layout.obstacles, :]
        )
        np.testing.assert_array_equal(lists.lyapunov(), pairs.lyapunov())
        mine, theirs = (
            sim.step(layout.net_bearing(rows))  # for unicycles as speed and turn rate
            for sim, rows in ((lists, observations), (pairs, seen))
        )
        observations, seen = mine.observations, theirs.observations
        np.testing.assert_allclose(lists.positions, pairs.positions, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(lists.merged_into, pairs.merged_into)
        np.testing.assert_array_equal(mine.contact, theirs.contact)
        np.testing.assert_array_equal(mine.active, theirs.active)
        for score in ("rewards", "lyapunov_before_merge", "lyapunov_after_merge", "merge_excess"):
            np.testing.assert_allclose(getattr(mine, score), getattr(theirs, score), atol=1e-9)
    np.testing.assert_array_equal(lists.weights, pairs.weights)
    np.testing.assert_allclose(lists.path_length, pairs.path_length, rtol=1e-12)
    assert lists.active.mean() <= 100 / 120 or not compiled()


@pytest.mark.kernels
@pytest.mark.parametrize(
    "graph", [graphs.erdos_renyi(0.05), graphs.erdos_renyi(0.01, (0.5, 2.0)), graphs.random_tree()]
)
def test_random_graphs_match_dense_sampling(graph, monkeypatch):
    """With 0.05 most graphs are connected; with 0.01 none is, so a tree is added."""
    lists, pairs = simulators(Scenario(n_robots=80, graph=graph), 3, monkeypatch)
    for seed in (SEED, None):
        lists.reset(seed), pairs.reset(seed)
        weights = lists.weights
        np.testing.assert_array_equal(weights, pairs.weights)
        np.testing.assert_array_equal(lists.positions, pairs.positions)
        assert len({team.tobytes() for team in weights}) == 3
        assert all(len(graphs.components(team)) == 1 for team in weights)


@pytest.mark.kernels
@pytest.mark.parametrize("sparse", [False, True])
def test_crowded_robot_is_named(sparse):
    """Double star: after its two centres merge, robot 0 has the neighbours of both."""
    n = 60 if sparse else 8
    links = [(0, 1)] + [(k % 2, k) for k in range(2, n)]
    star = graphs.from_edges(links)
    scenario = Scenario(n_robots=n, graph=star, neighbour_slots=n // 2, local_frames="global")
    sim = Simulator(scenario)
    assert ("first" in sim.get_state()) == sparse
    positions, r = 9.0 * along(*360 / n * np.arange(n)), scenario.merge_radius
    positions[:2] = [[-0.55 * r, 0.0], [0.55 * r, 0.0]]
    sim.reset(0, {"positions": positions})
    actions = np.zeros((1, n, 2))
    sim.step(actions)
    actions[0, 0, 0] = scenario.speed_limit
    message = (
        rf"robot_0 of environment 0 has more than neighbour_slots = {n // 2} neighbours after step"
    )
    with pytest.raises(RuntimeError, match=message):
        for _ in range(100):
            sim.step(actions)
    steps = sim.steps[0]
    with pytest.raises(RuntimeError, match=f"after step {steps}; give the scenario more"):
        sim.observe()


@pytest.mark.kernels
def test_crowded_initial_condition_is_rejected():
    """A random graph, a directed one, and the star of the next episode after a path."""
    for robot, graph, slots in (("\\d", graphs.erdos_renyi(0.9), 1), (2, graphs.directed(ARCS), 2)):
        seen = Scenario(n_robots=5, graph=graph, neighbour_slots=slots)
        with pytest.raises(
            RuntimeError, match=rf"robot_{robot} of environment 0 has more .*{slots} .* 0"
        ):
            started(seen, 2)
    path = graphs.path().base_weights(4)
    star = Scenario(n_robots=4, graph="star", neighbour_slots=2, spawn_size=30.0)
    sim = started(star, weights=path)
    outcome = sim.step(np.zeros((1, 4, 2)))
    with pytest.raises(
        RuntimeError, match="robot_0 of environment 0 has more than neighbour_slots = 2"
    ):
        sim.restart(np.ones(1, bool), outcome)
    sim.reset(0, {"weights": path})  # and nothing of the refusal is left
    assert sim.step(np.zeros((1, 4, 2))).active.all()


@pytest.mark.kernels
def test_thousand_robots_run_in_every_form():
    scenario = Scenario(n_robots=1000, graph="cycle", spawn_size=300.0, time_limit=1.0)
    venv, env = rv.make_vec(scenario, 2), rv.parallel_env(scenario)
    (seen, _), (alone, _), sim = venv.reset(seed=0), env.reset(seed=0), venv.unwrapped.simulator
    falling = [sim.lyapunov()]
    for _ in range(4):
        np.testing.assert_array_equal(np.stack([alone[a] for a in env.agents]), seen[0])
        actions = scenario.observation_layout.net_bearing(seen).astype(np.float32)
        seen, *_ = venv.step(actions)
        alone, *_ = env.step(dict(zip(env.agents, actions[0], strict=True)))
        assert len(env.agents) == 1000
        falling.append(sim.lyapunov())
    assert (np.diff(falling, axis=0) < 0).all()
    assert sim.nbytes < 2 * 1000 * 200  # of a team; a table of weights alone would be 8 MB
    played = rv.rollout(scenario, baselines.make("bearing-only", scenario))
    assert played.positions.shape[-3:] == (1, 1000, 2)


@pytest.mark.kernels
@pytest.mark.parametrize("n", [6, 60])
def test_crowded_state_is_rejected(n):
    ring, star = (Scenario(n_robots=n, graph=kind) for kind in ("cycle", "star"))
    roomy = ring.replace(neighbour_slots=n - 1)
    started(ring, 2).set_state(started(roomy, 2).get_state())
    slim = Simulator(star.replace(neighbour_slots=3), 2)
    with refusing(slim, f"robot_0 of environment 0 {n - 1} neighbours; .* = 3"):
        slim.set_state(started(star, 2).get_state())


@pytest.mark.kernels
def test_given_weights_are_used():
    n = 60
    scenario = RING.replace(graph=graphs.cycle((0.5, 2.0)))
    ring, path = (graph.base_weights(n) for graph in (graphs.cycle(), graphs.path()))
    sim = started(scenario, 2, weights=np.stack([ring, path]))
    np.testing.assert_array_equal(sim.weights, [ring, path])
    shuffled = np.random.default_rng(0).permutation(n)
    sim.reset(0, {"weights": ring[np.ix_(shuffled, shuffled)]}, mask=np.array([False, True]))
    np.testing.assert_array_equal(sim.weights, [ring, ring[np.ix_(shuffled, shuffled)]])
    sim.set_state(sim.get_state())
    sim.reset()
    assert ((sim.weights > 0) == (ring > 0)).all() and sim.weights.max() > 1.0


@pytest.mark.kernels
def test_given_weights_beyond_capacity_change_nothing():
    scenario = Scenario(n_robots=80, graph=graphs.erdos_renyi(0.05))
    sim = started(scenario, seed=3)
    everybody = np.ones((80, 80)) - np.eye(80)
    with refusing(sim, r"weights have 3160 links; .* have memory for 361"):
        sim.reset(None, {"weights": everybody})
    small = Simulator(Scenario(n_robots=6, neighbour_slots=4))
    with pytest.raises(ValueError, match=r"robot_0 5 neighbours; .* neighbour_slots = 4"):
        small.reset(0, {"weights": everybody[:6, :6]})


@pytest.mark.parametrize("n", [5, 60])
def test_weights_of_masked_environments_change_nothing(n):
    sim = started(Scenario(n_robots=n, graph="cycle"), 3)
    before, ring = sim.get_state(), sim.weights
    sim.reset(options={"weights": ring}, mask=np.zeros(3, bool))
    assert_same_state(sim, before)
