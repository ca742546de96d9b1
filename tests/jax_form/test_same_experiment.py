"""The JAX form against the engine: the same seeds give the same experiment."""

import numpy as np
import pytest
from parameters import marked

import rendezvous_env as rv
from rendezvous_env import graphs

STEPS, TEAMS, SEED = 200, 3, 5
UNEVEN = graphs.directed([[0, 1, 0, 2.0], [0, 0, 1, 0], [1, 0, 0, 0.5], [0, 1, 0, 0]])
LONG = {"time_limit": 8.0}
INERT = {"robot_model": "double_integrator"}
AMONG = {"max_speed": 1.0, "spawn_size": 8.0, **LONG}
HIDDEN = {"merge_through_obstacles": False, "merge_radius": 1.2}
GIVEN = {
    "start_positions": [[-2.0, 0.0], [2.0, 0.5]],
    "reward": rv.RewardWeights(clearance_penalty=0.3),
}
PLANE = [
    rv.Capsule(((-1.0, -1.0), (1.0, 1.5)), 0.4),
    rv.Disc((1.5, -1.0), 0.6),
    rv.Polygon(((-2.0, 1.0), (-1.0, 1.0), (-1.0, 2.0), (-2.0, 2.0))),
]
SEAMS = [
    rv.Polygon(((-2.0, -1.0), (0.0, -1.0), (0.0, 1.0), (-2.0, 1.0))),
    rv.Polygon(((0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0))),
    rv.Disc((0.0, 1.5), 0.5),
    rv.Capsule(((-1.0, -2.0), (1.0, -2.5)), 0.4),
]
"""Shapes of all kinds; two of them touch."""
SPACE = [
    rv.Capsule(((-1.0, -1.0, 0.3), (1.0, 1.5, -0.2)), 0.6),
    rv.Sphere((1.5, -1.0, 0.5), 0.8),
    rv.Sphere((0.0, 0.0, 0.0), 0.9),
]
DISJOINT = rv.ObstacleField((2, 6), overlap=False)
IMPERFECT = rv.Sensing(range=4.0, noise=0.3, bias=0.05, dropout=0.1, delay=2)
CASES = {
    "duo": ("duo", None, {}),
    "plane": ("cloud-8", None, {"dim": 2, "n_robots": 4}),
    "space": ("cloud-8", None, {}),
    "large": ("swarm-20", None, {}),
    "cycle": ("ring-12", None, {}),
    "pursuit": ("pursuit-6", None, {}),
    "unicycles": ("unicycle-6", None, {}),
    "vehicles in space": ("uav-6", None, {"n_robots": 4}),
    "inertia": ("duo", None, {"robot_model": "double_integrator", "n_robots": 4}),
    "inertia in space": ("uav-6", None, {"robot_model": "double_integrator", "n_robots": 4}),
    "star in a box": (
        "duo", None,
        {"n_robots": 4, "graph": "star", "local_frames": "global", "spawn_size": (2.0, 5.0)},
    ),
    "many in space": ("duo", None, {"n_robots": 50, "dim": 3, "spawn_size": 6.0}),
    "two in space": ("duo", "heading", {"dim": 3}),
    "drawn weights": ("duo", None, {"n_robots": 4, "graph": graphs.complete((0.5, 2.0))}),
    "drawn arcs": ("duo", None, {"n_robots": 4, "graph": graphs.directed_cycle((0.5, 2.0))}),
    "uneven arcs": ("duo", None, {"n_robots": 4, "graph": UNEVEN, "on_merge": "follow"}),
    "heading": ("cloud-8", "heading", {"dim": 2, "n_robots": 4}),
    "heading in space": ("cloud-8", "heading", {"n_robots": 4}),
    "heading on a cycle": ("ring-12", "heading", {"local_frames": "global"}),
    "uncertified heading": ("duo", "heading", {"n_robots": 4, "certified": False}),
    "heading with errors": ("duo", "heading", {"frame": "local", "bearing_error": 0.2}),
    "heading of unicycles": ("unicycle-6", "heading", {"n_robots": 4, "max_turn_rate": 2.0}),
    "heading of vehicles": ("uav-6", "heading", {"n_robots": 4}),
    "tank": ("cloud-8", "tank", {"dim": 2, "n_robots": 4, "budget": 2.0}),
    "tank in space": (
        "cloud-8", "tank", {"n_robots": 4, "observe_level": True, "spawn_size": 2.0},
    ),
    "tank with errors": ("clutter-4", "tank", {"bearing_error": 0.1, "budget": 1.0, **LONG}),
    "tank of unicycles": ("unicycle-6", "tank", {"n_robots": 4, "budget": 2.0}),
    "tank of vehicles": ("uav-6", "tank", {"n_robots": 4, "budget": 2.0}),
    "discs": ("clutter-4", None, {"costs": ("contact", "link_lost"), "time_limit": 20.0}),
    "figure": ("fig4", None, LONG),
    "ignored": ("fig3", None, LONG),
    "corridor": ("corridor", None, {**LONG, "obstacle_contact": "stop"}),
    "rooms": ("rooms", None, LONG),
    "all shapes": ("duo", None, {"n_robots": 4, "obstacles": SEAMS, **AMONG, **HIDDEN}),
    "disjoint discs": ("duo", None, {"n_robots": 2, "obstacles": DISJOINT, **AMONG, **GIVEN}),
    "capsules in space": ("duo", None, {"n_robots": 3, "dim": 3, "obstacles": SPACE, **AMONG}),
    "unicycles among discs": ("unicycle-clutter-8", None, LONG),
    "vehicles among spheres": ("uav-clutter-16", None, LONG),
    "inertia among shapes": (
        "duo", None, {"n_robots": 3, "obstacles": PLANE, **INERT, **AMONG},
    ),
    "noise": ("noisy-8", None, {"n_robots": 4, "sensing": IMPERFECT}),
    "noise in space": (
        "clutter-3d", None, {"sensing": rv.Sensing(noise=0.2, bias=0.1, dropout=0.1), **LONG},
    ),
    "view": ("fov-8", None, {"n_robots": 4}),
    "view of discs": (
        "clutter-4", None, {"sensing": rv.Sensing(field_of_view=2.0, noise=0.05), **LONG},
    ),
    "noise on a cycle": ("ring-12", None, {"sensing": rv.Sensing(noise=0.2, dropout=0.2)}),
}  # fmt: skip
SETTINGS = ("certified", "frame", "bearing_error", "budget", "observe_level")
FAST = {"plane"}
OWN_PATH = {
    "large", "vehicles in space", "inertia", "inertia in space", "drawn weights", "uneven arcs",
    "heading in space", "heading of unicycles", "tank", "tank of unicycles", "discs",
    "vehicles among spheres", "noise", "view",
}  # fmt: skip
"""Slow cases; all others are nightly."""
TOUCHING = {"discs", "figure", "corridor", "all shapes"}


def choices(rng, env, observations, guarantee):
    """Actions that bring robots together, with some noise; or random choices of a filter."""
    scenario = env.unwrapped.scenario
    if guarantee is not None:
        return rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
    f = observations[:, :, scenario.observation_layout.neighbours].sum(axis=2)
    noise = 0.1 * rng.standard_normal(f.shape)
    scale = 0.9
    if scenario.model.keeps_velocity:
        f, scale = f - observations[:, :, -1], 1.5
    actions = (scale * f + noise).astype(np.float32)
    return actions[..., : scenario.action_size]


def features(case):
    """Robot model, obstacles, filter and sensor of a case."""
    name, guarantee, changes = CASES[case]
    fields = {key: value for key, value in changes.items() if key not in SETTINGS}
    scenario = rv.scenarios.get(name).replace(**fields)
    sensor, exact = vars(scenario.sensing), vars(rv.Sensing())
    return {
        (scenario.robot_model, scenario.dim),
        (bool(scenario.obstacles), scenario.dim),
        (guarantee, scenario.model.nonholonomic),
        *(name for name in exact if sensor[name] != exact[name]),
    }


def test_every_feature_has_a_case_that_is_not_nightly():
    kept, every = (set().union(*map(features, cases)) for cases in (FAST | OWN_PATH, CASES))
    assert every - kept == set()


@pytest.mark.parametrize("case", marked(CASES, slow=CASES.keys() - FAST, own_path=OWN_PATH))
def test_step_agrees_with_the_engine(case, rj):
    name, guarantee, changes = CASES[case]
    shared = {"num_envs": TEAMS, "autoreset_mode": "SAME_STEP", "time_limit": 2.0, **changes}
    env = rj.make(name, guarantee, final_obs=True, **shared)
    settings = {k: shared.pop(k) for k in SETTINGS if k in shared}
    engine = rv.make_vec(name, **shared)
    if guarantee is not None:
        engine = rv.vector.GuaranteeWrapper(engine, guarantee, **settings)
    expected, _ = engine.reset(seed=SEED)
    observations, state = env.reset(SEED)
    np.testing.assert_allclose(observations, expected, rtol=0, atol=1e-6)
    rng, simulator, ends, merged = np.random.default_rng(1), engine.unwrapped.simulator, 0, 0
    touched = 0
    for step in range(STEPS):
        actions = choices(rng, engine, expected, guarantee)
        expected, rewards, terminations, truncations, infos = engine.step(actions)
        observations, state, reward, terminated, truncated, info = env.step(None, state, actions)
        np.testing.assert_array_equal(terminated, terminations, err_msg=f"step {step}")
        np.testing.assert_array_equal(truncated, truncations)
        np.testing.assert_array_equal(info["merged_into"], infos["merged_into"])
        np.testing.assert_array_equal(info["active"], simulator.active)
        np.testing.assert_array_equal(info["contact"], infos["contact"])
        for key in (key for key in infos if key.startswith("cost")):
            np.testing.assert_array_equal(info[key], infos[key])
        into = np.moveaxis(np.asarray(state.merged_into), -1, 0)
        places = np.moveaxis(np.asarray(state.positions), -1, 0)
        places = np.take_along_axis(places, into[..., None], axis=1)
        np.testing.assert_allclose(places, simulator.positions, rtol=0, atol=1e-9)
        np.testing.assert_allclose(observations, expected, rtol=0, atol=2e-6)
        np.testing.assert_allclose(reward, rewards, rtol=0, atol=1e-9)
        np.testing.assert_allclose(info["robot_rewards"], infos["robot_rewards"], atol=1e-9)
        np.testing.assert_allclose(info["clearance"], infos["clearance"], rtol=0, atol=1e-9)
        if guarantee == "tank":
            levels = np.moveaxis(np.asarray(state.guarantee.levels), -1, 0)
            np.testing.assert_allclose(levels, engine.filter.levels, rtol=0, atol=1e-9)
        touched += int(infos["contact"].sum())
        merged, ended = merged + int((~simulator.active).sum()), terminations | truncations
        ends += int(ended.sum())
        if ended.any():
            last = infos["final_info"]
            for key in ("success", "time", "contacts", "path_length", "lyapunov"):
                np.testing.assert_allclose(
                    np.asarray(info[key])[ended], last[key][ended], rtol=1e-9, atol=1e-9
                )
            final = np.stack(infos["final_obs"][ended])
            np.testing.assert_allclose(np.asarray(info["final_obs"])[ended], final, atol=2e-6)
    assert ends > 0, "no episode ended, so that none began anew"
    apart = name == "duo" or "clutter" in name or (name == "uav-6" and guarantee is not None)
    assert merged > 0 or apart, "nobody merged"
    assert touched > 0 or case not in TOUCHING, "nobody touched an obstacle"
