"""Validation of inputs of compiled code: outcomes, masks, actions, and observations."""

import re

import numpy as np
import pytest
from conftest import actions_shape, five, refusing, started
from strategies import DEEP, HUGE, refusal

import rendezvous_env as rv
from baselines.learned.features import Features
from baselines.obstacle_rules import obstacle_avoidance
from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import TIME_OUT
from rendezvous_env.engine.memory_layout import available_bytes, needed_bytes
from rendezvous_env.limits import MAX_OBSTACLES
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.trajectory import Step
from train.compare.evaluation import alignments

TEAMS = 6
PAIR = Scenario(n_robots=2)
SQUARE = rv.Polygon(((4.0, 0.0), (6.0, 0.0), (6.0, 2.0), (4.0, 2.0)))
CLUTTER = rv.scenarios.get("clutter-16")
HEADINGS = np.zeros((TEAMS, 4, 2))
AMONG = {"obstacles": (rv.Disc((0.0, 5.0), 1.0), SQUARE), "obstacle_slots": 3}


@pytest.mark.parametrize(
    "other",
    [
        Simulator(five("single_integrator-2d"), TEAMS - 1),
        Simulator(five("single_integrator-3d"), TEAMS),
        Simulator(five("single_integrator-2d", **AMONG), TEAMS),
        Simulator(rv.scenarios.get("duo"), TEAMS),
    ],
    ids=["batch", "dimension", "obstacles", "robots"],
)
def test_step_output_of_other_environment_is_rejected(other):
    sim = Simulator(five("single_integrator-2d"), TEAMS)
    for each in (sim, other):
        each.reset(0)
    outcome = other.step(np.zeros(actions_shape(other)))
    with refusing(sim, r"outcome: .+ a step of these"):
        sim.restart(np.ones(TEAMS, bool), outcome)
    for wrong in (5, "five", (1, 2)):
        with refusing(sim, r"outcome is .*; it must be the output of step"):
            sim.restart(np.ones(TEAMS, bool), wrong)
    own = sim.step(np.zeros(actions_shape(sim)))
    own.observations.flags.writeable = False
    with pytest.raises(ValueError, match="contiguous and writable"):
        sim.restart(np.ones(TEAMS, bool), own)


@pytest.mark.parametrize(
    "mask",
    [np.ones(TEAMS - 1, bool), np.ones(TEAMS), [0, 1], True, {}, [[True], [True, False]], DEEP],
)
def test_bad_mask_is_rejected_everywhere(mask):
    sim, perception = started(CLUTTER, TEAMS), Features(CLUTTER, TEAMS, decision_time=0.2)
    for refuse in (
        sim.restart,
        lambda mask: sim.reset(mask=mask),
        HeadingFilter(CLUTTER, TEAMS).forget,
        perception.forget,
        lambda mask: perception.see(sim.observe(), HEADINGS, mask),
    ):
        with pytest.raises(ValueError, match=f"mask is .*must be bool, one for each of {TEAMS}"):
            refuse(mask)


def test_bad_actions_do_not_start_next_episode():
    venv = rv.make_vec("fig3", 3, autoreset_mode="NextStep", max_cycles=2)
    venv.reset(seed=0)
    actions = np.zeros(venv.action_space.shape, np.float32)
    for _ in range(2):
        venv.step(actions)
    assert (venv.get_state()["status"] == TIME_OUT).all()
    for wrong in (actions * np.nan, actions[:1]):
        with refusing(venv, "action"):
            venv.step(wrong)


@pytest.mark.parametrize("batch", [1, TEAMS - 1, TEAMS + 1])
def test_observations_of_other_batch_are_rejected(kind, batch):
    scenario = five(kind)
    steering = HeadingFilter(scenario, TEAMS)
    seen = np.zeros((batch, 5, *scenario.observation_layout.shape), np.float32)
    for refuse in (steering.observe, steering.apply):
        with refusing(steering, r"observations have shape .*must be \(B, n, rows, d\)"):
            refuse(seen)
        with refusing(steering, "observations are int64"):
            refuse(np.zeros((TEAMS, 5, *scenario.observation_layout.shape), np.int64))


def test_features_reject_other_environments():
    perception = Features(CLUTTER, TEAMS, decision_time=0.2)
    seen = started(CLUTTER, TEAMS).observe()
    for wrong, carried, name in (
        (seen[:2], HEADINGS, "observations"),
        (seen.astype(complex), HEADINGS, "observations"),
        (seen, HEADINGS[:2], "headings"),
    ):
        with refusing(perception, f"{name} (have shape|are)"):
            perception.see(wrong, carried)


def test_heading_rules_reject_inconsistent_shapes():
    f, points = np.ones((3, 4, 2)), np.ones((3, 4, 5, 2, 2))
    for rule in (
        obstacle_avoidance.tangent_heading,
        obstacle_avoidance.tangent_blocking_heading,
        obstacle_avoidance.tangent_merged_heading,
    ):
        assert rule(f, points).shape == f.shape
        for bearing, silhouettes, message in (
            (f, points[:2], "silhouettes have shape"),
            (f, points[..., :1, :], "silhouettes have shape"),
            (np.ones((3, 4, 3)), points, "silhouettes have shape"),
            (np.ones((3, 4, 1)), points, "net_bearing has shape"),
            (f * np.nan, points, r"net_bearing is \[nan, .*\]; it must be finite"),
            (f, points.astype(np.int64), "silhouettes are int64"),
        ):
            assert re.search(message, refusal(rule, bearing, silhouettes))
    said = refusal(rule, f, points, carried=f[:2])
    assert "carried has shape (2, 4, 2)" in said


def test_alignments_reject_step_of_other_robots(kind):
    sim = Simulator(five(kind), 2)
    seen = sim.reset(0)
    actions = np.zeros(actions_shape(sim), np.float32)
    step = Step(np.ones(2, bool), seen, actions, sim.lyapunov(), sim.step(actions))
    assert alignments(sim.scenario, step).shape == (2, 5)
    for wrong in (
        step._replace(observations=seen[:1]),
        step._replace(actions=actions[..., :1]),
        step._replace(running=np.ones(3, bool)),
    ):
        with pytest.raises(ValueError, match="must be"):
            alignments(sim.scenario, wrong)


def test_memory_shortage_is_reported_before_allocation():
    crowded = Scenario(n_robots=2, obstacle_slots=MAX_OBSTACLES)
    for scenario, num_envs in ((PAIR, 10**9), (crowded, 10**6), (Scenario(n_robots=1000), 10**6)):
        message = refusal(Simulator, scenario, num_envs)
        assert re.search(rf"num_envs is {num_envs}: .* need .* GiB of memory, .* are free", message)
    assert "at most" in refusal(rv.make_vec, PAIR, num_envs=HUGE)
    assert 2**26 < available_bytes() < 2**63


@pytest.mark.parametrize(("n", "num_envs"), [(2, 1), (40, 1), (3, 500)])
def test_needed_bytes_bounds_state_size(n, num_envs):
    scenario = Scenario(n_robots=n, obstacle_slots=3)
    simulator = Simulator(scenario, num_envs)
    given_out = simulator.reset(0).nbytes
    needed = needed_bytes(scenario, num_envs)
    assert simulator.nbytes + given_out < needed < 8 * (simulator.nbytes + given_out)
