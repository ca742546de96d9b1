"""PPO with TorchRL: one actor for all robots, a critic for the whole team.

The guarantee holds from the first step, so training improves time and contacts. Evaluation uses
held-out initial conditions. The trained actor becomes a policy for ``rollout`` and ``compare``.
"""

import argparse

import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.envs import ExplorationType, set_exploration_type, step_mdp
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.adapters.torchrl import RendezvousTorchRLEnv

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8")
parser.add_argument("--updates", type=int, default=30)
parser.add_argument("--num-envs", type=int, default=128)
parser.add_argument("--steps", type=int, default=16)
parser.add_argument("--held-out", type=int, default=200)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
EPOCHS, MINIBATCHES = 4, 8
SEEN, ACTION = ("robots", "observation"), ("robots", "action")

torch.manual_seed(given.seed)
torch.set_num_threads(1)  # the networks are small
env = RendezvousTorchRLEnv(given.scenario, given.num_envs, seed=given.seed)
held_out = RendezvousTorchRLEnv(given.scenario, given.held_out)
_, n, size = env.full_observation_spec[SEEN].shape
actions = env.full_action_spec_unbatched[ACTION]


def network(outputs: int, centralised: bool) -> MultiAgentMLP:
    """Network that all robots share; a centralised one reads the whole team."""
    shape = {"depth": 2, "num_cells": 64, "share_params": True}
    return MultiAgentMLP(size, outputs, n, centralized=centralised, **shape)


actor = ProbabilisticActor(
    TensorDictModule(
        nn.Sequential(network(2 * actions.shape[-1], False), NormalParamExtractor()),
        in_keys=[SEEN],
        out_keys=[("robots", "loc"), ("robots", "scale")],
    ),
    in_keys=[("robots", "loc"), ("robots", "scale")],
    out_keys=[ACTION],
    distribution_class=TanhNormal,
    distribution_kwargs={"low": actions.space.low, "high": actions.space.high},
    return_log_prob=True,
    log_prob_key=("robots", "log_prob"),
)
critic = TensorDictModule(network(1, True), in_keys=[SEEN], out_keys=[("robots", "value")])
loss = ClipPPOLoss(actor, critic, entropy_coeff=1e-3)
loss.set_keys(
    sample_log_prob=("robots", "log_prob"),
    **{
        key: ("robots", key)
        for key in ("action", "reward", "done", "terminated", "value", "advantage", "value_target")
    },
)
loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)


@torch.no_grad()
def evaluate(moment: str) -> None:
    """Success in the first episode of each held-out environment, greedy actions."""
    held_out.set_seed(1_000_000)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        data = held_out.rollout(held_out.max_steps, actor, break_when_any_done=False)
    last = data["next", "done"][..., 0].int().argmax(dim=1)  # end of the first episode
    ends = data["next"][torch.arange(len(last)), last]
    met = ends["terminated"][:, 0]
    clean = met & (ends["contacts"][:, 0] == 0)
    times = (last + 1.0) * held_out.seconds_per_step
    times[~met] = torch.inf
    share, cleanly = (which.float().mean() for which in (met, clean))
    print(f"{moment}: {share:.1%} met, {cleanly:.1%} collision-free, median {times.median():.2f} s")


evaluate("before")
now = env.reset()
for _ in range(given.updates):
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = env.rollout(
            given.steps, actor, tensordict=now, auto_reset=False, break_when_any_done=False
        )
        now = step_mdp(data[:, -1])
        for key in ("done", "terminated"):  # robots end with their team
            shared = data["next", key].unsqueeze(-2).expand(*data.shape, n, 1)
            data["next", "robots", key] = shared
        loss.value_estimator(data)
        advantage, active = data["robots", "advantage"], data["robots", "active"]
        spread = (advantage - advantage[active].mean()) / advantage[active].std()
        data["robots", "advantage"] = spread * active  # merged robots have no effect
    samples = data.reshape(-1)
    for _ in range(EPOCHS):
        for picked in torch.randperm(len(samples)).chunk(MINIBATCHES):
            losses = loss(samples[picked])
            total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
            optimiser.zero_grad()
            total.backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
            optimiser.step()
evaluate("after")


@torch.no_grad()
def predict(observations):
    """Greedy actions, (B, n, size) to (B, n, 2)."""
    seen = TensorDict({SEEN: torch.from_numpy(observations)}, [len(observations)])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return actor(seen)[ACTION].numpy()


policy = baselines.TrainedPolicy(given.scenario, predict, by_team=True)
played = rv.rollout(given.scenario, policy, seed=1_000_000, num_envs=given.held_out)
clean = played.success & ~played.contacts.any(axis=(0, 2))
print(f"as a policy: {played.success.mean():.1%} met, {clean.mean():.1%} collision-free")
