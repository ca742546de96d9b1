"""The JAX form as a vector environment of tensors: shared memory, and PPO of TorchRL."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("torchrl.objectives")
jax = pytest.importorskip("jax")

from gymnasium.vector import AutoresetMode
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import rendezvous_env as rv
from rendezvous_env.adapters.jax_torch import JaxTorchVectorEnv, to_jax, to_torch

SMALL = {"dim": 2, "n_robots": 3, "spawn_size": 1.0, "time_limit": 2.0}
TEAMS = 4


@pytest.fixture(scope="module")
def env():
    return JaxTorchVectorEnv("cloud-8", TEAMS, **SMALL)


def test_tensors_share_memory_with_arrays():
    array = jax.numpy.arange(8.0)
    tensor = to_torch(array)
    assert tensor.data_ptr() == array.unsafe_buffer_pointer()
    there = torch.arange(16, dtype=torch.float32, requires_grad=True) * 2.0
    np.testing.assert_array_equal(to_jax(there), there.detach().numpy())
    np.testing.assert_array_equal(to_jax([1.0, 2.0]), [1.0, 2.0])


def test_rollout_equals_vector_environment(env):
    engine = rv.make_vec("cloud-8", num_envs=TEAMS, autoreset_mode="SAME_STEP", **SMALL)
    (seen, infos), (expected, _) = env.reset(seed=2), engine.reset(seed=2)
    assert seen.device.type == "cpu" and infos == {}
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.observation_space == engine.observation_space
    ended = 0
    for _ in range(40):
        np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-4)
        actions = 0.9 * seen.sum(dim=2)
        seen, rewards, met, cut, infos = env.step(actions)
        expected, ours, *ends, _ = engine.step(actions.numpy())
        np.testing.assert_allclose(rewards, ours, rtol=0, atol=1e-4)
        np.testing.assert_array_equal(torch.stack([met, cut]), ends)
        ended += int((met | cut).sum())
    assert infos["final_obs"].shape == seen.shape and infos["active"].dtype == torch.bool
    assert ended > 0, "no environment was reset"


def test_reset_samples_seeds_and_refuses_options(env):
    starts = [env.reset()[0] for _ in range(2)]
    assert not torch.equal(*starts)
    with pytest.raises(ValueError, match=r"options is .*; it must be None"):
        env.reset(options={"reset_mask": [True] * TEAMS})
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        JaxTorchVectorEnv("duo").step(torch.zeros(1, 2, 2))


def test_an_iteration_of_ppo_changes_the_actor(env):
    """Robots are samples of one policy; GAE and the clipped loss are those of TorchRL."""
    torch.manual_seed(0)
    rows, d = env.single_observation_space.shape[1:]
    net = nn.Sequential(nn.Flatten(-2), nn.Linear(rows * d, 16), nn.Tanh(), nn.Linear(16, 2 * d))
    body = TensorDictModule(
        nn.Sequential(net, NormalParamExtractor()), ["observation"], ["loc", "scale"]
    )
    actor = ProbabilisticActor(
        body, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True
    )
    critic = ValueOperator(nn.Sequential(nn.Flatten(-2), nn.Linear(rows * d, 1)))
    seen, steps = env.reset(seed=0)[0].clone(), []
    for _ in range(16):
        with torch.no_grad():
            step = actor(TensorDict({"observation": seen}, batch_size=seen.shape[:2]))
        seen, _, met, cut, infos = env.step(step["action"])
        seen = seen.clone()
        done = (met | cut)[:, None, None].expand(*step.batch_size, 1)
        after = {"observation": seen, "reward": infos["robot_rewards"][..., None], "done": done}
        step["next"] = TensorDict({**after, "terminated": done}, batch_size=step.batch_size)
        steps.append(step)
    data = torch.stack(steps, dim=2)  # (B, n, steps)
    GAE(gamma=0.99, lmbda=0.95, value_network=critic)(data)
    loss = ClipPPOLoss(actor, critic)
    before = [weights.clone() for weights in loss.parameters()]
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-2)
    told = loss(data.reshape(-1))
    total = sum(value for key, value in told.items() if key.startswith("loss_"))
    total.backward()
    optimiser.step()
    assert torch.isfinite(total)
    changed = [not torch.equal(a, b) for a, b in zip(before, loss.parameters(), strict=True)]
    assert sum(changed) >= 5
