"""Wall following under a tank: stored energy, memory, and walls too long for law (4)."""

import numpy as np
import pytest
from parameters import slow

import baselines
import rendezvous_env as rv
from baselines.steering import Steering
from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.trajectory import run

CLUTTER = rv.scenarios.get("clutter-8").replace(time_limit=20.0)
WALLS = [((0, -1.5), (0, 1.5)), ((-1.5, 1.5), (1.5, 1.5)), ((-1.5, -1.5), (1.5, -1.5))]
BAY = {
    "n_robots": 2,
    "start_positions": ((-1.0, 0.3), (1.0, 0.0)),
    "obstacles": tuple(rv.Capsule(ends=ends, radius=0.2) for ends in WALLS),
}
"""Two bays back to back: the only exit of each leads away from the other robot."""


def made(scenario=CLUTTER, **options):
    return baselines.make("tank-merged", scenario, **options)


@pytest.mark.parametrize(
    ("name", "budget", "teams", "least"),
    [
        pytest.param("clutter-24", 0.0, 32, 10_000, marks=pytest.mark.kernels),
        slow("clutter-24", 5.0, 32, 10_000),
        ("slab-3d", 5.0, 32, 10_000),
        slow("unicycle-clutter-24-slow", 0.0, 120, 100_000),
        slow("unicycle-clutter-24-slow", 5.0, 120, 100_000),
        slow("uav-clutter-16", 50.0, 32, 20_000),
    ],
)
def test_v_plus_ledger_decreases_without_contact(name, budget, teams, least):
    """V + ΣA decreases, although memory rotates with the bodies without feedback."""
    scenario = rv.scenarios.get(name).replace(time_limit=45.0)
    policy, simulator = made(scenario, budget=budget), Simulator(scenario, teams)
    steering, checked, away = Steering(scenario), 0, 0
    levels = scenario.n_robots * budget
    for step in run(simulator, policy, simulator.reset(0)):
        f = scenario.observation_layout.net_bearing(step.observations)
        there = f.any(axis=-1) & step.running[:, None]
        lost = np.sum(f * steering.velocities(step.actions, step.observations), axis=-1) < -1e-3
        before, levels = step.lyapunov + levels, policy.levels.sum(axis=-1)
        whole = (there == step.outcome.active).all(axis=-1)
        calm = step.running & whole & ~step.outcome.contact.any(axis=-1)
        assert ((simulator.lyapunov() + levels)[calm] <= before[calm] * (1 + 1e-6)).all()
        assert (policy.levels >= 0).all()
        checked, away = checked + there[calm].sum(), away + (lost & there).sum()
    assert checked > least and away > least / 100
    if scenario.dim == 3:  # a slab, too, which a heading does not round
        clean = np.mean((simulator.status == RENDEZVOUS) & (simulator.contacts == 0))
        assert clean > (0.9 if name == "slab-3d" else 0.8)


@pytest.mark.parametrize("field", ["clutter-8", slow("unicycle-clutter-24-slow")])
def test_tank_leaves_bay_unlike_heading(field):
    """A heading policy rests there for ever, as leaving would increase V."""
    bay = rv.scenarios.get(field).replace(name="bay", time_limit=60.0, **BAY)
    for name, meets in (("tangent-merged-tuned", False), ("tank-merged", True)):
        simulator, policy = Simulator(bay, 5), baselines.make(name, bay)
        steps = run(simulator, policy, simulator.reset(0))
        highest = np.max([simulator.lyapunov() for _ in steps], axis=0)
        assert ((simulator.status == RENDEZVOUS) == meets).all() and not simulator.contacts.any()
    first = simulator.initial_lyapunov
    rises = (first < highest) & (highest <= first + 2 * 50.0)
    assert rises.all() or bay.robot_model == "unicycle"


def test_free_path_follows_f():
    scenario = Scenario(n_robots=4, obstacle_slots=2, max_speed=1.0)
    observations = Simulator(scenario, 5).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    wanted = f / length * np.minimum(1.0, length)
    np.testing.assert_allclose(made(scenario)(observations, 0.0), wanted, rtol=1e-5, atol=1e-6)


def in_a_corner():
    """A scenario and observations of its first robot: f along x, wall from −2.5 to 2.4 rad."""
    scenario = Scenario(n_robots=2, obstacle_slots=2, time_step=0.05, max_speed=1.0)
    layout = scenario.observation_layout
    free = np.zeros((2, *layout.shape), np.float32)
    free[0, layout.neighbours] = [1.0, 0.0]
    angles = np.array([0.1, -2.5, 2.4, -0.1])  # two silhouettes that overlap straight ahead
    walled = free.copy()
    walled[0, layout.obstacles] = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return scenario, free, walled


def test_rule_turns_back_after_enough_loss():
    """Infinite wall: 0.2 rad outside either end, first 1 m against f, then 2 m."""
    scenario, _, walled = in_a_corner()
    policy = made(scenario, patience=1.0)
    sides = [float(np.sign(policy(walled, 0.0)[0, 1])) for _ in range(60)]
    turns = np.flatnonzero(np.diff(sides)) + 1
    assert sides[0] == 1.0 and len(turns) == 2
    assert turns[0] == pytest.approx(1.0 / (0.05 * abs(np.cos(2.6))), abs=1.5)
    assert turns[1] - turns[0] == pytest.approx(1.0 / (0.05 * abs(np.cos(2.7))), abs=1.5)


def test_robot_with_low_tank_rests():
    scenario, free, walled = in_a_corner()
    policy = made(scenario, budget=0.0)
    for _ in range(6):
        assert policy(free, 0.0)[0] == pytest.approx([1.0, 0.0])  # earns a little
    moved = np.array([policy(walled, 0.0)[0] for _ in range(100)])
    assert (moved[0] != 0).any()  # what was earned is spent
    assert not moved[-20:].any() and policy.levels[0] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_alignment": 1e-9}, "min_alignment is 1e-09"),
        ({"clearance": -0.1}, "clearance is -0.1"),
    ],
)
def test_options_are_validated(options, message):
    with pytest.raises(ValueError, match=message):
        made(**options)
