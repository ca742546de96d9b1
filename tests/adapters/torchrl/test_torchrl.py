"""TorchRL environment: its contract, and equality with the vector environment."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("torchrl.envs")

from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import TransformReward
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from rendezvous_env.adapters.torchrl import GROUP, RendezvousTorchRLEnv
from rendezvous_env.vector import training_env
from train.bench import bench

SHORT = {"guarantee": None, "learning_preset": False, "time_limit": 0.6}
COSTS = ("cost", "cost_contact", "cost_rise")
ACTION, ACTIVE, SEEN = (GROUP, "action"), (GROUP, "active"), (GROUP, "observation")


@pytest.fixture(autouse=True)
def _same_random_actions():
    torch.manual_seed(0)


@pytest.mark.parametrize(
    "choices",
    [
        {},
        {"discrete": True},
        {"guarantee": "tank", "costs": ("rise",)},
        {"guarantee": None, "learning_preset": False, "flatten": False, "return_state": True},
    ],
)
def test_environment_passes_check_env_specs(choices):
    env = RendezvousTorchRLEnv("clutter-8", 3, seed=1, **choices)
    check_env_specs(env)
    start = env.reset()
    assert start[SEEN].shape[:2] == start[ACTIVE].shape[:2] == (3, 4)
    assert ("state" in start.keys()) == choices.get("return_state", False)
    assert env.group_map == {GROUP: ["robot_0", "robot_1", "robot_2", "robot_3"]}


def test_conditions_of_robots_are_in_the_group_info():
    clocks = {"kind": "periodic", "period": 2, "phase": [0, 0, 1, 1]}
    choices = {"activation": clocks, "costs": "rise", "spawn_size": 60.0, "obstacles": ()}
    env = RendezvousTorchRLEnv("clutter-8", 3, seed=1, **SHORT, **choices)
    check_env_specs(env)
    data, _ = drive(env, 4)
    told = data["next", GROUP, "info"]
    assert set(told.keys()) == {"cost", "cost_rise", "activated"}
    wanted = torch.tensor([[True, True, False, False], [False, False, True, True]] * 2)
    assert (told["activated"][..., 0] == wanted).all()


def test_mixed_team_with_sensors_per_robot_acts_as_in_the_vector_environment():
    models = ["single_integrator", "unicycle", "double_integrator", "unicycle"]
    sensing = {"field_of_view": [6.2, 1.2, 3.0, 2.0], "noise": [0.0, 0.1, 0.2, 0.0]}
    choices = {**SHORT, "robot_model": models, "sensing": sensing, "obstacles": ()}
    env = RendezvousTorchRLEnv("clutter-8", 3, seed=1, **choices)
    check_env_specs(env)
    env = RendezvousTorchRLEnv("clutter-8", 3, seed=5, **choices)
    data, tape = drive(env, 5)
    teams = training_env("clutter-8", 3, autoreset_mode=AutoresetMode.DISABLED, **choices)
    seen, _ = teams.reset(seed=5)
    for t, actions in enumerate(tape):
        np.testing.assert_array_equal(data[SEEN][:, t], seen)
        seen = teams.step(actions)[0]
    assert (env.simulator.scenario.action_mask == np.ones((4, 2), bool)).all()


def drive(env, steps, seed=0):
    """A rollout under a fixed sequence of actions, and the sequence."""
    random = torch.Generator().manual_seed(seed)
    tape = torch.rand((steps, *env.full_action_spec[ACTION].shape), generator=random) * 2 - 1
    moves = iter(tape)
    policy = lambda tensordict: tensordict.set(ACTION, next(moves))  # noqa: E731
    with torch.no_grad():
        return env.rollout(steps, policy, break_when_any_done=False), tape.numpy()


def test_rollout_equals_vector_environment():
    """Teams meet and time out; final observations belong to the ended episode."""
    choices = {"learning_preset": False, "decision_period": 4, "time_limit": 12.0}
    choices |= {"costs": ("contact", "rise")}
    env = RendezvousTorchRLEnv("clutter-8", 6, seed=5, **choices)
    data, tape = drive(env, 130)
    teams = training_env("clutter-8", 6, autoreset_mode=AutoresetMode.DISABLED, **choices)
    (seen, _), over = teams.reset(seed=5), np.ones(6, bool)
    for t, actions in enumerate(tape):
        np.testing.assert_array_equal(data[SEEN][:, t], seen)
        assert not data[GROUP, "info", "cost"][:, t][over].any()  # who begins has paid nothing
        seen, _, met, cut, infos = teams.step(actions)
        after = data["next"][:, t]
        for key, expected in (
            (SEEN, seen),
            (ACTIVE, infos["active"]),
            ((GROUP, "reward"), infos["robot_rewards"].astype(np.float32)),
            ("contacts", infos["contacts"]),
            ("terminated", met),
            ("truncated", cut),
            ("done", met | cut),
            *(((GROUP, "info", key), infos[key].astype(np.float32)) for key in COSTS),
        ):
            np.testing.assert_array_equal(after[key], expected.reshape(after[key].shape))
        if (over := met | cut).any():
            seen, _ = teams.reset(options={"reset_mask": over})
    assert data["next", "terminated"].any() and data["next", "truncated"].any()
    assert data["next", "contacts"].any() and data["next", GROUP, "info", "cost"].any()


def test_partial_reset_keeps_other_environments():
    env = RendezvousTorchRLEnv("fig3", 4, seed=0, **SHORT)
    now = env.reset()
    for _ in range(3):
        now = env.step_mdp(env.step(env.rand_action(now)))
    mask = torch.tensor([[False], [True], [False], [True]])
    others, steps = ~mask[:, 0], env.simulator.steps.copy()
    again = env.reset(now.clone().set("_reset", mask))
    torch.testing.assert_close(again[SEEN][others], now[SEEN][others], rtol=0, atol=0)
    assert not torch.equal(again[SEEN][~others], now[SEEN][~others])
    np.testing.assert_array_equal(env.simulator.steps, np.where(mask[:, 0], 0, steps))


def test_seeds_are_per_environment():
    env = RendezvousTorchRLEnv("fig3", 3, **SHORT)
    env.set_seed(11)
    first = env.reset()[SEEN]
    assert not torch.equal(first, env.reset()[SEEN])
    env.set_seed(11)
    mask = torch.tensor([[False], [True], [False]])
    one = env.reset(TensorDict({"_reset": mask, "done": mask}, [3]))[SEEN]
    assert torch.equal(one[1], first[1]) and not torch.equal(one[0], first[0])
    rest = env.reset()[SEEN]  # the seeds that were still to be used
    assert torch.equal(rest[[0, 2]], first[[0, 2]]) and not torch.equal(rest[1], first[1])
    torch.testing.assert_close(
        RendezvousTorchRLEnv("fig3", 1, seed=12, **SHORT).reset()[SEEN], first[1:2]
    )


def test_rollout_waits_for_all_environments():
    env = RendezvousTorchRLEnv("duo", 5, seed=0)
    with torch.no_grad():
        data = env.rollout(env.max_steps, break_when_any_done=False, break_when_all_done=True)
    assert data["next", "done"][:, -1].all() and not data["next", "done"][:, -2].all()


def test_reset_takes_initial_condition():
    env = RendezvousTorchRLEnv("duo", 2, **SHORT)
    env.reset(options={"positions": [[0.0, 0.0], [3.0, 4.0]]})
    np.testing.assert_allclose(env.simulator.positions, [[[0, 0], [3, 4]]] * 2)
    with pytest.raises(ValueError, match="positions"):
        env.reset(options={"positions": [[0.0, 0.0]]})


def test_final_state_is_reported():
    """A time-out is bootstrapped from the final state, not from the next initial one."""
    env = RendezvousTorchRLEnv("fig3", 2, seed=3, return_state=True, **SHORT)
    data, _ = drive(env, env.max_steps + 2)
    last, begun = env.max_steps - 1, env.max_steps
    assert data["next", "truncated"][:, last].all()
    assert (data["next", "state"][:, last, -1] == 1.0).all()  # the share of time that has passed
    assert (data["state"][:, begun, -1] == 0.0).all()


def test_invalid_actions_are_rejected():
    env = RendezvousTorchRLEnv("fig3", 2, seed=0, **SHORT)
    now = env.reset()
    bad = torch.zeros(env.full_action_spec[ACTION].shape)
    bad[1, 2] = torch.nan
    with pytest.raises(ValueError, match=r"robot_2 in environment 1"):
        env.step(now.clone().set(ACTION, bad))
    desired = torch.zeros(env.full_action_spec[ACTION].shape, requires_grad=True)
    assert not env.step(now.clone().set(ACTION, desired * 2))["next", SEEN].requires_grad


def test_reward_wrapper_changes_robot_rewards():
    found, more = [], lambda teams: TransformReward(teams, lambda rewards: rewards + 5.0)
    for options in ({}, {"wrap": more}):
        env = RendezvousTorchRLEnv("clutter-4", 3, seed=0, **options)
        data = env.reset()
        data[GROUP, "action"] = env.action_spec[GROUP, "action"].zero()
        found.append(env.step(data)["next", GROUP, "reward"].numpy())
    np.testing.assert_allclose(found[1] - found[0], 5.0, rtol=1e-5)
    assert found[0].shape == (3, 4, 1)


def test_bench_times_torchrl_over_base_environment(tmp_path):
    path = tmp_path / "bench.json"
    small = {"robots": (3,), "num_envs": 16, "num_threads": 1, "repeats": 1, "seconds": 0.01}
    bench.run(bench.Config(json=path, only=("adapters",), **small))
    written = json.loads(path.read_text())
    rows = {row["name"]: row for row in written["rows"]}
    for ours in ("make_vec", "training_env"):
        assert rows[ours]["ratio"] is None
        assert rows[f"TorchRL over {ours}"]["against"] == ours
        assert rows[f"TorchRL over {ours}"]["ratio"] > 0
    assert "torchrl" in written["versions"]
