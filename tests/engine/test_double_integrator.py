"""Double integrators, step by step: contacts, merges, rest, state."""

import numpy as np
import pytest
from conftest import UNEQUAL, started
from geometry import triple, world

import baselines
from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator, Sphere
from rendezvous_env.obstacles.obstacle_set import distance_to
from rendezvous_env.trajectory import run

pytestmark = pytest.mark.slow

FLAT = (
    Disc((0.0, 0.0), 1.0),
    Polygon(((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))),
    Capsule(((-1.0, -0.5), (1.0, 0.5)), 0.4),
)
SOLID = (Sphere((0.0, 0.0, 0.0), 1.0), Capsule(((-1.0, -0.5, 0.2), (1.0, 0.5, -0.2)), 0.4))
FAR = {2: Capsule(((90.0, 0.0), (91.0, 0.0)), 0.1), 3: Capsule(((90.0, 0, 0), (91.0, 0, 0)), 0.1)}
"""With this obstacle, all obstacles are of several kinds, so compiled code is shared with larger
batches."""
TEAMS = 6


def two(dim: int = 2, obstacles: tuple = (), **changes: object) -> Scenario:
    """Two robots, the second one far away and at rest."""
    given = {
        "n_robots": 2, "dim": dim, "robot_model": "double_integrator", "time_step": 0.1,
        "obstacles": (*obstacles, FAR[dim]), "max_speed": 3.0, "max_acceleration": 6.0,
        "local_frames": "global", "time_limit": 600.0, "allow_long_step": True,
    }  # fmt: skip
    return Scenario(**given | changes)


def begin(scenario: Scenario, position, velocity=None) -> Simulator:
    """Robot 0 with a position and velocity, robot 1 far away."""
    d, sim = scenario.dim, Simulator(scenario, TEAMS, num_threads=1)
    sim.reset(0, {"positions": [[*position], [50.0] * d]})
    if velocity is not None:
        state = sim.get_state()
        state["memory"][:, 0] = velocity
        sim.set_state(state)
    return sim


def push(sim: Simulator, acceleration) -> object:
    """One step with an acceleration of robot 0."""
    actions = np.zeros((sim.num_envs, 2, sim.scenario.dim), np.float32)
    actions[:, 0] = acceleration
    return sim.step(actions)


def clearance(scenario: Scenario, point) -> float:
    scene = world(scenario.obstacles)
    return min(distance_to(scene, m, triple(point)) for m in range(len(scenario.obstacles)))


@pytest.mark.parametrize("dim", [2, 3])
def test_free_motion_matches_closed_form(dim):
    scenario = two(dim, local_frames="random")
    sim, random = begin(scenario, [0.0] * dim), np.random.default_rng(0)
    frame = sim.frames[0, 0]
    p, v, length = np.zeros(dim), np.zeros(dim), 0.0
    for _ in range(200):
        action = random.uniform(-6, 6, dim).astype(np.float32)
        seen = push(sim, action).observations[0, 0]
        a = frame @ action.astype(float)
        a *= min(1.0, 6.0 / np.linalg.norm(a))
        w = v + 0.1 * a
        w *= min(1.0, 3.0 / np.linalg.norm(w))
        shares = (np.arange(2000) + 0.5)[:, None] / 2000
        length += 0.1 * np.linalg.norm(v + shares * (w - v), axis=1).mean()
        p, v = p + 0.05 * (v + w), w
        np.testing.assert_allclose(sim.positions[0, 0], p, atol=1e-9)
        np.testing.assert_allclose(sim.velocities[0, 0], v, atol=1e-9)
        assert np.linalg.norm(sim.velocities[0, 0]) <= 3.0 * (1 + 1e-12)
        split = scenario.observation_layout.split(seen)
        np.testing.assert_array_equal(split.velocity, seen[-1])
        np.testing.assert_allclose(split.velocity, frame.T @ v, atol=1e-6)
    assert sim.path_length[0] == pytest.approx(length, abs=1e-4)
    assert scenario.observation_layout.velocity == slice(seen.shape[0] - 1, seen.shape[0])


@pytest.mark.parametrize("mode", ["slide", "stop"])
@pytest.mark.parametrize("obstacle", [*FLAT, *SOLID], ids=lambda o: f"{type(o).__name__}{o.dim}")
def test_double_integrator_never_enters_obstacle(obstacle, mode):
    """Robots move towards the obstacle from all sides, and then in varying directions."""
    dim = obstacle.dim
    scenario = two(dim, (obstacle,), obstacle_contact=mode, max_speed=30.0, max_acceleration=300.0)
    sim, random, touched = begin(scenario, [2.0] * dim), np.random.default_rng(1), 0
    for k in range(150):
        before, velocity = sim.positions[:, 0], sim.velocities[:, 0]
        drawn = -30 * before - 4 * velocity + random.normal(0, 40, (TEAMS, dim))
        outcome = push(sim, drawn * (1.0 if k % 10 else -10.0))
        contact = outcome.contact[:, 0]
        after, speeds = sim.positions[:, 0], np.linalg.norm(sim.velocities[:, 0], axis=-1)
        touched += contact.sum()
        assert (speeds <= 30.0 * (1 + 1e-12)).all()
        for team in range(TEAMS):
            nearest = clearance(scenario, after[team])
            assert nearest >= -1e-9
            assert outcome.clearance[team, 0] == pytest.approx(nearest, abs=1e-12)
            if mode == "stop" and contact[team]:
                assert speeds[team] == 0 and nearest < 1e-5
            if mode == "stop":  # it goes straight or nearly so: never to the other side at once
                middle = 0.5 * (before[team] + after[team])
                sagitta = 300.0 * 0.1**2 / 8
                assert clearance(scenario, middle) > -sagitta - 1e-9
    assert touched > 20


@pytest.mark.parametrize("obstacle", (*FLAT[:2], Capsule(((-1, 0), (1, 0)), 1.0)), ids=type)
@pytest.mark.parametrize("mode", ["slide", "stop"])
def test_head_on_contact_stops_at_surface(obstacle, mode):
    scenario = two(2, (obstacle,), obstacle_contact=mode)
    sim = begin(scenario, (0.0, 1.13), (0.0, -3.0))
    assert push(sim, (0.0, 0.0)).contact[0, 0]
    for _ in range(5):
        np.testing.assert_allclose(sim.positions[0, 0], (0.0, 1.0), atol=1e-9)
        np.testing.assert_allclose(sim.velocities[0, 0], 0.0, atol=1e-9)
        seen = push(sim, (0.0, -6.0))
        assert seen.contact[0, 0]
        np.testing.assert_allclose(seen.observations[0, 0, -1], 0.0, atol=1e-6)
    push(sim, (0.0, 6.0))  # and leaves as it came
    np.testing.assert_allclose(sim.velocities[0, 0], (0.0, 0.6), atol=1e-9)


def test_sliding_contact_is_frictionless():
    """At the wall, the tangential acceleration is unchanged."""
    scenario = two(2, (FLAT[1],))
    sim = begin(scenario, (-0.9, 1.0))
    for k in range(1, 6):
        assert push(sim, (2.0, -5.0)).contact[0, 0]
        np.testing.assert_allclose(sim.velocities[0, 0], (0.2 * k, 0.0), atol=1e-6)
        np.testing.assert_allclose(sim.positions[0, 0], (-0.9 + 0.01 * k * k, 1.0), atol=2e-6)


def test_survivor_keeps_velocity():
    scenario = two()
    sim = begin(scenario, (0.0, 0.0), (1.0, 0.5))
    state = sim.get_state()
    state["positions"][0, 1], state["memory"][0, 1] = (0.3, 0.0), (-2.0, 0.0)
    sim.set_state(state)
    out = push(sim, (0.0, 1.0))
    assert sim.active[0].tolist() == [True, False] and out.status[0] == 1
    np.testing.assert_allclose(sim.velocities[0, 0], (1.0, 0.6), atol=1e-9)
    assert (out.observations[0, 1] == 0).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_damped_law_reaches_rendezvous(dim):
    scenario = Scenario(
        n_robots=5, dim=dim, robot_model="double_integrator", graph=UNEQUAL, obstacles=(FAR[dim],)
    )
    sim = started(scenario, 64)
    energies = [0.5 * sim.lyapunov()]  # all are at rest
    for _ in run(sim, baselines.make("damped", scenario), sim.observe()):
        energies.append(0.5 * (sim.velocities**2).sum((1, 2)) + 0.5 * sim.lyapunov())
        if len(energies) == 40:  # before anybody meets the energy has fallen, in each team
            calm = sim.active.all(axis=1)
            assert calm.sum() > 30 and (energies[-1] < energies[0])[calm].all()
    assert (sim.status == 1).all()
    assert sim.time.max() < 10.0
    with pytest.raises(ValueError, match=r"damping is -1; it must be a positive"):
        baselines.make("damped", scenario, damping=-1)
