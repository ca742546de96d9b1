"""Filters and certificates of mixed teams: single integrators beside nonholonomic robots."""

import re
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from faulty_filters import mistaken
from numpy.testing import assert_array_equal

import baselines
import rendezvous_env as rv
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.tank import EnergyTank
from train.verify.falsification import climb
from train.verify.random_scenarios import Trial

ROBOTS = {2: "unicycle", 3: "nonholonomic_3d"}
FILTERS = {"heading": HeadingFilter, "tank": EnergyTank}
WRAPPERS = {"heading": rv.vector.HeadingVectorWrapper, "tank": rv.vector.EnergyTankWrapper}


def team(dim=2, share=0.8, **fields):
    """Four robots, the second and the last nonholonomic, on a path, with limits of their own."""
    given = {
        "robot_model": ["single_integrator", ROBOTS[dim], "single_integrator", ROBOTS[dim]],
        "graph": rv.graphs.path(),
        "max_speed": [1.5, 0.9, 1.2, 1.0],
        "max_turn_rate": 2.5,
        "time_limit": 1e4,
        "allow_long_step": True,
    }
    made = rv.Scenario(n_robots=4, dim=dim, **{**given, **fields})
    return made.replace(time_step=share * made.certified_step)


def wrapped(by, scenario, num_envs=4, **settings):
    env = rv.make_vec(scenario, num_envs=num_envs, autoreset_mode="Disabled", num_threads=1)
    return WRAPPERS[by](env, **settings)


@pytest.mark.parametrize("frame", ["local", "net_bearing"])
@pytest.mark.parametrize("by", FILTERS)
@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.kernels)])
def test_robot_acts_as_in_a_team_of_its_model(by, dim, frame):
    """Bitwise, though robots of both kinds alternate."""
    scenario = team(dim, max_speed=1.0)
    turning = scenario.nonholonomic_robots
    env = wrapped(by, scenario, frame=frame)
    kinds = {False: "single_integrator", True: ROBOTS[dim]}
    alone = {
        turns: FILTERS[by](scenario.replace(robot_model=name), 4, frame=frame)
        for turns, name in kinds.items()
    }
    rows = {turns: one.scenario.observation_layout.shape[0] for turns, one in alone.items()}
    random, _ = np.random.default_rng(0), env.reset(seed=1)
    for _ in range(30):
        choices = random.uniform(-1, 1, (4, 4, dim))
        base = env._observed.copy()
        actions = env.filter.apply(base, choices.copy())
        for turns, one in alone.items():
            own = np.ascontiguousarray(base[:, :, : rows[turns]])
            one.observe(own)
            wanted = one.apply(own, choices[..., : one.action_size])
            mine = turning == turns
            assert_array_equal(actions[:, mine], wanted[:, mine])
            for name, values in one.diagnostics.items():
                assert_array_equal(env.filter.diagnostics[name][:, mine], values[:, mine])
            one.update() if by == "tank" else None
        env.filter.update() if by == "tank" else None
        observed, *_ = env.env.step(actions)
        env._observed = observed
        env.filter.observe(observed)


@pytest.mark.parametrize("by", FILTERS)
def test_nonholonomic_robots_observe_their_body_frame(by):
    env = wrapped(by, team(), frame="net_bearing")
    seen, _ = env.reset(seed=0)
    base, turning = env._observed, env.filter.scenario.nonholonomic_robots
    assert_array_equal(seen[:, turning], base[:, turning])
    f = env.filter.scenario.observation_layout.net_bearing(seen)[:, ~turning]
    np.testing.assert_allclose(f[..., 1], 0.0, atol=1e-6)
    assert (f[..., 0] > 0.1).all()


@pytest.mark.parametrize("kind", ["mixed", "single_integrator"])
@pytest.mark.parametrize("n_robots", [2, 4, 6])
def test_rows_of_all_robots_are_shown_with_a_level_behind_them(n_robots, kind):
    """Lengths of rows do not change, whether or not there are four rows or more."""
    models = {"mixed": ["single_integrator", "unicycle"] * (n_robots // 2)}
    scenario = rv.Scenario(n_robots=n_robots, robot_model=models.get(kind, kind))
    env = wrapped("tank", scenario, budget=0.5, observe_level=True, frame="net_bearing")
    seen, _ = env.reset(seed=0)
    shown, sizes = np.linalg.norm(seen, axis=-1), np.linalg.norm(env._observed, axis=-1)
    np.testing.assert_allclose(shown[..., :-1], sizes, atol=1e-6)
    np.testing.assert_allclose(shown[..., -1], 0.5 / (scenario.merge_radius * scenario.max_degree))


@pytest.mark.parametrize(("by", "dim"), [("heading", 2), ("heading", 3), ("tank", 2)])
def test_batch_equals_singles(by, dim):
    scenario, random = team(dim), np.random.default_rng(1)
    choices = random.uniform(-1, 1, (20, 5, 4, dim))
    batch = wrapped(by, scenario, 5)
    batch.reset(seed=list(range(5)))
    singles = [wrapped(by, scenario, 1) for _ in range(5)]
    for seed, one in enumerate(singles):
        one.reset(seed=seed)
    for given in choices:
        seen, rewards, *_ = batch.step(given)
        for k, one in enumerate(singles):
            own, reward, *_ = one.step(given[k : k + 1])
            assert_array_equal(seen[k], own[0])
            assert rewards[k] == reward[0]
    places = [one.unwrapped.simulator.positions[0] for one in singles]
    assert_array_equal(batch.unwrapped.simulator.positions, places)


@pytest.mark.parametrize("dim", [2, 3])
def test_choices_are_padded_and_masked(dim):
    """Numbers that a robot does not have change nothing; PettingZoo has no such numbers."""
    scenario, random = team(dim, on_merge="follow"), np.random.default_rng(2)
    env, other = (wrapped("heading", scenario, 1) for _ in range(2))
    mask = np.arange(dim) < np.where(scenario.nonholonomic_robots, dim - 1, dim)[:, None]
    assert_array_equal(env.filter.choice_mask, mask)
    assert_array_equal(env.action_mask, mask)
    assert env.single_action_space.shape == (4, dim)
    named = rv.HeadingVectorWrapper(rv.parallel_env(scenario))
    widths = [named.action_space(name).shape for name in named.possible_agents]
    assert widths == [(int(own.sum()),) for own in mask]
    single = gymnasium.make("rendezvous/RendezvousHeading-v0", scenario=scenario)
    assert single.action_space.shape == (4, dim)
    for one in (env, other, named, single):
        one.reset(seed=3)
    for _ in range(15):
        choice = random.uniform(-1, 1, (4, dim)).astype(np.float32)
        seen = env.step(choice[None])[0][0]
        assert_array_equal(other.step(np.where(mask, choice, 1.0)[None])[0][0], seen)
        assert_array_equal(single.step(choice)[0], seen)
        by_name = {name: choice[i, mask[i]] for i, name in enumerate(named.possible_agents)}
        rows = named.step({name: by_name[name] for name in named.agents})[0]
        for i, name in enumerate(named.possible_agents):
            assert_array_equal(rows[name], seen[i])
    with pytest.raises(ValueError, match=f"action of robot_1 .* {dim - 1} finite"):
        named.step(dict.fromkeys(named.agents, np.zeros(dim)))


def test_training_environment_pads_choices_of_agents():
    env = rv.training_env(team(), guarantee="heading", decision_period=1)
    teams = rv.vector.training_env(team(), 1, guarantee="heading", decision_period=1)
    assert_array_equal(teams.action_mask, env.vector_env.action_mask)
    env.reset(seed=0), teams.reset(seed=0)
    random = np.random.default_rng(0)
    choice = random.uniform(-1, 1, (4, 2)).astype(np.float32)
    mask = teams.action_mask
    seen = env.step({f"robot_{i}": choice[i, mask[i]] for i in range(4)})[0]
    assert_array_equal(np.array([*seen.values()]), teams.step(choice[None])[0][0])


@pytest.mark.parametrize("dim", [2, 3])
def test_certificate_has_the_bounds_of_theorem_t(dim):
    """Those of a team of nonholonomic robots with the least limits; turn limits of these alone."""
    scenario = team(dim)
    slow = scenario.replace(robot_model=ROBOTS[dim], max_speed=0.9)
    found, pure = (rv.certificate(one, 0.2) for one in (scenario, slow))
    assert found.guaranteed and found.time_bound == pure.time_bound < np.inf
    assert found.lyapunov_bound == pure.lyapunov_bound < np.inf
    assert "theorem T, mixed teams" in found.theorem and "allows 2.5 rad/s" in found.theorem
    limits = wrapped("heading", scenario, 1).filter._constants.robot
    rate = limits.gate.yaw_limit if dim == 2 else limits.gate.pitch_limit
    assert (rate, limits.speed_limit) == (2.5, 0.9)
    tank = rv.certificate(scenario, 0.2, by="tank", budget=0.5)
    assert not tank.guaranteed and "theorem D still keeps V bounded" in tank.theorem
    assert tank.lyapunov_bound == rv.certificate(slow, 0.2, by="tank", budget=0.5).lyapunov_bound


def test_certificate_of_laws_is_for_continuous_time_in_the_plane():
    found = rv.certificate(team())
    assert found.continuous_time_only and "1 and 3, mixed teams" in found.theorem
    assert rv.certificate(team(), policy=baselines.make("by-model", team())).guaranteed
    found = rv.certificate(team(3))
    assert not found.guaranteed and "law (17) is singular" in found.theorem


def test_certificate_of_headings_with_errors_keeps_v():
    """No time is known under bearing errors, and V never rises."""
    found = rv.certificate(team(sensing=rv.Sensing(error=0.02)), 0.2)
    assert not found.guaranteed and "V still never rises between merges" in found.theorem
    assert found.lyapunov_bound < np.inf


DOUBLE = ["single_integrator", "unicycle", "double_integrator", "unicycle"]


@pytest.mark.parametrize(
    ("scenario", "by", "message"),
    [
        (team(robot_model=DOUBLE), "heading", r"double_integrator .*; robot_model\[2\] must be"),
        (team(robot_model=DOUBLE), "law", r"double_integrator .*; robot_model\[2\] must be"),
        (team(), "gains", "that of unicycle robots is v, ω"),
        (team(3), "links", "that of nonholonomic_3d robots is v, ω"),
        (team(graph=rv.graphs.directed_cycle()), "heading", "no theorem on directed graphs"),
        (team(obstacles=[rv.Disc((0.0, 0.0), 0.3)]), "heading", "an obstacle can block a robot"),
        (team(sensing=rv.Sensing(dropout=0.1)), "heading", "neighbours can be invisible"),
        (team(activation="random", hold="stop"), "heading", "activation is asynchronous"),
    ],
)
def test_certificate_names_the_unmet_assumption(scenario, by, message):
    margin = 0.2 if by == "heading" else 1.0
    found = rv.certificate(scenario, margin, by=by)
    assert not found.guaranteed and np.isinf(found.time_bound)
    assert re.search(message, found.theorem)


def test_filters_refuse_models_of_robots_by_name():
    env = rv.make_vec(team(robot_model=DOUBLE), num_envs=1)
    for wrapper in WRAPPERS.values():
        with pytest.raises(ValueError, match=r"double_integrator robots \(robot 2\)"):
            wrapper(env)
    env = rv.make_vec(team(), num_envs=1)
    for wrapper in (rv.vector.GainWrapper, rv.vector.LinkKeepingWrapper):
        with pytest.raises(ValueError, match=r"unicycle robots \(robot 1\)"):
            wrapper(env)


def trial(by, dim=2, **settings):
    scenario = team(dim, share=settings.pop("share", 1.0))
    return Trial(scenario, by, {"min_alignment": 0.2, **settings}, seed=4)


@pytest.mark.parametrize(("by", "dim"), [("heading", 2), ("heading", 3), ("tank", 2), ("tank", 3)])
def test_adversaries_violate_no_bound(by, dim):
    played = climb(trial(by, dim))[1]
    assert played.violation is None
    every = {"heading": "descent", "tank": "ledger"}[by]
    assert any(what == every for _, what in played.counts)


def wrong_sign(monkeypatch):
    """Nonholonomic robots drive backwards."""
    right = HeadingFilter.apply_calls

    def apply_calls(self, part, observations, actions, elapsed=None):
        def flip():
            actions[:, self.scenario.nonholonomic_robots, 0] *= -1.0

        return [*right(self, part, observations, actions, elapsed), flip]

    monkeypatch.setattr(HeadingFilter, "apply_calls", apply_calls)


def too_long_step(monkeypatch):
    """Velocities are not scaled to a step that is longer than certified."""
    mistaken(monkeypatch, HeadingFilter, lambda known: {"speed_scaled": False})


def free_tank(monkeypatch):
    """Displacements cost nothing where robots are far from f."""
    mistaken(monkeypatch, EnergyTank, lambda known: {"merge_radius": 4.0 * known.merge_radius})


@pytest.mark.parametrize(
    ("fault", "given", "broken"),
    [
        (wrong_sign, trial("heading"), "descent"),
        (wrong_sign, trial("heading", 3), "descent"),
        (too_long_step, trial("heading", share=6.0), "descent"),
        (free_tank, trial("tank", share=6.0), "ledger"),
    ],
)
def test_injected_fault_is_found(fault, given, broken, monkeypatch):
    assert climb(given)[1].violation is None
    fault(monkeypatch)
    found = climb(replace(given, generations=2))[1].violation
    assert found is not None and found.number == broken and found.found > found.promised
