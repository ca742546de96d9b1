"""Named scenarios have versions, and stay what their versions were."""

import json

import gymnasium
import numpy as np
import pettingzoo
import pytest

import rendezvous_env as rv
from rendezvous_env import scenarios
from rendezvous_env.first_starts import digest
from rendezvous_env.scenario.scenarios import digests, versioned
from train.compare.settings import DEFAULT_SCENARIOS

FIELD = (
    "noisy-8", "fov-8", "occluded-8", "range-12", "switching-8", "pursuit-6", "rssdoa-15",
    "huettenrauch-20", "huettenrauch-20-sight-40", "robotarium-4", "robotarium-10", "robotarium-20",
)  # fmt: skip
QUICK = ("clutter-8", "clutter-16")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow])
        for name in scenarios.names()
    ],
)
def test_a_field_is_what_its_version_was(name):
    kept = versioned(name).removeprefix("rendezvous/")
    found = digest(name)
    assert found == digests()[kept], (
        f"the field {name} or its first 1,000 starts have changed, so results on it do not compare "
        f"with those of {kept} any more: raise its version in scenario/digests.json; its digest is "
        f"{found}. If nothing was meant to change, find out what did."
    )


def test_every_scenario_has_one_version():
    assert [entry.rpartition("-v")[0] for entry in digests()] == scenarios.names()
    assert len(set(digests().values())) == len(digests())
    assert all(json.dumps(entry).isascii() for entry in digests())


def test_a_digest_sees_starts_and_physics_and_not_what_learners_are_told():
    base = rv.scenarios.get("duo")
    same = base.replace(name="other", costs="contact", reward=rv.RewardWeights(progress=2.0))
    assert digest(same) == digest(base) == digests()["duo-v1"]
    others = [base.replace(merge_radius=0.21), base.replace(spawn_size=9.0)]
    assert len({digest(base), *map(digest, others)}) == 3


@pytest.mark.parametrize(
    "name", ["clutter-16-v1", "rendezvous/clutter-16-v1", "rendezvous/clutter-16"]
)
def test_a_name_may_have_its_version(name):
    assert scenarios.get(name) == scenarios.get("clutter-16")
    env, plain = rv.make_vec(name, 2), rv.make_vec("clutter-16", 2)
    np.testing.assert_array_equal(env.reset(seed=5)[0], plain.reset(seed=5)[0])


def test_other_versions_and_names_are_refused():
    for call, name, said in (
        (scenarios.get, "clutter-16-v2", "is of another version; .* rendezvous/clutter-16-v1"),
        (scenarios.get, "rendezvous/cluter-16-v1", "is unknown; did you mean 'clutter-16"),
        (scenarios.get, "bluster-v1", "is unknown"),
        (versioned, "nothing", "it must be one of"),
    ):
        with pytest.raises(ValueError, match=f"'{name}'.* {said}"):
            call(name)


def test_gymnasium_and_pettingzoo_know_every_field():
    for name in scenarios.names():
        assert versioned(name) in gymnasium.registry
    one = gymnasium.make("rendezvous_env:rendezvous/clutter-8-v1", obstacle_range=1.5)
    assert one.unwrapped.scenario == scenarios.get("clutter-8").replace(obstacle_range=1.5)
    many = gymnasium.make_vec("rendezvous_env:rendezvous/clutter-8-v1", num_envs=3)
    assert many.unwrapped.scenario.name == "clutter-8" and many.num_envs == 3
    if hasattr(pettingzoo, "make"):
        named = pettingzoo.make("parallel", "rendezvous/clutter-8-v1")
        assert named.unwrapped.scenario == scenarios.get("clutter-8")


def test_a_comparison_takes_fields_of_others_on_request_only():
    assert set(FIELD) <= set(scenarios.names()) and not set(FIELD) & set(DEFAULT_SCENARIOS)
