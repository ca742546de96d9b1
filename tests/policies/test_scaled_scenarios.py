"""Invariance of policies to a common scale of lengths and speeds."""

from dataclasses import replace

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.learned.shipped import preset
from rendezvous_env.limits import LARGEST

CLUTTER = rv.scenarios.get("clutter-8").replace(time_limit=30.0)


def times_larger(u):
    field = CLUTTER.obstacles
    lengths = {name: u * getattr(field, name) for name in ("region", "keep_out", "passage")}
    radius = tuple(u * r for r in field.radius)
    return CLUTTER.replace(
        merge_radius=u * CLUTTER.merge_radius,
        spawn_size=u * CLUTTER.spawn_size,
        obstacle_range=u * CLUTTER.obstacle_range,
        max_speed=u * CLUTTER.speed_limit,
        graph=rv.graphs.complete(u),
        obstacles=replace(field, radius=radius, **lengths),
    )


@pytest.mark.parametrize("policy", ["privileged-planner", "tank-merged"])
@pytest.mark.parametrize("u", [2.0**-13, 2.0**10])
def test_policies_are_scale_invariant(policy, u):
    """A power of two is exact; formerly lengths and budgets were absolute."""
    found = [
        rv.rollout(scenario, baselines.make(policy, scenario), 0, num_envs=20)
        for scenario in (CLUTTER, times_larger(u))
    ]
    assert found[0].success.all() and not found[0].contacts.any()
    for name in ("rendezvous_time", "contacts"):
        np.testing.assert_array_equal(getattr(found[1], name), getattr(found[0], name))
    np.testing.assert_allclose(found[1].positions, u * found[0].positions, rtol=1e-3, atol=1e-3 * u)


@pytest.mark.parametrize("policy", ["tank-merged", "learned-tank"])
def test_default_budget_is_within_limit(policy):
    world = times_larger(1e6)
    assert preset("tank").settings.budget_of(world) == LARGEST
    found = rv.rollout(world, baselines.make(policy, world), 0, num_envs=2)
    assert np.isfinite(found.positions).all()
