"""Recurrent policies: equality of rollout, update and inference."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import rendezvous_env as rv
from baselines.learned.learned_policy import LearnedPolicy
from baselines.learned.numpy_actor import NumpyActor
from baselines.learned.policy_settings import PolicySettings, memory_of
from train.learn.recurrent import Sequences
from train.learn.settings import Config
from train.learn.trainer import Trainer

TEAMS, STEPS, UNITS = 8, 20, 8
CONFIG = Config(
    scenario="clutter-12", set=("time_limit=1.5",), guarantee="tank", budget=2.0, prior=3.0,
    set_width=8, hidden=(16,), clearance=0.1, min_alignment=0.1, max_turn_rate=3.0, seed=5,
    memory="recurrent", memory_units=UNITS, decision_period=1, num_envs=TEAMS, epochs=1,
)  # fmt: skip
SCENARIO, SETTINGS = CONFIG.plain_scenario(), CONFIG.policy_settings()


def model(steps=STEPS):
    """PPO on environments that end within one or two rollouts."""
    made = Trainer(replace(CONFIG, n_steps=steps, batch_size=4 * steps)).model
    made.train = lambda: None
    with torch.no_grad():
        torch.nn.init.normal_(made.policy.action_net.weight, std=0.3)
    return made


@pytest.fixture(scope="module")
def collected():
    """A model after its second rollout, without an update.

    Also returns the numbers of robots' episode ends, and of merges, in each step.
    """
    made, seen = model(), []
    robots = made.get_env()

    def see(*_):
        seen.append((robots.ended.sum(), (robots.survivors != robots.bootstrapped).sum()))
        return True

    made.learn(2 * STEPS * made.n_envs, callback=see)
    return made, np.array(seen)


def test_evaluation_reproduces_rollout(collected):
    """The ratio of the first pass is one, over resets, merges and rollout boundaries."""
    made, seen = collected
    ended, merged = seen[STEPS:].sum(axis=0)
    assert ended > TEAMS and merged > 0
    buffer, samples = made.rollout_buffer, 0
    kept = buffer.mask.copy()
    for batch in buffer.get(4 * STEPS):
        assert (batch.observations.hidden != 0).any()
        preferences, values = made.policy.judged(batch.observations)
        actions = batch.actions.long()
        log_prob = preferences.log_softmax(dim=-1).gather(-1, actions)[:, 0]
        torch.testing.assert_close(log_prob, batch.old_log_prob, atol=2e-5, rtol=0)
        torch.testing.assert_close(values.flatten(), batch.old_values, atol=2e-5, rtol=0)
        samples += len(actions)
    assert samples == kept.sum() < kept.size


def test_merged_robot_has_no_memory(collected):
    made, _ = collected
    policy, seen = made.policy, torch.as_tensor(made._last_obs).clone()
    policy.hidden = torch.ones_like(policy.hidden)
    seen[::2] = 0.0
    with torch.no_grad():
        policy(seen)
    assert not policy.hidden[::2].any() and policy.hidden[1::2].any(dim=-1).all()


@pytest.mark.slow
def test_merged_robot_is_valued_by_survivor(monkeypatch):
    """The value uses the survivor's observation, and its hidden state before the reset."""
    made, told, merges = model(steps=2), [], 0
    robots, real = made.get_env(), made.policy.predict_values

    def predict_values(seen, hidden=None):
        if hidden is not None:
            told.append((seen, hidden, made.policy.hidden))
        return real(seen, hidden)

    monkeypatch.setattr(made.policy, "predict_values", predict_values)
    for _ in range(240):
        made.learn(2 * made.n_envs, reset_num_timesteps=False)
        if robots.bootstrapped.size:
            seen, hidden, all_hidden = told.pop()
            np.testing.assert_array_equal(hidden, all_hidden[robots.survivors])
            running = ~robots.ended[robots.survivors]
            np.testing.assert_array_equal(seen[running], made._last_obs[robots.survivors[running]])
            merges += int(running.sum())
            assert hidden.any(dim=-1).all()
    assert merges >= 2


def test_deployed_policy_matches_training():
    """Bitwise over several episodes: choices, motion, and resets of memory."""
    made = model()
    policy, robots = made.policy, made.get_env()
    served = rv.make_vec(SCENARIO, TEAMS, autoreset_mode=AutoresetMode.SAME_STEP)
    arrays = {name: value.numpy() for name, value in policy.state_dict().items()}
    ours = LearnedPolicy(SCENARIO, arrays, SETTINGS)
    robots.seed(2)
    shown, (observations, _), ends = robots.reset(), served.reset(seed=2), 0
    for _ in range(70):
        with torch.no_grad():
            choices, *_ = policy(torch.as_tensor(shown), deterministic=True)
        shown, *_ = robots.step(np.where(shown.any(axis=-1), choices, 0))
        policy.forget(torch.as_tensor(robots.ended))
        actions = ours(observations, 0.0)
        hidden = ours._hidden.reshape(-1, UNITS).copy()
        observations, _, met, cut, _ = served.step(actions)
        np.testing.assert_array_equal(observations, robots.vector_env._observed)
        over = np.repeat(met | cut, SCENARIO.n_robots)
        same = ~over & observations.any(axis=(-1, -2)).reshape(-1)
        np.testing.assert_allclose(hidden[same], policy.hidden[same], atol=1e-5)
        ours.reset(met | cut)
        assert hidden.any() and not ours._hidden[met | cut].any()
        ends += (met | cut).sum()
    assert ends >= 2 * TEAMS


def test_memory_changes_decisions(collected):
    """Equal observations with another memory give another distribution, in torch and NumPy."""
    made, _ = collected
    seen = torch.as_tensor(made._last_obs)
    seen = seen[seen.any(dim=-1)]
    hidden = torch.randn(len(seen), UNITS)
    arrays = {name: value.numpy() for name, value in made.policy.state_dict().items()}
    layout = made.get_env().vector_env.layout
    ours, after = NumpyActor(arrays, SETTINGS, layout), hidden.numpy().copy()
    found = [ours.preferences(seen.numpy(), after), ours.preferences(seen.numpy())]
    for before, preferences in zip((hidden, torch.zeros_like(hidden)), found, strict=True):
        once = torch.zeros(1, len(seen)), before, torch.ones(1, len(seen), dtype=torch.bool)
        with torch.no_grad():
            theirs, _ = made.policy.judged(Sequences(seen[None], *once))
        np.testing.assert_allclose(preferences, theirs, atol=2e-5)
    assert np.abs(found[0] - found[1]).max() > 0.01
    assert not np.array_equal(after, hidden.numpy())
    with pytest.raises(ValueError, match=r"weights have no 'memory\.weight_ih'"):
        NumpyActor({k: v for k, v in arrays.items() if "memory" not in k}, SETTINGS, layout)
    with pytest.raises(ValueError, match=r"size mismatch: memory\.weight_ih"):
        NumpyActor(arrays, replace(SETTINGS, memory_units=UNITS + 1), layout)


def test_restored_memory_must_fit(collected):
    made, _ = collected
    kept = made.get_memory()["hidden"].copy()
    made.set_memory({"hidden": kept + 1.0})
    for wrong in (kept[1:], np.full_like(kept, np.nan)):
        with pytest.raises(ValueError, match="hidden has shape"):
            made.set_memory({"hidden": wrong})
    np.testing.assert_array_equal(made.policy.hidden, kept + 1.0)


def test_kind_of_memory_is_stored():
    plain = SETTINGS.to_plain()
    assert plain["memory"] == "recurrent" and PolicySettings.from_plain(plain) == SETTINGS
    for written, kind in ((True, "features"), (False, "none"), ("recurrent", "recurrent")):
        assert memory_of(written) == kind
        older = {k: v for k, v in plain.items() if k != "memory_units"} | {"memory": written}
        assert PolicySettings.from_plain(older).memory == kind
    with pytest.raises(ValueError, match="memory is 'elephant'"):
        PolicySettings.from_plain(plain | {"memory": "elephant"})
