"""A custom law and law (1) on the same initial conditions."""

import numpy as np

import baselines
import rendezvous_env as rv

scenario = rv.scenarios.get("ring-12")
rows = scenario.observation_layout.neighbours


def full_speed(observations, time):
    """Move along the net bearing at the speed limit."""
    f = observations[..., rows, :].sum(axis=-2)
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    return scenario.speed_limit * f / np.maximum(length, 1e-6)


for name, law in (
    ("law (1)", baselines.make("bearing-only", scenario)),
    ("full speed along f", full_speed),
):
    result = rv.rollout(scenario, law, seed=0, num_envs=50)
    print(
        f"{name}: {result.success.mean():.0%} met, "
        f"largest rise of V between merges {result.largest_rise_between_merges.max():.1e} m²/s"
    )
