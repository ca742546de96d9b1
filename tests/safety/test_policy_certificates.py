"""Certificates of policies: of their filters, or of an unknown function."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import baselines

RING = rv.scenarios.resolve("ring-12")


def first_row(observations, time=0.0):
    return observations[..., 0, :]


def test_certificate_of_a_function_names_wrappers_and_the_falsifier():
    found = rv.certificate(RING, policy=first_row)
    assert not found.guaranteed
    assert found.promises == {}
    assert (found.by, found.policy) == ("policy", "first_row")
    for wrapper in ("HeadingVector", "EnergyTank", "Gain", "LinkKeeping"):
        assert f"rendezvous_env.{wrapper}Wrapper (within " in found.theorem
    assert "baselines.HeadingPolicy or baselines.TankPolicy" in found.theorem
    assert "rendezvous verify --policy MODULE:FUNCTION" in found.theorem
    assert str(found).startswith("ring-12 under first_row: none: ")


def test_certificate_of_a_function_names_only_wrappers_that_help():
    directed = rv.Scenario(n_robots=4, graph=rv.graphs.directed_cycle())
    words = rv.certificate(directed, policy=first_row).theorem
    assert "GainWrapper" in words
    assert "HeadingVectorWrapper" not in words
    among = rv.certificate("clutter-8", policy=first_row).theorem
    assert "No wrapper guarantees rendezvous" in among


@pytest.mark.parametrize(
    ("policy", "asked"),
    [
        (baselines.make("bearing-only", RING), {"by": "law"}),
        (baselines.make("link-keeping", RING), {"by": "links", "share": 1.0}),
        (baselines.HeadingPolicy(RING, first_row), {"min_alignment": 0.1}),
        (
            baselines.HeadingPolicy(RING, first_row, min_alignment=0.3, bearing_error=0.01),
            {"min_alignment": 0.3, "bearing_error": 0.01},
        ),
        (
            baselines.TrainedPolicy(RING, lambda seen: seen[:, :2], learning_preset=False),
            {"by": "heading", "min_alignment": 0.1},
        ),
        (
            baselines.TrainedPolicy(
                RING, lambda seen: seen[:, :11], learning_preset=False, guarantee="gains"
            ),
            {"by": "gains"},
        ),
        (
            baselines.TankPolicy(RING, first_row, budget=3.0),
            {"by": "tank", "budget": 3.0},
        ),
        (baselines.make("learned", RING), {"min_alignment": 0.05}),
    ],
)
def test_certificate_of_a_filtered_policy_is_that_of_its_settings(policy, asked):
    found, wanted = rv.certificate(RING, policy=policy), rv.certificate(RING, **asked)
    assert found.guaranteed
    assert found.promises == wanted.promises
    assert found.theorem == wanted.theorem
    assert found.by == wanted.by


def test_certificate_of_a_policy_of_another_scenario_names_fields_and_both_values():
    policy = baselines.HeadingPolicy(RING.replace(merge_radius=0.3, time_limit=9.0), first_row)
    with pytest.raises(ValueError, match="policy is HeadingPolicy") as caught:
        rv.certificate(RING, policy=policy)
    assert "made for 'ring-12'; in 'ring-12' merge_radius is 0.2 instead of 0.3: make the" in str(
        caught.value
    )
    assert "time_limit" not in str(caught.value)
    with pytest.raises(ValueError, match=r"n_robots is 12 instead of 2, graph is .* instead of .*"):
        rv.certificate(RING, policy=baselines.HeadingPolicy("duo", first_row))


def test_certificate_of_a_filter_switched_off_promises_nothing():
    bare = baselines.HeadingPolicy(RING, first_row, certified=False)
    assert not rv.certificate(RING, policy=bare).guaranteed


def test_certificate_of_a_tank_policy_leaves_out_what_needs_merges():
    complete = rv.Scenario(n_robots=5)
    policy = baselines.TankPolicy(complete, first_row)
    found, wrapper = rv.certificate(complete, policy=policy), rv.certificate(complete, by="tank")
    assert found.guaranteed
    assert found.time_bound > wrapper.time_bound
    assert found.lyapunov_bound == wrapper.lyapunov_bound


def test_certificate_needs_the_error_that_the_filter_was_given():
    flawed = rv.Scenario(n_robots=4, sensing=rv.Sensing(error=1e-4))
    untold = baselines.HeadingPolicy(flawed, first_row)
    found = rv.certificate(flawed, policy=untold)
    assert not found.guaranteed
    assert "make it with bearing_error=0.0001" in found.theorem
    told = baselines.HeadingPolicy(flawed, first_row, bearing_error=1e-4)
    assert rv.certificate(flawed, policy=told).guaranteed
    assert rv.certificate(flawed, policy=baselines.make("bearing-only", flawed)).guaranteed


def test_certificate_needs_the_turn_rate_of_robots_that_turn():
    turning = rv.Scenario(n_robots=3, robot_model="unicycle")

    def rates(observations):
        return np.zeros((*observations.shape[:-2], 1))

    assert rv.certificate(turning, policy=baselines.HeadingPolicy(turning, rates)).guaranteed
    slow = baselines.HeadingPolicy(turning, rates, max_turn_rate=0.5)
    found = rv.certificate(turning, policy=slow)
    assert not found.guaranteed
    assert "max_turn_rate=" in found.theorem


def test_certificate_refuses_a_policy_of_another_scenario():
    policy = baselines.make("bearing-only", rv.Scenario(n_robots=4))
    with pytest.raises(ValueError, match="policy is BearingOnly, made for 'custom'; in 'ring-12'"):
        rv.certificate(RING, policy=policy)


def test_certificate_refuses_a_policy_of_other_initial_conditions_in_few_words():
    policy = baselines.make("bearing-only", RING)
    given = RING.replace(start_positions=np.arange(24.0).reshape(12, 2) / 7)
    with pytest.raises(
        ValueError, match=r"start_positions is \(\(0\.0, .*… instead of None"
    ) as caught:
        rv.certificate(given, policy=policy)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("wrong", ["bearing-only", 3])
def test_certificate_refuses_what_is_no_policy(wrong):
    with pytest.raises(TypeError, match=r"policy is .*baselines\.make"):
        rv.certificate(RING, policy=wrong)


@pytest.mark.parametrize(
    "other", [{"by": "heading"}, {"min_alignment": 0.3}, {"bearing_error": 0.1}, {"budget": 1.0}]
)
def test_certificate_refuses_settings_beside_a_policy(other):
    with pytest.raises(ValueError, match=f"{next(iter(other))} is .* with a policy"):
        rv.certificate(RING, policy=first_row, **other)


@pytest.mark.parametrize("name", baselines.names("clutter-8"))
def test_every_policy_has_a_certificate_without_rendezvous_among_obstacles(name):
    policy = baselines.make(name, "clutter-8")
    assert not rv.certificate("clutter-8", policy=policy).guaranteed


def test_the_link_keeping_law_is_what_its_wrapper_does_with_the_whole_share():
    scenario = rv.Scenario(n_robots=4)
    law = baselines.make("link-keeping", scenario)
    wrapped = rv.vector.LinkKeepingWrapper(
        rv.make_vec(scenario, num_envs=3), share=1.0, frame="local"
    )
    wrapped.reset(seed=1)
    simulator = rv.Simulator(scenario, 3)
    own = simulator.reset(1)
    for _ in range(20):
        wrapped.step(np.zeros((3, 4, 2), np.float32))
        own = simulator.step(law(own, simulator.time)).observations
        np.testing.assert_allclose(
            wrapped.unwrapped.simulator.positions, simulator.positions, atol=1e-6
        )
