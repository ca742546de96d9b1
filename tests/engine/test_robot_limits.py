"""Teams whose robots differ in speed, turn rate, acceleration and body radius."""

import math

import numpy as np
import pytest
from parameters import needed, slow

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.checks import UnknownFieldError
from rendezvous_env.engine.preparation import constants, robot

LIMITS = {
    "max_speed": [0.1, 0.5, 1.0, 0.25],
    "max_turn_rate": [1.0, 2.0, 0.5, 3.0],
    "max_acceleration": [0.5, 1.0, 4.0, 2.0],
}
MODELS = [
    ("single_integrator", 2),
    ("unicycle", 2),
    slow("single_integrator", 3),
    needed("double_integrator", 2),
    needed("nonholonomic_3d", 3),
]
CLUTTER = {2: (rv.Disc((0.5, 0.3), 0.4),), 3: (rv.Sphere((0.5, 0.3, 0.0), 0.4),)}
START = np.array([[-2.0, 0.0, 0.0], [0.5, -1.0, 0.5], [2.0, 1.0, 0.0], [-1.0, 2.0, 1.0]])


def team(model: str, dim: int, **fields) -> rv.Scenario:
    given = {"obstacles": CLUTTER[dim], "n_robots": 4, "start_positions": START[:, :dim]}
    return rv.Scenario(robot_model=model, dim=dim, **{**given, **LIMITS, **fields})


def played(scenario: rv.Scenario, batch: int, steps: int = 25, seed: int = 3) -> list[dict]:
    """States of environment 0 under random actions that exceed every limit."""
    sim = rv.Simulator(scenario, batch)
    sim.reset(seed)
    random, states = np.random.default_rng(0), []
    for _ in range(steps):
        one = random.uniform(-6.0, 6.0, (scenario.n_robots, scenario.action_size))
        sim.step(np.repeat(one[None], batch, axis=0))
        states.append({name: array[:1].copy() for name, array in sim.get_state().items()})
    return states


@pytest.mark.parametrize(("model", "dim"), MODELS)
def test_limits_each_robot_moves_as_in_a_team_of_its_own_limits(model, dim):
    scenario = team(model, dim)
    mixed = played(scenario, 1)
    for i in range(4):
        alone = played(scenario.of_robot(i).replace(start_positions=scenario.start_positions), 1)
        for one, other in zip(mixed, alone, strict=True):
            if (one["merged_into"] == np.arange(4)).all():
                for name in ("positions", "memory"):
                    np.testing.assert_array_equal(one[name][:, i], other[name][:, i])


@pytest.mark.parametrize(("model", "dim"), MODELS)
def test_limits_batch_equals_singles(model, dim):
    scenario = team(model, dim)
    for one, other in zip(played(scenario, 1), played(scenario, 7), strict=True):
        for name in ("positions", "memory", "merged_into"):
            np.testing.assert_array_equal(one[name], other[name])


def test_limits_speeds_are_those_of_each_robot():
    scenario = rv.Scenario(n_robots=4, max_speed=LIMITS["max_speed"])
    sim = rv.Simulator(scenario, 6)
    sim.reset(0)
    before = sim.positions
    sim.step(np.full((6, 4, 2), 10.0))
    moved = np.linalg.norm(sim.positions - before, axis=-1)
    np.testing.assert_allclose(moved, np.tile(scenario.speed_limits * scenario.tau, (6, 1)))


def test_limits_of_equal_numbers_are_one_number():
    scenario = rv.Scenario(n_robots=3, max_speed=[1.0, 1.0, 1.0], max_turn_rate=(2.0, 2.0, 2.0))
    assert scenario == rv.Scenario(n_robots=3, max_speed=1.0, max_turn_rate=2.0)
    assert robot(scenario).limits is None and scenario.per_robot == ()


def test_limits_reach_of_contacts_is_that_of_the_fastest():
    scenario = rv.Scenario(n_robots=4, max_speed=[0.1, 3.0, 1.0, 0.25])
    assert constants(scenario, robot(scenario), 10).speed_limit == 3.0
    assert (scenario.speed_limit, scenario.min_speed_limit) == (3.0, 0.1)


def test_limits_survive_files(tmp_path):
    scenario = team("unicycle", 2, body_radius=[0.05, 0.1, 0.02, 0.07])
    scenario.to_toml(tmp_path / "mixed.toml")
    assert rv.Scenario.from_toml(tmp_path / "mixed.toml").replace(name="custom") == scenario
    assert rv.Scenario.from_plain(scenario.to_plain()) == scenario


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"max_speed": [1.0, 2.0]}, r"max_speed is \[1.0, 2.0\]; it must be 3 entries, one for"),
        ({"max_speed": []}, r"max_speed is \[\]; it must be one value, or a list of one for each"),
        ({"max_speed": [1.0, -1.0, 1.0]}, r"max_speed\[1\] is -1.0; it must be a positive"),
        ({"max_turn_rate": [1.0, "x", 1.0]}, r"max_turn_rate\[1\] is 'x'"),
        ({"body_radius": [0.1, 0.2, 0.1]}, "body_radius is .* at most half the merge_radius"),
        (
            {"body_radius": [0.1, 0.05, 0.1], "meeting": "pack"},
            "body_radius is .* one number with meeting='pack'",
        ),
        (
            {
                "body_radius": [0.1, 0.05, 0.1],
                "start_positions": [[0.0, 0.0], [0.12, 0.0], [5.0, 0.0]],
            },
            "robot_0 and robot_1 are 0.12 m apart; it must be at least 0.15",
        ),
    ],
)
def test_limits_refuses_wrong_lists(fields, message):
    with pytest.raises(ValueError, match=message) as found:
        rv.Scenario(n_robots=3, **fields)
    assert not isinstance(found.value, UnknownFieldError)


@pytest.mark.slow
def test_body_radius_of_each_robot_occludes():
    places = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.08]]
    hidden = rv.Sensing(occlusion="robots")
    rows = {}
    for radius in (0.1, 0.05):
        scenario = rv.Scenario(
            n_robots=3, start_positions=places, sensing=hidden, body_radius=[0.02, 0.03, radius]
        )
        sim = rv.Simulator(scenario)
        rows[radius] = np.count_nonzero(np.any(sim.reset(0)[0, 0] != 0.0, axis=-1))
    assert rows == {0.1: 1, 0.05: 2}


def test_action_spaces_are_those_of_each_robot():
    scenario = rv.Scenario(n_robots=4, robot_model="unicycle", **LIMITS)
    env = rv.parallel_env(scenario)
    for i, name in enumerate(env.possible_agents):
        own = [LIMITS["max_speed"][i], LIMITS["max_turn_rate"][i]]
        np.testing.assert_array_equal(env.action_space(name).high, np.float32(own))
    teams = rv.make_vec(scenario, num_envs=2)
    np.testing.assert_array_equal(
        teams.single_action_space.high, scenario.robot_bounds.astype(np.float32)
    )


def test_laws_act_within_the_limits_of_each_robot():
    scenario = rv.Scenario(n_robots=4, robot_model="unicycle", **LIMITS)
    sim = rv.Simulator(scenario, 3)
    actions = baselines.make("unicycle", scenario)(sim.reset(0), sim.time)
    assert (np.abs(actions) <= scenario.robot_bounds.astype(np.float32)).all()


@pytest.mark.parametrize("by", ["law", "heading", "tank", "gains", "links"])
def test_certificate_of_a_mixed_team_bounds_it_by_its_slowest_robot(by):
    mixed = rv.Scenario(n_robots=4, max_speed=[0.5, 2.0, 3.0, 4.0])
    margin = {"min_alignment": 0.2} if by in ("heading", "tank") else {}
    slow, fast = (rv.certificate(mixed.replace(max_speed=v), by=by, **margin) for v in (0.5, 4.0))
    found = rv.certificate(mixed, by=by, **margin)
    assert found.time_bound >= slow.time_bound * (1 - 1e-12)
    assert found.time_bound > fast.time_bound


@pytest.mark.parametrize("by", ["heading", "tank", "gains", "links"])
def test_filters_command_velocities_that_the_slowest_robot_executes(by):
    scenario = rv.Scenario(n_robots=4, max_speed=[0.3, 2.0, 3.0, 4.0])
    wrapper = {
        "heading": rv.vector.HeadingVectorWrapper,
        "tank": rv.vector.EnergyTankWrapper,
        "gains": rv.vector.GainWrapper,
        "links": rv.vector.LinkKeepingWrapper,
    }[by]
    env = wrapper(rv.make_vec(scenario, num_envs=8))
    env.reset(seed=0)
    random = np.random.default_rng(0)
    lyapunov = env.unwrapped.simulator.lyapunov()
    for _ in range(40):
        shape = env.action_space.shape
        env.step(random.uniform(0.0 if by == "gains" else -1.0, 1.0, shape).astype(np.float32))
        now = env.unwrapped.simulator.lyapunov()
        if by == "heading":
            assert (now <= lyapunov * (1 + 1e-9)).all()
        lyapunov = now


def mixed(**fields) -> rv.Scenario:
    names = ["single_integrator", "unicycle", "unicycle", "single_integrator"]
    given = {"obstacles": CLUTTER[2], "start_positions": START[:, :2], **LIMITS}
    return rv.Scenario(n_robots=4, robot_model=names, **{**given, **fields})


def test_mixed_team_moves_each_robot_by_its_own_model():
    scene = mixed(obstacles=())
    sim = rv.Simulator(scene, 3)
    sim.reset(3)
    random, tau = np.random.default_rng(0), scene.tau
    for _ in range(40):
        actions = np.float32(random.uniform(-3.0, 3.0, (3, 4, 2)))
        before, angles, frames = sim.positions, sim.headings[..., 0], sim.frames
        sim.step(actions)
        moved, turned = sim.positions - before, sim.headings[..., 0] - angles
        for i, name in enumerate(scene.robot_model):
            limit, turn = LIMITS["max_speed"][i], LIMITS["max_turn_rate"][i]
            action = actions[:, i].astype(np.float64)
            if name == "unicycle":
                speed, rate = (
                    np.clip(action[:, 0], -limit, limit),
                    np.clip(action[:, 1], -turn, turn),
                )
                np.testing.assert_allclose(turned[:, i], rate * tau, atol=1e-12)
                middle = angles[:, i] + 0.5 * rate * tau
                chord = speed * tau * np.sinc(0.5 * rate * tau / np.pi)
                way = chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
            else:
                size = np.linalg.norm(action, axis=-1, keepdims=True)
                velocity = action * np.minimum(1.0, limit / size)
                way = tau * np.einsum("bij,bj->bi", frames[:, i], velocity)
                assert not turned[:, i].any()
            np.testing.assert_allclose(moved[:, i], way, atol=1e-12)


@pytest.mark.slow
def test_mixed_team_batch_equals_singles():
    for one, other in zip(played(mixed(), 1), played(mixed(), 7), strict=True):
        for name in ("positions", "memory", "merged_into"):
            np.testing.assert_array_equal(one[name], other[name])


def test_unicycles_of_a_mixed_team_move_as_in_a_team_of_unicycles():
    alone = mixed().replace(robot_model="unicycle")
    for one, other in zip(played(mixed(), 1), played(alone, 1), strict=True):
        if (one["merged_into"] == np.arange(4)).all() and (
            other["merged_into"] == np.arange(4)
        ).all():
            for name in ("positions", "memory"):
                np.testing.assert_array_equal(one[name][:, 1:3], other[name][:, 1:3])


@pytest.mark.slow
@pytest.mark.kernels
def test_unicycles_of_a_mixed_team_slide_as_in_a_team_of_unicycles():
    starts = [[-2.0, 2.0], [0.5, -0.3], [1.2, 0.3], [-2.0, -2.0]]
    headings = [[0.0], [math.pi / 2.0], [math.pi], [0.0]]  # robots 1 and 2 face the disc
    scene = mixed(start_positions=starts, start_headings=headings)
    actions, found = np.array([[[0.0, 0.0], [3.0, 0.4], [3.0, -0.4], [0.0, 0.0]]]), []
    for scenario in (scene, scene.replace(robot_model="unicycle")):
        sim = rv.Simulator(scenario, 1)
        sim.reset(0)
        touched = np.zeros(4, np.bool_)
        for _ in range(40):
            touched |= sim.step(actions).contact[0]
        found.append((touched.tolist(), sim.positions[0, 1:3]))
    assert found[0][0] == found[1][0] == [False, True, True, False]
    np.testing.assert_array_equal(found[0][1], found[1][1])


def test_mixed_team_with_global_frames_has_them():
    sim = rv.Simulator(mixed(local_frames="global"))
    sim.reset(0)
    np.testing.assert_array_equal(sim.frames[0, [0, 3]], [np.eye(2)] * 2)
    assert (sim.frames[0, 1] != np.eye(2)).any()


@pytest.mark.slow
def test_mixed_team_meets_under_the_laws_of_its_robots():
    met = rv.rollout("mixed-8", baselines.make("by-model", "mixed-8"), num_envs=20)
    assert met.success.all()


def test_mixed_team_in_interfaces_and_files(tmp_path):
    scene = mixed(obstacles=())
    scene.to_toml(tmp_path / "mixed.toml")
    assert rv.Scenario.from_toml(tmp_path / "mixed.toml").replace(name="custom") == scene
    env = rv.parallel_env(scene)
    for i, name in enumerate(env.possible_agents):
        own = scene.of_robot(i).model.bounds(scene.of_robot(i))
        np.testing.assert_array_equal(env.action_space(name).high, np.float32(own))
    env.reset(seed=0)
    teams = rv.make_vec(scene, num_envs=2)
    teams.reset(seed=0)
    random = np.random.default_rng(0)
    for _ in range(10):
        one = np.float32(random.uniform(-1, 1, (4, 2)))
        rows = env.step({name: one[env.index(name)] for name in env.agents})[0]
        vector = teams.step(np.stack([one, one]))[0]
    for name, row in rows.items():
        np.testing.assert_array_equal(row, vector[0, env.index(name)])


@pytest.mark.parametrize(
    ("models", "dim", "message"),
    [
        (["unicycle", "single_integrator"], 3, r"robot_model\[0\] is 'unicycle'; .* for dim 3"),
        (["unicycle", "single_integrator", "unicycle"], 2, "2 entries, one for each robot"),
        (["unicycle", "bicycle"], 2, r"robot_model\[1\] is 'bicycle'"),
        (["unicycle"] * 3, 2, "2 entries, one for each robot"),
    ],
)
def test_mixed_team_refuses_wrong_models(models, dim, message):
    with pytest.raises(ValueError, match=message):
        rv.Scenario(n_robots=2, dim=dim, robot_model=models)


@pytest.mark.parametrize("field", ["max_speed", "max_turn_rate", "body_radius"])
def test_equal_limits_are_one_for_each_robot(field):
    with pytest.raises(ValueError, match=f"{field} is .*; it must be 4 entries"):
        rv.Scenario(n_robots=4, **{field: [0.05] * 3})
    assert getattr(rv.Scenario(n_robots=4, **{field: [0.05] * 4}), field) == 0.05


def test_mixed_team_does_not_pack():
    models = ["unicycle", "single_integrator"]
    with pytest.raises(ValueError, match=r"meeting is 'pack'.*only one model can pack"):
        rv.Scenario(n_robots=2, meeting="pack", body_radius=0.09, robot_model=models)
