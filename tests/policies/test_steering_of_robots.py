"""A wanted velocity as the inputs of a robot model; what is remembered turns with the frame."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tuples import body_frame

from baselines.steering import ALIGNED, Steering, inputs_towards
from rendezvous_env import Scenario, Simulator
from rendezvous_env.safety.turning import Gate, rates_towards

PLANE = Gate(True, 0.0, 0.0, 0.1, 2.0, 0.0)
SPACE = Gate(False, 0.0, 0.0, 0.1, 20.0, 2.0)
angles = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize(("model", "dim"), [("unicycle", 2), ("nonholonomic_3d", 3)])
def test_memory_turns_as_frames_do_and_velocities_move_robots(model, dim):
    scenario = Scenario(n_robots=5, dim=dim, robot_model=model, max_speed=1.0, max_turn_rate=2.0)
    simulator, steering = Simulator(scenario), Steering(scenario)
    seen = simulator.reset(seed=3)
    random = np.random.default_rng(0)
    kept = random.normal(size=(1, 5, dim))
    fixed = np.einsum("nij,nj->ni", simulator.frames[0], kept[0])
    for _ in range(30):
        actions = random.uniform(-1, 1, (1, 5, scenario.action_size)) * scenario.action_bounds
        actions = actions.astype(np.float32)
        before, frames = simulator.positions[0], simulator.frames[0]
        velocity = steering.velocities(actions, seen)[0]
        kept = steering.turned(kept, actions, seen)
        output = simulator.step(actions)
        seen = output.observations
        moved = np.einsum("nij,nj->ni", frames, velocity) * scenario.tau
        np.testing.assert_allclose(simulator.positions[0] - before, moved, atol=2e-7)
    now = np.einsum("nij,nj->ni", simulator.frames[0], kept[0])
    np.testing.assert_allclose(now, fixed, atol=2e-5)  # pitch is read from float32, 30 times


@given(angles)
def test_a_unicycle_turns_towards_what_is_wanted_and_never_past_it(angle):
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
def test_a_robot_of_space_gets_there_evenly_from_any_pitch(pitch, yaw, target):
    wanted = body_frame(3, yaw, target)[:, 0]
    steps = 0
    heading = 0.0
    while steps < 40:
        frame = body_frame(3, heading, pitch)
        rates = rates_towards(tuple(frame.T @ wanted), pitch, SPACE)
        assert abs(rates[0]) <= 20.0 + 1e-9 and abs(rates[1]) <= 2.0 + 1e-9
        heading, pitch, steps = heading + 0.1 * rates[0], pitch + 0.1 * rates[1], steps + 1
        if abs(rates[0]) < 20.0 - 1e-9 and abs(rates[1]) < 2.0 - 1e-9:
            break
    assert steps <= math.ceil(math.pi / 0.2) + 1  # of pitch; yaw is ten times as fast
    np.testing.assert_allclose(body_frame(3, heading, pitch)[:, 0], wanted, atol=1e-7)


def test_rest_is_rest_and_a_single_integrator_goes_where_it_is_to_go():
    for gate in (PLANE, SPACE):
        assert inputs_towards((0.0, 0.0, 0.0), 0.3, gate) == (0.0, (0.0, 0.0))
    scenario = Scenario(n_robots=2)
    steering, wanted = Steering(scenario), np.array([[[1.0, 2.0], [-0.5, 0.0]]])
    seen = np.zeros((1, 2, *scenario.observation_layout.shape), np.float32)
    for given_back in (
        steering.actions(wanted, seen),
        steering.velocities(wanted, seen),
        steering.turned(wanted, wanted, seen),
    ):
        np.testing.assert_array_equal(given_back, wanted)
