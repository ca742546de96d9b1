"""What the JAX form does not cover it refuses by name."""

import numpy as np
import pytest

import rendezvous_env as rv


@pytest.mark.parametrize(
    ("field", "scenario", "changes"),
    [
        ("obstacles", "clutter-4", {}),
        ("obstacle_slots", "duo", {"obstacle_slots": 2}),
        ("graph", "tree-12", {}),
        ("graph", "random-10", {}),
        ("graph", "switching-8", {}),
        ("graph", "duo", {"graph": "proximity", "sensing": {"range": 20.0}}),
        ("sensing", "noisy-8", {}),
        ("sensing", "fov-8", {}),
        ("meeting", "robotarium-4", {}),
        ("neighbour_slots", "swarm-20", {"neighbour_slots": 30}),
        ("costs", "duo", {"costs": ("rise",)}),
        ("reward", "duo", {"reward": rv.RewardWeights(clearance_penalty=1.0)}),
        ("guarantee", "unicycle-6", {"guarantee": "heading"}),
        ("guarantee", "duo", {"guarantee": "tank"}),
        ("autoreset_mode", "duo", {"autoreset_mode": "NEXT_STEP"}),
    ],
)
def test_make_refuses_what_it_does_not_cover_by_name(field, scenario, changes, rj):
    if isinstance(changes.get("sensing"), dict):
        changes = changes | {"sensing": rv.Sensing(**changes["sensing"])}
    with pytest.raises(NotImplementedError, match=rf"^{field} is .*: not covered by JAX; "):
        rj.make(scenario, **changes)


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


def test_a_start_without_room_is_not_a_number(rj):
    _, state = rj.make("duo", spawn_size=0.1).reset(0)
    with pytest.raises(RuntimeError, match="room"):
        rv.make_vec("duo", spawn_size=0.1).reset(seed=0)
    assert np.isnan(state.positions).any()
