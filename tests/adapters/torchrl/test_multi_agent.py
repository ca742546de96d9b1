"""BenchMARL algorithms on the leaderboard: common initial conditions, reproducible runs."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("benchmarl.experiment")

from rendezvous_env import scenarios
from rendezvous_env.adapters.torchrl import GROUP
from train.leaderboard import command, registry, run_records
from train.leaderboard.algorithms import multi_agent
from train.leaderboard.environments import make_training_envs

NAMES = tuple(
    f"{learner}-{safety}"
    for learner in ("ippo", "mappo", "masac", "qmix")
    for safety in ("none", "heading")
)
SMALL = command.Config(
    algorithms=NAMES, fields=("clutter-8",), seeds=(0,), decisions=2**12, episodes=4, jobs=1
)
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")


@pytest.mark.parametrize("safety", ["none", "heading"])
def test_learners_train_in_common_environments(safety):
    field = scenarios.get("clutter-8")
    price = 0.0 if safety == "none" else None
    teams = make_training_envs(field, 3, safety=safety, anew=True, contact_penalty=price)
    env = multi_agent.task_of(field, safety).get_env_fun(3, False, 7, "cpu")()
    assert (
        env.vector_env.contact_penalty
        == teams.contact_penalty
        == (0.0 if safety == "none" else 1.0)
    )
    seen, _ = teams.reset(seed=7)
    now, random = env.reset(), np.random.default_rng(0)
    for _ in range(60):
        np.testing.assert_array_equal(now[GROUP, "observation"], seen)
        choices = random.integers(teams.single_action_space.nvec[0], size=seen.shape[:2])
        now[GROUP, "action"] = torch.from_numpy(choices)
        seen, *_, infos = teams.step(choices)
        after = env.step(now)
        earned = after["next", GROUP, "reward"][..., 0]
        np.testing.assert_array_equal(earned, infos["robot_rewards"].astype(np.float32))
        now = env.maybe_reset(env.step_mdp(after))


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    out = tmp_path_factory.mktemp("board") / "out"
    assert command.run(replace(SMALL, out=out)) == 0
    return {card["algorithm"]: (out, card) for card in run_records.read_records(out)}


@pytest.mark.parametrize("name", ["ippo-none", "mappo-heading", "masac-none", "qmix-heading"])
def test_run_is_bitwise_reproducible(name, board, capsys):
    out, card = board[name]
    assert card["settings"]["num_envs"] == 64 and "benchmarl" in card["versions"]
    per_update = 4 * 64 * (16 if "ppo" in name else 4)
    assert card["settings"]["max_n_iters"] * per_update == card["decisions"] == 2**12
    path = out / "cells" / name / "clutter-8-v1-seed-0.json"
    assert command.run(replace(SMALL, repeat=path)) == 0
    assert "bitwise equal" in capsys.readouterr().out


def test_seed_and_filter_change_result(board):
    for learner in ("ippo", "mappo", "masac", "qmix"):
        bare, headed = (board[f"{learner}-{safety}"][1] for safety in ("none", "heading"))
        assert bare["results"] != headed["results"] and not sum(headed["results"]["risen"])
    place = command.plan(replace(SMALL, algorithms=("ippo-none",), seeds=(1,)))[0]
    assert run_records.run_of(place, False)[0]["results"] != board["ippo-none"][1]["results"]


def test_all_algorithms_are_registered():
    assert set(NAMES) <= set(registry.known())
    assert not [name for name in NAMES if registry.known()[name].missing]
