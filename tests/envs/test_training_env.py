"""Training environments: observations, actions, rewards and infos of generic learners."""

import dataclasses

import numpy as np
import pytest
from guarantees import draw
from gymnasium.vector import AutoresetMode

import baselines
import rendezvous_env as rv
from baselines.learned.policy_settings import ALL_ROUND, ANGLES
from baselines.learned.shipped import preset
from rendezvous_env.rewards.custom_terms import TERMS
from train.learn.settings import Config

HEAVY = rv.Scenario(robot_model="double_integrator")
SCENARIO = rv.scenarios.get("clutter-8").replace(time_limit=6.0)
FORMS = {
    "preset": {},
    "discrete": {"discrete": True},
    "tank": {"guarantee": "tank"},
    "tank, discrete": {"guarantee": "tank", "discrete": True},
    "gains": {"guarantee": "gains"},
    "links": {"guarantee": "links"},
    "bare": {"guarantee": None},
    "plain": {"learning_preset": False},
    "tables": {"learning_preset": False, "flatten": False},
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_parallel_training_env_equals_vector_form(form):
    mode = AutoresetMode.DISABLED
    teams = rv.vector.training_env(SCENARIO, 3, autoreset_mode=mode, **form)
    env = rv.training_env(SCENARIO, **form)
    table, _ = teams.reset(seed=4)
    seen, infos = env.reset(seed=5)
    keys, steps, random = set(infos["robot_0"]), 0, np.random.default_rng(0)
    while env.agents:
        np.testing.assert_array_equal(np.stack(list(seen.values())), table[1])
        actions = draw(teams, random)
        table, rewards, ends, cuts, told = teams.step(actions)
        by_name = dict(zip(env.agents, actions[1], strict=True))
        seen, earned, _, _, infos = env.step(by_name)
        assert env.observation_space("robot_0").contains(seen["robot_0"])
        assert list(earned.values()) == told["robot_rewards"][1].tolist()
        assert rewards[1] == pytest.approx(np.mean(list(earned.values())), abs=1e-15)
        for i, info in enumerate(infos.values()):
            assert set(info) == keys and all(np.isscalar(value) for value in info.values())
            assert info["merged_into"] == told["merged_into"][1, i]
            assert info["time"] == told["time"][1]
        steps += 1
    assert (ends | cuts)[1] and steps > 5


def test_agent_set_is_fixed_and_merged_agents_idle():
    env = rv.training_env("duo", guarantee=None, n_robots=3, time_limit=20.0)
    law = baselines.make("bearing-only", env.scenario)
    seen, infos = env.reset(seed=1)
    gone = set()
    while env.agents:
        assert env.agents == env.possible_agents
        rows = np.stack(list(seen.values())).reshape(1, 3, *env.scenario.observation_layout.shape)
        actions = law(rows, 0.0)[0]
        for name in gone:
            assert not seen[name].any()
            actions[env.possible_agents.index(name)] = env.action_space(name).high
        seen, rewards, ends, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
        assert len(set(rewards.values())) == 1
        gone = {name for name, info in infos.items() if not info["active"]}
    assert all(ends.values()) and len(gone) == 2 and infos["robot_0"]["success"]


def test_preset_equals_train_defaults():
    config = Config(hidden=(128, 128))
    for guarantee in ("heading", "tank"):
        found = preset(guarantee)
        assert found.reward == config.base_scenario().reward
        assert found.contact_penalty == config.contact_penalty
        assert found.settings.decision_time == pytest.approx(0.6)
    assert preset("heading").settings == config.policy_settings()
    assert preset(None) == preset("heading")
    env = rv.training_env(SCENARIO)
    assert env.scenario.reward == config.base_scenario().reward


@pytest.mark.parametrize("field", ["clutter-8", "unicycle-clutter-8", "uav-clutter-16"])
def test_preset_has_energy_budget_of_robot_model(field):
    shipped = baselines.make("learned-tank", field).settings
    teams = rv.vector.training_env(field, 2, guarantee="tank")
    teams.reset(seed=0)
    assert teams.env.settings == shipped
    assert shipped.budget == pytest.approx((1 if field == "clutter-8" else 2) * 100 / 3)
    np.testing.assert_allclose(teams.env.controller.tank.normalised_levels, shipped.budget)
    everyone, own = preset("tank"), preset("tank", rv.scenarios.get(field))
    assert own.reward == everyone.reward and own.contact_penalty == everyone.contact_penalty


@pytest.mark.parametrize(("guarantee", "angles"), [("heading", ANGLES), ("tank", ALL_ROUND)])
def test_direction_action_equals_its_angle(guarantee, angles):
    """Directions of any length; zero is the unmodified rule."""
    mode = {"guarantee": guarantee, "autoreset_mode": AutoresetMode.DISABLED}
    chosen = rv.vector.training_env(SCENARIO, 6, discrete=True, **mode)
    headed = rv.vector.training_env(SCENARIO, 6, **mode)
    np.testing.assert_array_equal(chosen.reset(seed=7)[0], headed.reset(seed=7)[0])
    random = np.random.default_rng(3)
    for _ in range(8):
        indices = random.integers(len(angles), size=(6, 4))
        vectors = np.stack((np.cos(angles), np.sin(angles)), axis=-1)[indices]
        vectors = vectors * random.uniform(0.1, 0.9, (6, 4, 1)) * (indices != 0)[..., None]
        seen, *_ = chosen.step(indices)
        other, *_ = headed.step(vectors)
        np.testing.assert_allclose(other, seen, atol=2e-5)


def test_models_without_policy_use_wrapper_spaces():
    links = rv.training_env("cloud-8", guarantee="links")
    plain = rv.training_env("cloud-8", guarantee="links", learning_preset=False)
    assert links.observation_space("robot_0") == plain.observation_space("robot_0")
    assert links.vector_env.env.decision_period == round(0.6 / links.scenario.tau)
    assert plain.vector_env.env.decision_period == 1 and plain.vector_env.contact_penalty == 0.0
    assert (
        links.vector_env.contact_penalty == 1.0 and links.scenario.reward != plain.scenario.reward
    )


@pytest.mark.parametrize("name", ["cloud-8", "uav-clutter-16"])
@pytest.mark.parametrize("guarantee", ["heading", "tank"])
def test_robots_in_3d_observe_and_act_in_plane(name, guarantee):
    env = rv.training_env(name, guarantee=guarantee, max_cycles=30)
    choices = rv.training_env(name, guarantee=guarantee, discrete=True)
    assert choices.action_space("robot_0").n == (9 if guarantee == "heading" else 14)
    shown, _ = env.reset(seed=0)
    while env.agents:
        shown, *_ = env.step({name: [-1.0, 0.5] for name in env.agents})
        parts = env.vector_env.layout.split(np.stack(list(shown.values())))
        ahead = (parts.neighbours[..., 2] * parts.neighbours[..., 0]).sum(axis=-1)
        aside = (parts.neighbours[..., 2] * parts.neighbours[..., 1]).sum(axis=-1)
        np.testing.assert_allclose(np.minimum(ahead, 2.0), parts.context[:, 1], atol=1e-5)
        np.testing.assert_allclose(aside, 0.0, atol=1e-5)


def test_overrides_reach_wrapper_preset_and_scenario():
    env = rv.training_env(
        "clutter-8", min_alignment=0.3, n_robots=3, max_cycles=7, decision_period=5
    )
    assert env.vector_env.env.decision_period == 5
    env.reset(seed=0)
    while env.agents:
        *_, infos = env.step({name: [-1.0, 0.0] for name in env.agents})
        assert min(info["alignment"] for info in infos.values()) > 0.29
    assert len(env.possible_agents) == 3 and env.simulator.max_steps == 7
    own = rv.RewardWeights(progress=2.0)
    assert rv.training_env("clutter-8", reward=own).scenario.reward == own
    kept = rv.training_env(SCENARIO.replace(reward=own))
    assert kept.scenario.reward == own
    gains = rv.training_env("clutter-8", guarantee="gains", max_gain=0.7, frame="local")
    assert not gains.vector_env.env.gains.along_net_bearing


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"min_aligment": 0.1}, TypeError, "did you mean 'min_alignment'"),
        ({"n_robot": 3}, TypeError, "did you mean 'n_robots'"),
        ({"flaten": True}, TypeError, "did you mean 'flatten'"),
        ({"budget": 1.0}, TypeError, "no argument 'budget'"),
        ({"guarantee": "headings"}, ValueError, "guarantee is 'headings'; it must be one of"),
        ({"on_merge": "remove"}, ValueError, "on_merge is 'remove'; it must be 'follow'"),
        ({"flatten": False}, ValueError, "flatten is False.*learning_preset"),
        ({"learning_preset": False, "discrete": True}, ValueError, "discrete is True"),
        ({"guarantee": "gains", "discrete": True}, ValueError, "discrete is True"),
        ({"frame": "local"}, ValueError, "frame is 'local'.*learning_preset=False"),
        ({"learning_preset": 1}, ValueError, "learning_preset is 1"),
        ({"contact_penalty": "no"}, ValueError, "contact_penalty is 'no'"),
        ({"scenario": HEAVY, "guarantee": None, "discrete": True}, ValueError, "discrete is True"),
    ],
)
def test_invalid_arguments_are_rejected(arguments, error, message):
    with pytest.raises(error, match=message):
        rv.training_env(**({"scenario": SCENARIO} | arguments))


def test_layout_splits_observation():
    plain = {"guarantee": "tank", "budget": 1.0, "learning_preset": False, "flatten": False}
    teams = rv.vector.training_env(SCENARIO, 2, observe_level=True, **plain)
    shown, _ = teams.reset(seed=0)
    np.testing.assert_allclose(shown[..., -1, 0], 1.0 / 0.6)  # in units of r D̄
    without = rv.vector.training_env(SCENARIO, 2, **plain)
    expected = without.layout.split(without.reset(seed=0)[0])
    for found, wanted in zip(teams.layout.split(shown[..., :-1, :])[:2], expected, strict=False):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("make", [rv.training_env, rv.vector.training_env])
@pytest.mark.parametrize("guarantee", ["heading", "tank", "gains", None])
def test_reward_terms_of_ones_own_are_merged_with_the_preset(make, guarantee, caplog, monkeypatch):
    rv.reward_term("merged with a preset", lambda step: np.zeros(len(step.time)))
    try:
        custom = {"merged with a preset": -0.001}
        preset = make("clutter-8", guarantee=guarantee).scenario.reward
        assert preset.progress == 0.5 and preset.collision_penalty == 0.0  # not the defaults
        expected = dataclasses.replace(preset, custom=custom)
        caplog.set_level("INFO", "rendezvous_env")
        monkeypatch.setattr("rendezvous_env.envs.training._logged", set())
        in_scenario = {"scenario": SCENARIO.replace(reward=rv.RewardWeights(custom=custom))}
        for how in (
            {"reward": rv.RewardWeights(custom=custom)}, {"reward": {"custom": custom}},
            in_scenario,
        ):  # fmt: skip
            env = make(**{"scenario": SCENARIO, "guarantee": guarantee} | how)
            assert env.scenario.reward == expected
            assert getattr(env, "vector_env", env).unwrapped.scenario.reward == expected
        assert f"reward in use: {expected.to_plain()}, contact_penalty 1" in caplog.text
        one = make(SCENARIO, guarantee=guarantee, reward={"time_penalty": 0.3}).scenario.reward
        assert one == dataclasses.replace(preset, time_penalty=0.3)
        same = {"progress": 1.0}  # what is told is in force, though it is the default
        assert make(SCENARIO, guarantee=guarantee, reward=same).scenario.reward.progress == 1.0
        whole = rv.RewardWeights(collision_penalty=0.2, custom=custom)
        assert make(SCENARIO, guarantee=guarantee, reward=whole).scenario.reward == whole
        bare = make(SCENARIO, learning_preset=False, reward=rv.RewardWeights(custom=custom))
        assert bare.scenario.reward == rv.RewardWeights(custom=custom)
    finally:
        TERMS.pop("merged with a preset")


def test_return_under_a_preset_does_not_change_with_a_term_of_weight_zero():
    rv.reward_term("of no weight", lambda step: np.ones(len(step.time)))
    try:

        def earned(**more):
            env = rv.vector.training_env("clutter-8", 8, time_limit=3.0, **more)
            env.reset(seed=0)
            ahead = np.ones(env.action_space.shape, np.float32)
            return np.array([env.step(ahead)[1] for _ in range(5)])

        custom = {"of no weight": 0.0}
        np.testing.assert_array_equal(earned(reward=rv.RewardWeights(custom=custom)), earned())
    finally:
        TERMS.pop("of no weight")
