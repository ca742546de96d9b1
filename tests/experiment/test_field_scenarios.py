"""Scenarios of the field: the originals' numbers, and that a comparison takes them on request."""

import math

import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env import scenarios
from train.comparing.plan import DEFAULT_SCENARIOS

FIELD = (
    "noisy-8", "fov-8", "occluded-8", "huettenrauch-20", "huettenrauch-20-sight-40",
)  # fmt: skip


def test_a_comparison_takes_them_on_request_only():
    assert set(FIELD) <= set(scenarios.names())
    assert not set(FIELD) & set(DEFAULT_SCENARIOS)


def test_the_numbers_of_huettenrauch_and_others():
    for name, sight in (("huettenrauch-20", None), ("huettenrauch-20-sight-40", 40.0)):
        scenario = scenarios.get(name)
        assert (scenario.n_robots, scenario.robot_model) == (20, "unicycle")
        assert scenario.max_steps == 1024 and scenario.tau == 0.1
        assert scenario.action_bounds.tolist() == [10.0, math.pi]
        assert scenario.spawn_size == 0.9 * 100 and scenario.sensing.range == sight


def test_a_narrow_view_is_no_hindrance_to_who_searches():
    scenario = scenarios.get("fov-8")
    met = {
        name: rv.rollout(scenario, baselines.make(name, scenario), 0, num_envs=20).success.mean()
        for name in ("unicycle", "pursuit")
    }
    assert met["pursuit"] >= 0.9 and met["unicycle"] <= 0.3


@pytest.mark.parametrize("law", ["bearing-only", "unit-mean", "quantised"])
def test_noise_is_borne(law):
    scenario = scenarios.get("noisy-8")
    assert rv.rollout(scenario, baselines.make(law, scenario), 0, num_envs=20).success.all()


def test_what_hides_and_blocks_is_passed_by_who_knows_the_map():
    scenario = scenarios.get("occluded-8")
    planner = baselines.make("privileged-planner", scenario)
    law = baselines.make("bearing-only", scenario)
    assert rv.rollout(scenario, planner, 0, num_envs=20).success.all()
    assert rv.rollout(scenario, law, 0, num_envs=20).success.mean() < 0.9
