"""Rules for obstacles in mixed teams."""

import numpy as np
import pytest
from rendezvous_env.baselines.obstacle_rules.mixed_rules import member_of

import rendezvous_env as rv
from rendezvous_env import baselines

RULES = "tangent-merged-tuned", "tank-merged"
PLANE = rv.scenarios.get("clutter-8").replace(
    n_robots=4,
    robot_model=["single_integrator", "unicycle", "unicycle", "single_integrator"],
    max_speed=[1.0, 0.5, 1.0, 0.5],
    max_turn_rate=3.0,
)
SPACE = rv.scenarios.get("clutter-3d").replace(
    n_robots=4, robot_model=["nonholonomic_3d"] * 2 + ["single_integrator"] * 2
)
TEAMS = {"plane": PLANE, "space": SPACE}


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("team", TEAMS)
def test_rule_moves_each_robot_as_in_a_team_of_its_model(team, name):
    scenario = TEAMS[team]
    policy, sim = baselines.make(name, scenario), rv.Simulator(scenario, 3)
    sim.reset(seed=0)
    alone = {
        model: baselines.make(name, member_of(scenario, model)) for model in {*scenario.robot_model}
    }
    moved = np.zeros(4)
    for step in range(20):
        seen, time = sim.observe(), np.full(3, step * scenario.tau)
        actions = policy(seen, time)
        assert actions.dtype == np.float32 and (np.abs(actions) <= scenario.robot_bounds).all()
        for model, rule in alone.items():
            rows = rule.scenario.observation_layout.rows
            wanted, own = rule(seen[..., :rows, :], time), np.array(scenario.robot_model) == model
            np.testing.assert_array_equal(actions[:, own], wanted[:, own])
        moved += np.abs(actions).sum(axis=(0, 2))
        sim.step(actions)
    assert (moved > 0.0).all()


@pytest.mark.parametrize("name", RULES)
def test_rule_of_a_mixed_team_forgets_environments_that_are_reset(name):
    policy, fresh = (baselines.make(name, PLANE) for _ in range(2))
    sim = rv.Simulator(PLANE, 2)
    for seed in (0, 1):
        sim.reset(seed=seed)
        for _ in range(30):
            sim.step(policy(sim.observe(), 0.0))
    seen = sim.observe()
    policy.reset(np.array([True, False]))
    again, new = policy(seen, 0.0), fresh(seen, 0.0)
    np.testing.assert_array_equal(again[0], new[0])
    policy.reset()
    np.testing.assert_array_equal(policy(seen, 0.0), new)


def test_rules_take_mixed_teams_past_obstacles():
    shares = {}
    for name in ("by-model", *RULES):
        played = rv.rollout(PLANE, baselines.make(name, PLANE), num_envs=24, seed=0)
        shares[name] = (
            played.success.sum() - (played.success & played.contacts.any(axis=(0, 2))).sum()
        )
    assert shares["by-model"] < 18 and min(shares[name] for name in RULES) >= 21


def test_tanks_of_a_mixed_team_bound_v_and_headings_have_no_guarantee():
    policy = baselines.make("tank-merged", PLANE)
    found = rv.certificate(PLANE, policy=policy)
    alone = rv.certificate(PLANE, by="tank", budget=policy.guarantee["budget"])
    assert not found.guaranteed and found.lyapunov_bound == alone.lyapunov_bound < np.inf
    played = rv.rollout(PLANE, policy, num_envs=24, seed=5)
    free = ~played.contacts.any(axis=(0, 2))
    assert free.sum() > 12 and played.lyapunov[:, free].max() <= found.lyapunov_bound
    tuned = baselines.make("tangent-merged-tuned", PLANE)
    assert tuned.guarantee is None and "no theorem" in rv.certificate(PLANE, policy=tuned).theorem


def test_rules_of_mixed_teams_need_obstacles_and_known_models():
    assert not {*RULES} & {*baselines.names("mixed-8")}
    bodies = PLANE.replace(robot_model=["double_integrator"] + ["unicycle"] * 3)
    assert not {*RULES} & {*baselines.names(bodies)}
    with pytest.raises(ValueError, match="'tank-merged' does not fit"):
        baselines.make("tank-merged", bodies)


def test_rule_of_one_robot_of_a_mixed_team_is_that_of_its_model():
    robot = baselines.RobotPolicy(PLANE, "tangent-merged-tuned", robot=1)
    assert robot.scenario.robot_model == "unicycle"


@pytest.mark.parametrize("name", RULES)
def test_rule_of_a_mixed_team_has_no_jax_form(name):
    pytest.importorskip("jax")
    from rendezvous_env.baselines import jax as jax_policies

    with pytest.raises(NotImplementedError, match=f"policy '{name}' of a mixed team has no JAX"):
        jax_policies.make(name, PLANE)
