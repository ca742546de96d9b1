"""Nonholonomic robots: inputs for velocities, rotated memory, and obstacle avoidance."""

import math

import numpy as np
import pytest
from geometry import body_frame
from hypothesis import given, settings
from hypothesis import strategies as st

import baselines
import rendezvous_env as rv
from baselines.obstacle_rules.tank_policies import HEADING
from baselines.steering import ALIGNED, Steering, inputs_towards
from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.safety.turning import Gate, rates_towards
from rendezvous_env.trajectory import run

PLANE = Gate(True, 0.0, 0.0, 0.1, 2.0, 0.0)
SPACE = Gate(False, 0.0, 0.0, 0.1, 20.0, 2.0)
angles = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize(("model", "dim"), [("unicycle", 2), ("nonholonomic_3d", 3)])
def test_memory_rotates_with_frames(model, dim):
    scenario = Scenario(n_robots=5, dim=dim, robot_model=model, max_speed=1.0, max_turn_rate=2.0)
    simulator, steering = Simulator(scenario), Steering(scenario)
    seen, random = simulator.reset(seed=3), np.random.default_rng(0)
    kept = random.normal(size=(1, 5, dim))
    fixed = np.einsum("nij,nj->ni", simulator.frames[0], kept[0])
    for _ in range(30):
        actions = random.uniform(-1, 1, (1, 5, scenario.action_size)) * scenario.action_bounds
        actions = actions.astype(np.float32)
        before, frames = simulator.positions[0], simulator.frames[0]
        velocity = steering.velocities(actions, seen)[0]
        kept = steering.turned(kept, actions, seen)
        seen = simulator.step(actions).observations
        moved = np.einsum("nij,nj->ni", frames, velocity) * scenario.tau
        np.testing.assert_allclose(simulator.positions[0] - before, moved, atol=2e-7)
    now = np.einsum("nij,nj->ni", simulator.frames[0], kept[0])
    np.testing.assert_allclose(now, fixed, atol=2e-5)  # pitch is read from float32, 30 times


@given(angles)
def test_unicycle_turns_towards_target_without_overshoot(angle):
    speed, (rate, _) = inputs_towards((math.cos(angle), math.sin(angle), 0.0), 0.0, PLANE)
    left = angle - rate * PLANE.duration
    assert abs(left) == pytest.approx(max(abs(angle) - 0.2, 0.0), abs=1e-12)
    assert left * angle >= -1e-12
    if abs(angle) > ALIGNED:
        assert speed == 0.0
    else:  # the mean of the cosine of the angle from what is wanted
        assert math.cos(angle) - 1e-9 <= speed <= 1.0
        swept = rate * PLANE.duration
        mean = math.cos(angle) if swept == 0 else (math.sin(angle) - math.sin(left)) / swept
        assert abs(swept) < 1e-6 or speed == pytest.approx(mean, abs=1e-9)


@settings(max_examples=200, deadline=None)
@given(angles, angles, angles)
def test_nonholonomic_3d_turns_evenly_from_any_pitch(pitch, yaw, target):
    wanted, steps, heading = body_frame(3, yaw, target)[:, 0], 0, 0.0
    while steps < 40:
        rates = rates_towards(tuple(body_frame(3, heading, pitch).T @ wanted), pitch, SPACE)
        assert abs(rates[0]) <= 20.0 + 1e-9 and abs(rates[1]) <= 2.0 + 1e-9
        heading, pitch, steps = heading + 0.1 * rates[0], pitch + 0.1 * rates[1], steps + 1
        if abs(rates[0]) < 20.0 - 1e-9 and abs(rates[1]) < 2.0 - 1e-9:
            break
    assert steps <= math.ceil(math.pi / 0.2) + 1  # of pitch; yaw is ten times as fast
    np.testing.assert_allclose(body_frame(3, heading, pitch)[:, 0], wanted, atol=1e-7)


def test_zero_velocity_rests_and_single_integrator_follows():
    for gate in (PLANE, SPACE):
        assert inputs_towards((0.0, 0.0, 0.0), 0.3, gate) == (0.0, (0.0, 0.0))
    scenario = Scenario(n_robots=2)
    steering, wanted = Steering(scenario), np.array([[[1.0, 2.0], [-0.5, 0.0]]])
    seen = np.zeros((1, 2, *scenario.observation_layout.shape), np.float32)
    for same in (
        steering.actions(wanted, seen),
        steering.velocities(wanted, seen),
        steering.turned(wanted, wanted, seen),
    ):
        np.testing.assert_array_equal(same, wanted)


def before_edges(obstacles):
    """Whether the body axis lies inside a silhouette by more than a little, (..., n)."""
    last, first = (np.arctan2(obstacles[..., k, 1], obstacles[..., k, 0]) for k in (0, 1))
    width, inside = (last - first) % (2 * np.pi), (-first) % (2 * np.pi)
    seen = np.abs(obstacles[..., 0, :]).sum(axis=-1) > 0
    return (seen & (inside > 1e-3) & (inside < width - 1e-3)).any(axis=-1)


def before_spheres(obstacles):
    """A sphere of half angle θ about c blocks an axis h with ∠(h, c) < θ.

    That is, cos ∠ > cos θ = ‖Σ rays‖/8.
    """
    middles = obstacles.sum(axis=-2)
    lengths = np.linalg.norm(middles, axis=-1)
    within = middles[..., 0] > lengths**2 / 8 * (1 + 1e-4)
    return (within & (lengths > 0.0)).any(axis=-1)


@pytest.mark.parametrize(
    ("name", "field", "is_before", "least"),
    [
        ("tangent-merged", "unicycle-clutter-24-slower", before_edges, 100),
        ("tangent-merged-tuned", "unicycle-clutter-24-slower", before_edges, 100),
        ("tank-merged", "unicycle-clutter-24-slower", before_edges, 100),
        ("tangent-merged", "uav-clutter-16", before_spheres, 500),
        ("tangent-merged-tuned", "uav-clutter-16", before_spheres, 500),
    ],
)
def test_rules_never_drive_into_visible_obstacles(name, field, is_before, least):
    scenario = rv.scenarios.get(field)
    scenario = scenario.replace(time_limit=20.0 if scenario.dim == 2 else 30.0)
    simulator, policy = Simulator(scenario, 20), baselines.make(name, scenario)
    rested = drove = 0
    for step in run(simulator, policy, simulator.reset(0)):
        obstacles = scenario.observation_layout.split(step.observations).obstacles
        blocked = is_before(obstacles.astype(np.float64)) & step.running[:, None]
        assert (step.actions[..., 0][blocked] == 0.0).all()
        rested += int(blocked.sum())
        drove += int((step.actions[..., 0] > 0.0).sum())
    assert rested > least and drove > 5000
    assert not simulator.contacts.any()
    assert scenario.dim == 2 or np.mean(simulator.status == RENDEZVOUS) > 0.7


def test_memory_is_steady_while_robot_turns():
    """With a wall from −0.5 to 0.5 rad about f, the desired direction is 0.7 rad.

    It does not depend on the robot's rotation: the robot turns on the spot, then drives.
    """
    scenario = rv.scenarios.get("unicycle-clutter-24-slower")
    policy = baselines.make("tank-merged", scenario, clearance=0.2)
    layout, yaw, speeds = scenario.observation_layout, 0.0, []
    for _ in range(40):
        seen = np.zeros((1, scenario.n_robots, *layout.shape), np.float32)
        angles = np.array([0.5, -0.5]) - yaw
        seen[0, 0, layout.neighbours.start] = math.cos(yaw), -math.sin(yaw)
        edges = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        seen[0, 0, layout.obstacles.start : layout.obstacles.start + 2] = edges
        speed, rate = policy(seen, 0.0)[0, 0].tolist()
        assert rate == pytest.approx(min(0.5, (0.7 - yaw) / scenario.tau), abs=1e-4)
        yaw += rate * scenario.tau
        speeds.append(speed)
        x, y = policy._memory[0, 0, HEADING : HEADING + 2]
        assert yaw + math.atan2(y, x) == pytest.approx(0.7, abs=1e-5)
    assert speeds[0] == 0.0 and speeds[-1] == pytest.approx(1.0, abs=0.4)
    assert yaw == pytest.approx(0.7, abs=1e-4)


@pytest.mark.parametrize("name", ["tangent-merged", "tank-merged"])
def test_touching_robot_drives_away(name):
    """It starts on the surface, facing away; silhouettes are half of all directions."""
    for dim, model, obstacle in (
        (2, "unicycle", rv.Disc((0.0, 0.0), 1.0)),
        (3, "nonholonomic_3d", rv.Sphere((0.0, 0.0, 0.0), 1.0)),
    ):
        start = [[1.0, 0.0, 0.0][:dim], [4.0, 0.0, 0.0][:dim]]
        scenario = Scenario(
            n_robots=2, dim=dim, robot_model=model, obstacles=[obstacle], start_positions=start
        )
        simulator, policy = Simulator(scenario), baselines.make(name, scenario)
        headings = np.zeros((2, dim - 1))
        seen = simulator.reset(0, {"headings": headings})
        assert policy(seen, 0.0)[0, 0, 0] > 0.9
