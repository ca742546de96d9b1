"""PPO updates: equality with stable-baselines3, for any partition of the work."""

import copy
from functools import partial

import numpy as np
import pytest
import torch
from parameters import needed, slow
from stable_baselines3 import PPO
from stable_baselines3.common.type_aliases import RolloutBufferSamples

from train.learn.environments import TimedRobotVecEnv, make_environments
from train.learn.rollout_buffer import LossCoefficients, slopes_of
from train.learn.settings import Config
from train.learn.trainer import Trainer

STEPS = 40


def collected(memory, batch_size=10**6):
    """A model after a rollout, before its update."""
    config = Config(
        scenario="clutter-12", set=("time_limit=3",), guarantee="tank", budget=2.0, memory=memory,
        critic="global" if memory == "recurrent" else "local", set_width=8, hidden=(16,), seed=5,
        num_envs=16, n_steps=STEPS, batch_size=batch_size, epochs=3, ent_coef=0.01,
        learning_rate=3e-3, clip_range=0.02,
    )  # fmt: skip
    model = Trainer(config).model
    _, callback = model._setup_learn(STEPS * model.n_envs)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, STEPS)
    assert not model.rollout_buffer.mask.all()
    return model


def evaluated(policy, sequences, actions):
    """Outputs of a network for PPO, here of whole sequences."""
    preferences, values = policy.judged(sequences)
    chances = torch.distributions.Categorical(logits=preferences)
    return values, chances.log_prob(actions), chances.entropy()


def after(model, train):
    """Weights and log of an update of a copy."""
    model.rollout_buffer.part_size = 300  # several parts to a batch
    own = copy.copy(model)
    own.policy = copy.deepcopy(model.policy)
    if getattr(own.policy, "units", 0):
        own.policy.evaluate_actions = partial(evaluated, own.policy)
    own.policy.optimizer = type(model.policy.optimizer)(own.policy.parameters(), eps=1e-5)
    np.random.seed(0)
    train(own)
    told = {k: v for k, v in own.logger.name_to_value.items() if k.startswith("train/")}
    return {k: v.detach() for k, v in own.policy.named_parameters()}, told


@pytest.mark.parametrize("memory", ["none", needed("recurrent")])
def test_update_equals_stable_baselines3(memory):
    """One batch, over which both normalise advantages; three gradient steps."""
    model = collected(memory)
    ours, told = after(model, type(model).train)
    theirs, expected = after(model, PPO.train)
    moved = 0.0
    for name, weight in model.policy.named_parameters():
        torch.testing.assert_close(ours[name], theirs[name], rtol=0, atol=1e-5)
        moved = max(moved, float((ours[name] - weight.detach()).abs().max()))
    assert moved > 5e-3
    for name in ("policy_gradient_loss", "value_loss", "entropy_loss", "clip_fraction"):
        assert told[f"train/{name}"] == pytest.approx(expected[f"train/{name}"], abs=1e-4), name
    assert expected["train/clip_fraction"] > 0


@pytest.mark.parametrize("memory", ["none", slow("recurrent")])
def test_threads_do_not_change_update(memory, set_threads):
    model = collected(memory, batch_size=600)
    found = []
    for number in (1, 2, 3):
        set_threads(number)
        found.append(after(model, type(model).train))
        assert torch.get_num_threads() == number
    first, expected = found[0]
    for weights, told in found[1:]:
        assert told == expected
        assert all(torch.equal(weight, first[name]) for name, weight in weights.items())


@pytest.mark.kernels
def test_gradients_equal_autograd():
    """Ratios on both sides of the clip range, advantages of both signs."""
    torch.manual_seed(0)
    preferences, values = torch.randn(500, 9, requires_grad=True), torch.randn(500, 1)
    values.requires_grad_(True)
    actions, told = torch.randint(0, 9, (500, 1)), torch.randn(3, 500)
    log_probs = preferences.log_softmax(dim=-1)
    of_choice = log_probs.gather(-1, actions)[:, 0]
    old = (of_choice + 0.3 * told[0]).detach()
    ratio, (advantages, returns) = (of_choice - old).exp(), told[1:]
    gain = torch.min(advantages * ratio, advantages * ratio.clamp(0.8, 1.2)).sum()
    entropy = -(log_probs.exp() * log_probs).sum()
    error = (values[:, 0] - returns).square().sum()
    (0.5 * error - gain - 0.01 * entropy).backward()
    samples = RolloutBufferSamples(torch.zeros(1), actions, values, old, advantages, returns)
    slopes, sums = slopes_of((preferences, values), samples, LossCoefficients(0.2, 0.5, 0.01))
    torch.testing.assert_close(slopes, [preferences.grad, values.grad], atol=1e-5, rtol=1e-5)
    clipped = int(((ratio - 1).abs() > 0.2).sum())
    divergence = (ratio - 1 - ratio.log()).sum()
    expected = [500.0, *(float(x.detach()) for x in (-gain, error, -entropy, divergence)), clipped]
    assert sums == pytest.approx(expected, rel=1e-4) and 100 < clipped < 400


def test_merge_within_decision_keeps_team_reward():
    """Includes the bonus of a later rendezvous in the same decision."""
    robots = TimedRobotVecEnv(make_environments(Config(num_envs=64, contact_penalty=0.0), 0))
    robots.seed(0)
    robots.reset()
    merged = 0
    for _ in range(40):
        _, rewards, ended, _ = robots.step(np.zeros(robots.num_envs, dtype=np.int64))
        shape = (-1, robots.n_robots)
        acted, earned = robots.acted.reshape(shape), rewards.reshape(shape)
        most = earned.max(axis=1, keepdims=True)
        assert np.where(acted, earned, most) == pytest.approx(np.broadcast_to(most, earned.shape))
        merged += int((ended.reshape(shape) & acted).sum())
    assert merged > 200
