"""What the JAX form does not cover it refuses by name."""

import numpy as np
import pytest

import rendezvous_env as rv


@pytest.mark.parametrize(
    ("field", "scenario", "changes"),
    [
        ("obstacles", "clutter-32", {}),
        ("obstacles", "clutter-3d-32", {}),
        ("obstacle_slots", "clutter-4", {"obstacle_slots": 2, "obstacle_overflow": "nearest"}),
        (
            "differentiable",
            "clutter-4",
            {"differentiable": True, "robot_model": "double_integrator"},
        ),
        ("graph", "tree-12", {}),
        ("graph", "random-10", {}),
        ("graph", "switching-8", {}),
        ("graph", "duo", {"graph": "proximity", "sensing": {"range": 20.0}}),
        ("sensing", "occluded-8", {}),
        ("meeting", "robotarium-4", {}),
        ("neighbour_slots", "swarm-20", {"neighbour_slots": 30}),
        ("costs", "duo", {"costs": ("rise",)}),
        ("events", "duo", {"events": {"slip": 0.1}}),
        ("activation", "duo", {"activation": "random"}),
        ("obstacles", "crossing-traffic-8", {}),
        ("robot_model", "mixed-8", {}),
        ("max_speed", "duo", {"max_speed": (1.0, 2.0)}),
        ("guarantee", "duo", {"guarantee": "gains"}),
        ("guarantee", "duo", {"guarantee": "links"}),
        ("autoreset_mode", "duo", {"autoreset_mode": "NEXT_STEP"}),
    ],
)
def test_make_refuses_what_it_does_not_cover_by_name(field, scenario, changes, rj):
    if isinstance(changes.get("sensing"), dict):
        changes = changes | {"sensing": rv.Sensing(**changes["sensing"])}
    with pytest.raises(NotImplementedError, match=rf"^{field} is .*: not covered by JAX; use "):
        rj.make(scenario, **changes)


@pytest.mark.parametrize(
    "fields",
    [
        {"view_falloff": 0.1},
        {"noise": (0.1, 0.2), "noise_correlation": 1.0},
        {"error": 0.1},
        {"sectors": 8},
        {"occlusion": "robots"},
        {"min_range": 0.3},
        {"sample_period": 0.5},
        {"observer_bias": 0.1},
        {"detection": ((1.0, 0.5),), "persistence": 1.0},
        {"outliers": 0.1, "outlier_kind": "robot"},
        {"bias": (0.1, 0.2), "delay": (0, 2)},
        {"detection": ((), ((1.0, 0.5),)), "persistence": (0.0, 0.3)},
    ],
    ids=lambda fields: " ".join(fields),
)
def test_make_names_the_sensor_imperfections_that_it_rejects(fields, rj):
    covered = {"field_of_view": 2.0, "dropout": 0.2, "delay": 1, "bias": 0.3}
    covered = {name: value for name, value in covered.items() if name not in fields}
    with pytest.raises(NotImplementedError, match="make_vec") as error:
        rj.make("duo", sensing=rv.Sensing(**covered, **fields))
    assert all(f"{field} = {value}" in str(error.value) for field, value in fields.items())
    shown = [f"{field} = {value}" for field, value in covered.items()]
    assert not any(text in str(error.value) for text in shown)


def test_make_rejects_only_fields_that_have_an_effect(rj):
    changes = {"obstacles": [], "merge_through_obstacles": False, "obstacle_overflow": "nearest"}
    assert rj.make("duo", **changes).scenario.merges_through
    assert rj.make("duo", **changes, obstacle_slots=2).single_observation_space.shape == (2, 5, 2)


@pytest.mark.parametrize("seed", [None, [1, None], -1, 1.5, "7", True, [1, -2], [1, 2, 3]])
def test_reset_rejects_invalid_seeds_by_name(seed, rj):
    with pytest.raises(ValueError, match=r"^seed (is|has) .*; it must be "):
        rj.make("duo", num_envs=2).reset(seed)


@pytest.mark.slow
def test_reset_folds_large_seeds_as_the_engine_does(rj):
    engine = rv.make_vec("duo", num_envs=2)
    engine.reset(seed=2**70 + 3)
    _, state = rj.make("duo", num_envs=2).reset(2**70 + 3)
    places = np.moveaxis(np.asarray(state.positions), -1, 0)
    np.testing.assert_allclose(places, engine.simulator.positions, rtol=0, atol=1e-12)


def test_step_rejects_invalid_actions_by_name(rj):
    env = rj.make("duo")
    _, state = env.reset(0)
    for action in ("x", None, np.zeros((2, 2), complex), np.zeros((2, 2), object), np.zeros(2)):
        with pytest.raises(ValueError, match=r"^action (is|has) .*; it must be "):
            env.step(None, state, action)


@pytest.mark.slow
def test_make_refuses_bad_input_as_elsewhere(rj):
    with pytest.raises(TypeError, match="time_limit"):
        rj.make("duo", time_limits=3.0)
    with pytest.raises(ValueError, match="guarantee is 'headings'; it must be one of"):
        rj.make("duo", "headings")
    with pytest.raises(ValueError, match="num_envs is 0"):
        rj.make("duo", num_envs=0)
    with pytest.raises(ValueError, match="min_alignment is 2"):
        rj.make("duo", "heading", min_alignment=2.0)
    env = rj.make("duo", num_envs=3)
    with pytest.raises(ValueError, match="seed is -1"):
        env.reset(-1)
    _, state = env.reset(0)
    with pytest.raises(ValueError, match=r"action has shape \(2, 2\); it must be \(3, 2, 2\)"):
        env.step(None, state, np.zeros((2, 2)))


@pytest.mark.slow
def test_a_start_without_room_is_not_a_number(rj):
    _, state = rj.make("duo", spawn_size=0.1).reset(0)
    with pytest.raises(RuntimeError, match="room"):
        rv.make_vec("duo", spawn_size=0.1).reset(seed=0)
    assert np.isnan(state.positions).any()
