"""Common properties of all policies: resumption, batching, resets, and rendezvous."""

import copy
import pickle

import numpy as np
import pytest
from parameters import marked, slow

import baselines
import rendezvous_env as rv
from baselines.policy import is_single_integrator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.trajectory import begin, run

SCENARIOS = ("clutter-8", "clutter-3d", "unicycle-6", "uav-6", "duo", "mixed-8")
HEAVY = rv.Scenario(n_robots=3, robot_model="double_integrator")
ROUNDED = ("learned", "learned-tank", "learned-tank-noise", "learned-search")
"""The order of a network's sums depends on the batch size."""


def choose(observations):
    """Choices that depend on every row."""
    return np.tanh(np.cumsum(observations, axis=-2)[..., -1, :])


FILTERED = {
    "heading": lambda scenario: baselines.HeadingPolicy(scenario, choose, decision_period=3),
    "tank": lambda scenario: baselines.TankPolicy(scenario, choose, decision_period=3),
    "trained": lambda scenario: baselines.TrainedPolicy(scenario, lambda seen: seen[:, :2]),
}
ELSEWHERE = {
    "unicycle-clutter-8": (
        "tangent-merged", "tangent-merged-tuned", "tank-merged", "learned", "learned-tank",
        "privileged-planner",
    ),
    "clutter-3d": (
        "tangent-merged-tuned", "learned", "learned-tank", "tank-merged", "privileged-planner",
    ),
    "uav-clutter-16": ("tangent-merged-tuned",),
    "uav-6": ("learned-tank",),
}  # fmt: skip
ALSO_ELSEWHERE = [f"{name} {field}" for field, names in ELSEWHERE.items() for name in names]
NAMES = [*baselines.names(), *FILTERED, *ALSO_ELSEWHERE]
OTHER_KINDS = {"damped", "by-model", *ALSO_ELSEWHERE}
"""Kinds of environments excluded from fast tests."""
SEES = [name for name in NAMES if not name.startswith(("privileged", "random"))]


def made(name):
    """A policy, and a suitable scenario."""
    if name in FILTERED:
        scenario = rv.scenarios.get("clutter-8")
        return FILTERED[name](scenario), scenario
    if name in ALSO_ELSEWHERE:
        policy, field = name.split()
        scenario = rv.scenarios.get(field)
        return baselines.make(policy, scenario), scenario
    known = map(rv.scenarios.get, SCENARIOS)
    scenario = next((one for one in known if name in baselines.names(one)), HEAVY)
    return baselines.make(name, scenario), scenario


def sights(policy, scenario, steps=5):
    """Observations of three environments along an episode of the policy."""
    simulator = rv.Simulator(scenario, 3)
    seen = [simulator.reset(5)]
    for _ in range(steps):
        seen.append(simulator.step(policy(seen[-1], simulator.time)).observations)
    return seen


def same(name, found, wanted):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * (name.split()[0] in ROUNDED))


@pytest.mark.parametrize("name", marked([n for n in NAMES if n != "trained"], slow=OTHER_KINDS))
def test_policy_resumes_bitwise_from_pickle(name):
    """Pickled with its environments, which oracles read."""
    policy, scenario = made(name)
    simulator = rv.Simulator(scenario, 2)
    simulator.reset(5)
    begin(policy, simulator)
    for _ in range(7):
        simulator.step(policy(simulator.observe(), simulator.time))
    pairs = [(policy, simulator), pickle.loads(pickle.dumps((policy, simulator)))]
    before = simulator.observe().copy()
    for _ in range(7):
        here, there = (each(teams.observe(), teams.time) for each, teams in pairs)
        np.testing.assert_array_equal(here, there)
        for (_, teams), actions in zip(pairs, (here, there), strict=True):
            teams.step(actions)
        np.testing.assert_array_equal(pairs[0][1].positions, pairs[1][1].positions)
    assert name == "zero" or (simulator.observe() != before).any()


@pytest.mark.kernels
@pytest.mark.parametrize("name", marked([n for n in NAMES if n != "random"], own_path=OTHER_KINDS))
def test_batch_equals_single_environments(name):
    together, scenario = made(name)
    simulator = rv.Simulator(scenario, 3)
    seen = simulator.reset(5)
    begin(together, simulator)
    alone = [(made(name)[0], rv.Simulator(scenario)) for _ in range(3)]
    for team, (policy, one) in enumerate(alone):
        one.reset(5 + team)
        begin(policy, one)
    for _ in range(12):
        actions = together(seen, simulator.time)
        for team, (policy, one) in enumerate(alone):
            same(name, actions[team], policy(one.observe(), one.time)[0])
            one.step(actions[team : team + 1])
        seen = simulator.step(actions).observations


@pytest.mark.parametrize("name", marked(SEES, slow=OTHER_KINDS & {*SEES}))
def test_masked_reset_affects_masked_environments_only(name):
    policy, scenario = made(name)
    *_, last = sights(policy, scenario)
    whole, fresh = copy.deepcopy(policy) if name != "trained" else None, made(name)[0]
    policy.reset(np.array([False, True, False]))
    found, anew = policy(last, 0.0), fresh(last, 0.0)
    same(name, found[1], anew[1])
    if whole is not None:
        same(name, found[[0, 2]], whole(last, 0.0)[[0, 2]])
    policy.reset()
    np.testing.assert_array_equal(policy(last, 0.0), anew)
    nested = policy(np.stack([last, last]), 0.0)  # other leading axes: other teams
    assert nested.shape == (2, *anew.shape)
    same(name, nested[1], anew)
    same(name, policy(last[0], 0.0), anew[0])
    policy.reset(np.array(True))
    same(name, policy(last[0], 0.0), anew[0])


def test_memory_matters_and_foreign_batches_are_rejected():
    (tank, scenario), (rule, _) = made("tank-merged"), made("tangent-certified")
    rule.reset(np.array([True]))  # nothing to forget yet
    first, *_, last = sights(rule, scenario, steps=6)
    assert not np.array_equal(rule(last, 0.0), made("tangent-certified")[0](last, 0.0))
    with pytest.raises(ValueError, match=r"observations have shape .* needs \(\.\.\., 4, 19, 2\)"):
        rule(first[:, :1], 0.0)
    sights(tank, scenario, steps=6)
    assert (tank.levels != tank.budget).all()
    tank.reset(np.array([False, True, False]))
    assert (tank.levels == tank.budget).all(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize(
    "name",
    [
        slow(name) if name in OTHER_KINDS else name
        for name in SEES
        if name != "quantised" and is_single_integrator(made(name)[1])
    ],
)
def test_policies_are_rotation_equivariant(name):
    """Actions do not depend on the orientation of local axes, except for sectors."""
    plain, scenario = made(name)
    turned, simulator = made(name)[0], rv.Simulator(scenario, 3)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(scenario.dim, scenario.dim)))[0]
    turn[:, 0] *= np.linalg.det(turn)  # 1 or −1
    seen = simulator.reset(4)
    for _ in range(30):
        actions = plain(seen, 0.0)
        found = turned((seen @ turn).astype(np.float32), 0.0)
        np.testing.assert_allclose(found, actions @ turn, atol=2e-4 if scenario.dim == 2 else 1e-3)
        seen = simulator.step(actions).observations


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{}, {"dim": 3}, *(slow({"graph": kind}) for kind in ("path", "star", "random_tree"))],
)
def test_all_fitting_policies_meet_without_obstacles(changes):
    team = rv.Scenario(
        n_robots=6, max_speed=1.0, time_step=0.05, allow_long_step=True, time_limit=60.0, **changes
    )
    for name in baselines.names(team):
        found = rv.rollout(team, baselines.make(name, team), 0, num_envs=8, record=())
        assert (found.success == (name not in ("random", "zero"))).all(), name


THROUGH = {"time_limit": 25.0, "obstacle_contact": "ignore"}


@pytest.mark.parametrize(
    ("name", "field", "changes"),
    [
        ("tangent-merged-tuned", "slab-3d", THROUGH),
        ("tangent-merged-tuned", "clutter-3d-96", THROUGH),
        ("learned", "fig4", {}),
        ("learned", "duo", {"time_limit": 1000.0}),
        ("learned", "clutter-24", {"n_robots": 8, "time_limit": 3.0}),
        ("learned", "tree-12", {}),
    ],
)
def test_certified_headings_keep_alignment_and_v_never_increases(name, field, changes):
    """Theorem C, with obstacles but without contacts."""
    scenario = rv.scenarios.get(field).replace(**changes)
    simulator, policy = rv.Simulator(scenario, 16), baselines.make(name, scenario)
    checked = aside = 0
    for step in run(simulator, policy, simulator.reset(0)):
        f, v = scenario.observation_layout.net_bearing(step.observations), step.actions
        strength, speed = (np.linalg.norm(each, axis=-1) for each in (f, v))
        moving = step.running[:, None] & (strength > 2 * scenario.dead_zone) & (speed > 0.01)
        cosines = np.abs(np.sum(f * v, axis=-1))[moving] / (strength * speed)[moving]
        assert (cosines >= policy.min_alignment - 1e-5).all()
        calm = ~step.outcome.contact.any(axis=-1)
        assert (simulator.lyapunov() <= step.lyapunov * (1 + 1e-7))[calm].all()
        checked, aside = checked + moving.sum(), aside + (cosines < 0.5).sum()
    assert checked > 500 and (aside > 500 or name == "learned")
    assert field != "duo" or (simulator.status == RENDEZVOUS).all()
