"""Imperfect sensors: compared with NumPy and SciPy, in a step, and as state.

Many environments are observed at a time, since each kind of environment that is stepped has to be
compiled first.
"""

import itertools
import math

import numpy as np
import pytest
from conftest import UNEQUAL, actions_shape, started
from geometry import along, triple, world
from parameters import slow
from scipy import stats

import rendezvous_env as rv
from rendezvous_env.physics.worst_bias import outward_directions
from rendezvous_env.sensors.imperfections import (
    is_hidden_by_obstacles,
    is_hidden_by_robot,
    turned_towards,
)

SHAPES = (
    rv.Disc((0.3, 0.2), 0.5),
    rv.Polygon(((-1.5, -0.5), (-0.7, -0.8), (-0.9, 0.4))),
    rv.Capsule(((0.5, -1.2), (1.6, -0.6)), 0.25),
)
PLANE = rv.Scenario(n_robots=5, graph=rv.graphs.complete(0.7))
SPACE = PLANE.replace(
    dim=3,
    robot_model="nonholonomic_3d",
    obstacles=(rv.Sphere((0.3, 0.2, 0.0), 0.8),),
    obstacle_range=6.0,
)
WALLED = PLANE.replace(obstacles=SHAPES, spawn_size=5.0, obstacle_range=6.0, merge_radius=0.3)
RING = rv.Scenario(n_robots=6, graph="cycle")
OTHERS = ~np.eye(5, dtype=bool)
BOTH = pytest.mark.parametrize("scenario", [PLANE, slow(SPACE)], ids=["plane", "space"])
WORST = rv.Sensing(
    range=6.0, field_of_view=5.0, noise=0.1, bias=0.2, error=0.15, dropout=0.2, delay=3,
    sectors=720, occlusion="both",
)  # fmt: skip


def sensing(scenario: rv.Scenario, **fields) -> rv.Scenario:
    return scenario.replace(sensing=rv.Sensing(**fields))


def simulator(scenario: rv.Scenario, batch: int = 6, seed: int = 3) -> rv.Simulator:
    return started(scenario, batch, seed)


def neighbours(sim: rv.Simulator) -> np.ndarray:
    """Neighbour rows, (B, n, K, d)."""
    return sim.observe()[..., sim.scenario.observation_layout.neighbours, :].astype(np.float64)


def true_rows(sim: rv.Simulator) -> np.ndarray:
    """a_ij g_ij in the robots' own frames, (B, n, n, d), from positions; zero on the diagonal."""
    p = sim.positions
    offsets = p[:, None] - p[:, :, None]
    with np.errstate(invalid="ignore"):
        units = np.nan_to_num(offsets / np.linalg.norm(offsets, axis=-1, keepdims=True))
    return np.einsum("bikl,bijk->bijl", sim.frames, sim.weights[..., None] * units)


def by_robot(rows: np.ndarray) -> np.ndarray:
    """Rows (B, n, n − 1, d) with one for the robot itself, (B, n, n, d)."""
    batch, n, _, d = rows.shape
    table = np.zeros((batch, n, n, d))
    table[:, ~np.eye(n, dtype=bool)] = rows.reshape(batch, -1, d)
    return table


def turns(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Signed angles from true rows to measured rows in the plane."""
    cross = true[..., 0] * found[..., 1] - true[..., 1] * found[..., 0]
    return np.arctan2(cross, (true * found).sum(axis=-1))


def angles(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Angles between rows in 3-D."""
    return np.arctan2(np.linalg.norm(np.cross(true, found), axis=-1), (true * found).sum(axis=-1))


def turned(sim: rv.Simulator) -> np.ndarray:
    """Signed rotation of all bearings, (B, 20)."""
    return turns(by_robot(neighbours(sim)), true_rows(sim))[:, OTHERS]


def silhouettes(sim: rv.Simulator) -> np.ndarray:
    """Visible points of obstacles, (B, n, rows, d)."""
    return sim.observe()[:, :, sim.scenario.observation_layout.obstacles].astype(np.float64)


def rest(sim: rv.Simulator) -> None:
    """A step without motion."""
    sim.step(np.zeros(actions_shape(sim)))


def act(sim: rv.Simulator, step: int):
    """A step with inputs independent of observations."""
    normal = np.random.default_rng(step).normal(size=actions_shape(sim)[1:])
    drawn = 0.3 * normal * sim.scenario.action_bounds
    target = np.array([1.5, 1.5, 0.0])[: sim.scenario.dim]  # clear of all obstacles
    desired = np.einsum("bikl,bik->bil", sim.frames, target - sim.positions)
    return sim.step(drawn + desired)


@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_noise_is_gaussian_per_pair_and_step(sigma):
    """σ on both sides of the threshold of the faster code; 10⁶ bearings of teams at rest."""
    sim = simulator(sensing(PLANE, noise=sigma), batch=500)
    lengths, found = np.linalg.norm(by_robot(neighbours(sim)), axis=-1), []
    assert lengths == pytest.approx(sim.weights, rel=1e-6)
    for _ in range(100):
        found.append(turned(sim) / sigma)
        rest(sim)
    z = np.stack(found).reshape(100, 500, 5, 4)  # step, team, robot, whom it sees
    assert stats.kstest(z.ravel(), "norm").pvalue > 0.01
    assert z.mean() == pytest.approx(0.0, abs=3.5e-3)
    assert np.mean(z**2) == pytest.approx(1.0, abs=3.5 * math.sqrt(2e-6))
    assert np.mean(z**4) == pytest.approx(3.0, abs=3.5 * math.sqrt(96e-6))
    beyond = int((np.abs(z) > 4.0).sum())
    assert stats.binomtest(beyond, z.size, 2 * stats.norm.sf(4.0)).pvalue > 0.01
    to_and_from = z[:, :, 0, 0], z[:, :, 1, 0]  # robots 0 and 1 of each other
    pairs = {
        "steps": (z[1:], z[:-1]),
        "seeds": (z[:, 1:], z[:, :-1]),
        "robots": (z[:, :, 1:], z[:, :, :-1]),
        "rows": (z[..., 1:], z[..., :-1]),
        "both ways": to_and_from,
    }
    for name, (one, other) in pairs.items():
        assert abs(np.mean(one * other)) < 3.5 / math.sqrt(one.size), name
        squares = (one**2 - 1) * (other**2 - 1)
        assert abs(np.mean(squares)) < 7.0 / math.sqrt(one.size), name


@pytest.mark.slow
def test_noise_of_pair_is_independent_of_graph():
    found, one_way = [], rv.graphs.directed_cycle()
    for graph in ("complete", "cycle", rv.graphs.switching([one_way, "path"], 1.0)):
        sim = simulator(sensing(PLANE.replace(graph=graph, neighbour_slots=4), noise=0.2))
        found.append(turned(sim)[:, 0])
    assert found[0].all() and np.ptp(found, axis=0) == pytest.approx(0.0, abs=1e-6)


def test_bias_is_gaussian_per_pair_and_episode():
    sim = simulator(sensing(PLANE, bias=0.2), batch=40)
    first = turned(sim)
    assert stats.kstest(first.ravel() / 0.2, "norm").pvalue > 0.01
    for step in range(4):
        act(sim, step)
    gone = ~sim.active.all(axis=1)
    later = turned(sim)
    assert later[~gone] == pytest.approx(first[~gone], abs=1e-5) and (~gone).any()
    sim.reset()
    assert abs(np.corrcoef(first.ravel(), turned(sim).ravel())[0, 1]) < 0.15


@pytest.mark.parametrize("field", ["noise", "bias"])
@pytest.mark.parametrize(
    "scenario", [WALLED, pytest.param(SPACE, marks=pytest.mark.slow)], ids=["plane", "space"]
)
def test_obstacle_points_are_rotated_independently(scenario, field):
    exact = simulator(scenario, seed=5)
    erring = simulator(sensing(scenario, **{field: 0.1}), seed=5)
    true, found = silhouettes(exact), silhouettes(erring)
    there = true.any(axis=-1)
    assert there.sum() > 60 and (found.any(axis=-1) == there).all()
    measure = turns if scenario.dim == 2 else angles
    law = "norm" if scenario.dim == 2 else "halfnorm"
    first = measure(found, true)[there] / 0.1
    assert stats.kstest(first, law).pvalue > 0.01 and len(set(np.round(first, 6))) == there.sum()
    rest(erring)
    again = measure(silhouettes(erring), true)[there] / 0.1
    assert (np.abs(again - first).max() < 1e-4) == (field == "bias")


@pytest.mark.slow
@BOTH
def test_adversarial_error_rotates_bearings_outwards(scenario):
    eta, everybody = 0.3, np.arange(5)
    sim = simulator(sensing(scenario, error=eta), seed=11)
    rows, true = by_robot(neighbours(sim)), true_rows(sim)
    for team, places in enumerate(sim.positions):
        outward_directions(places, everybody, directions := np.zeros_like(places))
        for i, j in itertools.permutations(range(5), 2):
            outward = sim.frames[team, i].T @ directions[i]
            expected = turned_towards(tuple(true[team, i, j]), eta, tuple(outward))
            assert rows[team, i, j] == pytest.approx(expected, abs=1e-6)


def test_regular_polygon_grows_beyond_theorem_n_angle():
    """Law (1) on a cycle: the threshold π/n of theorem N is sharp."""
    start, grows = 3.0 * along(*72 * np.arange(5)), {}
    for share in (0.9, 1.05):
        cycle = PLANE.replace(graph="cycle", neighbour_slots=4)
        sim = started(sensing(cycle, error=share * math.pi / 5), positions=start)
        before = sim.size()[0]
        for _ in range(20):
            sim.step(sim.observe().sum(axis=2))
        grows[share] = sim.size()[0] > before
    assert grows == {0.9: False, 1.05: True}


def test_dropout_removes_expected_fraction():
    sim, exact = simulator(sensing(PLANE, dropout=0.3), batch=40), simulator(PLANE, batch=40)
    missing = []
    for _ in range(4):
        rows, true = neighbours(sim), neighbours(exact)
        there = rows.any(axis=-1)
        assert (rows[there] == true[there]).all()
        missing.append(~there)
        rest(sim)
    count = np.sum(missing)
    assert stats.binomtest(int(count), 4 * 40 * 20, 0.3).pvalue > 0.01
    assert (missing[0] & missing[1]).mean() == pytest.approx(0.09, abs=0.03)
    assert not neighbours(simulator(sensing(PLANE, dropout=1.0), batch=40)).any()


@BOTH
def test_range_and_field_of_view_limit_detection(scenario):
    exact, seen = simulator(scenario, seed=0), 0
    rows, true = by_robot(neighbours(exact)), true_rows(exact)
    assert rows == pytest.approx(true, abs=1e-6)
    p = exact.positions
    distances = np.linalg.norm(p[:, None] - p[:, :, None], axis=-1)
    ahead = np.arccos(np.clip(true[..., 0] / 0.7, -1, 1))
    for fields, wanted in (
        ({"range": 5.0}, distances <= 5.0),
        ({"range": 6.0, "field_of_view": 3.0}, (distances <= 6.0) & (ahead <= 1.5)),
    ):
        found = by_robot(neighbours(simulator(sensing(scenario, **fields), seed=0)))
        assert (found == np.where(wanted[..., None], rows, 0.0)).all()
        seen += int(found.any(axis=-1).sum())
    assert 30 < seen < 300


@pytest.mark.parametrize("batch", [1, 40])
@pytest.mark.parametrize("view", [0.5 * math.pi, math.pi, 1.9 * math.pi])
def test_the_edge_of_the_field_of_view_is_where_the_angle_is(view, batch):
    """Robots at the edge to the last bit are seen as their angles say."""
    scenario = sensing(PLANE.replace(local_frames="global"), field_of_view=view)
    seen, expected, half = [], [], 0.5 * view
    for shift in range(-40, 41):
        angle = half * (1.0 + shift * 2.0**-52)
        edge = np.array([math.cos(angle), math.sin(angle)])
        places = np.array([(0.0, 0.0), 3.0 * edge, -7.0 * edge, (5.0, 0.1), (-9.0, 0.1)])
        places[2] *= (-1.0, 1.0) if shift % 2 else (-1.0, -1.0)
        sim = started(scenario, batch, positions=places)
        seen.append(neighbours(sim)[-1, 0, :2].any(axis=-1))
        expected.append(np.abs(np.arctan2(*places[1:3].T[::-1])) <= half)
    assert (np.array(seen) == expected).all() and 0 < np.sum(expected) < 162


def test_obstacle_is_visible_if_any_point_is_in_view():
    partly = 0
    for scenario in (WALLED, SPACE):
        layout = scenario.observation_layout
        exact = layout.split(simulator(scenario).observe()).obstacles
        found = layout.split(simulator(sensing(scenario, field_of_view=1.5)).observe()).obstacles
        inside = np.arccos(np.clip(exact[..., 0], -1, 1)) <= 0.75
        inside &= exact.any(axis=-1)
        seen = inside.any(axis=-1)
        assert (found == np.where(seen[..., None, None], exact, 0.0)).all()
        partly += int((seen & ~inside.all(axis=-1)).sum())
    assert partly > 0


@pytest.mark.parametrize("what", ["none", "obstacles", "robots", "both"])
def test_obstacles_and_robots_occlude(what):
    hidden, scenario = 0, WALLED.replace(merge_radius=0.5)
    exact = by_robot(neighbours(simulator(scenario, 10, seed=0)))
    sim = simulator(sensing(scenario, occlusion=what), 10, seed=0)
    found = by_robot(neighbours(sim))
    for team, places in enumerate(sim.positions):
        for i, j in itertools.permutations(range(5), 2):
            here, way = triple(places[i]), triple(places[j] - places[i])
            walled = is_hidden_by_obstacles(world(SHAPES), here, way)
            crowded = any(
                is_hidden_by_robot(way, triple(places[k] - places[i]), 0.25)
                for k in range(5)
                if k not in (i, j)
            )
            ways = {"none": False, "obstacles": walled, "robots": crowded}
            hides = ways.get(what, walled or crowded)
            assert (found[team, i, j] == (0.0 if hides else exact[team, i, j])).all()
            hidden += hides
    assert (hidden > 10) == (what != "none")


@pytest.mark.slow
def test_spheres_occlude_in_3d():
    places = np.array([[-3, 0.2, 0], [3, 0.2, 0], [0.3, 3, 0.05], [0.3, 5, 0.05], [0, 0, 4.0]])
    sim = started(sensing(SPACE, occlusion="both"), positions=places)
    expected = OTHERS.copy()
    expected[0, 1] = expected[1, 0] = False  # behind the sphere
    assert (by_robot(neighbours(sim)).any(axis=-1) == expected).all()


@pytest.mark.kernels
def test_sectors_quantise_bearings():
    sim = simulator(sensing(WALLED, sectors=12), seed=5)
    rows, true = by_robot(neighbours(sim)), true_rows(sim)
    assert np.abs(turns(rows, true))[:, OTHERS].max() <= math.pi / 12 + 1e-6
    points = silhouettes(sim)
    for seen in (rows[:, OTHERS], points[points.any(axis=-1)]):
        turn = np.arctan2(seen[..., 1], seen[..., 0]) / (math.pi / 6)
        assert turn.size > 30 and turn == pytest.approx(np.round(turn), abs=1e-5)


@pytest.mark.parametrize(
    "scenario", [WALLED, SPACE.replace(spawn_size=3.0)], ids=["plane", "space"]
)
@pytest.mark.parametrize("fields", [{}, {"noise": 0.1, "dropout": 0.3, "bias": 0.1}])
def test_delay_is_exact_number_of_steps(scenario, fields):
    """Except gravity, the last row in 3-D, which is not delayed."""
    delay, steps, late_rows = 4, 90, scenario.observation_layout.obstacles.stop
    prompt, late = (
        simulator(sensing(scenario, delay=wait, **fields), seed=8) for wait in (0, delay)
    )
    history = [prompt.observe()]
    for step in range(steps):
        history.append(act(prompt, step).observations)
        running, outcome = ~late.ended, act(late, step)
        assert (late.active == prompt.active).all() and (late.positions == prompt.positions).all()
        due = history[-1].copy()
        due[:, :, :late_rows] = history[max(0, step + 1 - delay)][:, :, :late_rows]
        due[~outcome.active] = 0.0
        assert (outcome.observations[running] == due[running]).all()
    assert not late.active.all()


@pytest.mark.parametrize(
    ("scenario", "batch"),
    [(WALLED, 6), (SPACE, 6), pytest.param(RING, 1, marks=pytest.mark.slow)],
    ids=["plane", "space", "ring"],
)
def test_motion_and_v_follow_graph_not_detections(scenario, batch):
    exact = simulator(scenario, batch)
    erring = simulator(scenario.replace(sensing=WORST), batch)
    for step in range(60):
        true, found = act(exact, step), act(erring, step)
        for name in ("rewards", "contact", "clearance", "active", "lyapunov_after_merge"):
            assert (getattr(true, name) == getattr(found, name)).all()
    assert (exact.positions == erring.positions).all() and (exact.weights == erring.weights).all()
    assert (exact.lyapunov() == erring.lyapunov()).all()


@pytest.mark.slow
def test_present_rows_move_to_front():
    scenario = PLANE.replace(graph=UNEQUAL, neighbour_slots=3)
    exact, erring, moved = simulator(scenario, 1), simulator(sensing(scenario, dropout=0.5), 1), 0
    for _ in range(9):
        true, found = (neighbours(sim)[0].tolist() for sim in (exact, erring))
        for i in range(5):
            kept = [row for row in true[i] if any(row) and row in found[i]]
            assert found[i] == kept + [[0.0, 0.0]] * (3 - len(kept))
            moved += kept != true[i][: len(kept)]
        rest(exact)
        rest(erring)
    assert moved > 10


def test_state_contains_history_only_with_delay():
    assert "past" not in simulator(sensing(PLANE, noise=0.1)).get_state()
    past = simulator(sensing(PLANE, delay=2), 1).get_state()["past"]
    assert past.shape == (1, 3, 5, 4, 2) and past.dtype == np.float32
