"""Scenarios of the field: the originals' numbers, and that a comparison takes them on request."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env import graphs, scenarios
from train.compare.settings import DEFAULT_SCENARIOS

FIELD = (
    "noisy-8", "fov-8", "occluded-8", "range-12", "switching-8", "pursuit-6", "rssdoa-15",
    "huettenrauch-20", "huettenrauch-20-sight-40", "robotarium-4", "robotarium-10", "robotarium-20",
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


@pytest.mark.parametrize("n", [4, 10, 20])
def test_the_numbers_of_the_robotarium(n):
    scenario = scenarios.get(f"robotarium-{n}")
    assert (scenario.n_robots, scenario.tau, scenario.speed_limit) == (n, 0.033, 0.2)
    assert scenario.spawn_size < 2.0 and 2 * scenario.body_radius > 0.135
    assert scenario.max_degree == pytest.approx(0.2) and scenario.merge_radius == 0.17
    assert scenario.tau < scenario.certified_step


def test_the_numbers_of_rssdoa():
    scenario = scenarios.get("rssdoa-15")
    assert scenario.n_robots == 15 and scenario.sensing_graph == graphs.proximity()
    assert scenario.max_steps == 1000 and scenario.tau == 0.033
    assert (scenario.speed_limit, scenario.merge_radius) == (0.075, 0.1)
    assert (scenario.sensing.range, scenario.sensing.noise) == (0.8, 0.1)


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


class TestOnGraphsThatChange:
    def met(self, name, law, num_envs=10):
        scenario = scenarios.get(name)
        return rv.rollout(scenario, baselines.make(law, scenario), 0, num_envs=num_envs)

    @pytest.mark.parametrize("law", ["bearing-only", "cyclic-pursuit"])
    def test_pursuers_meet_in_a_cycle(self, law):
        assert self.met("pursuit-6", law).success.all()

    @pytest.mark.parametrize("law", ["bearing-only", "cyclic-pursuit"])
    def test_all_meet_though_graphs_take_turns(self, law):
        assert self.met("switching-8", law).success.all()

    def test_starts_of_limited_range_are_connected_by_short_links(self):
        scenario = scenarios.get("range-12")
        simulator = rv.Simulator(scenario, 10)
        simulator.reset(0)
        reach = 4.0 - 11 * 0.2 / 2
        for positions in simulator.positions:
            near = np.linalg.norm(positions[None] - positions[:, None], axis=-1) <= reach
            assert np.linalg.matrix_power(near.astype(float), 12).all()

    def test_the_smallest_sector_keeps_links_of_limited_range(self):
        assert self.met("range-12", "smallest-sector").success.all()
