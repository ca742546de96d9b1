"""Episode statistics logged by stable-baselines3, compared with the episodes."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import rendezvous_env as rv
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.adapters.sb3_logging import EpisodeLog, WandbLog, episode_numbers
from rendezvous_env.vector import training_env

SETTINGS = {"n_steps": 16, "batch_size": 64, "n_epochs": 1, "device": "cpu", "seed": 0}


@rv.reward_term("hits")
def hits(step):
    """A name in the plural, with a value per robot."""
    return step.contact.astype(float)


@pytest.fixture(autouse=True)
def one_torch_thread(set_threads):
    set_threads(1)


def robots_of(scenario="clutter-24", **arguments):
    given = {"time_limit": 6.0, "costs": ("contact", "rise", "hits")} | arguments
    return RobotVecEnv(training_env(scenario, 6, **given))


def episodes_of(robots, steps=130, seed=0):
    """Episode infos, and team rewards by episode, under random actions."""
    random = np.random.default_rng(seed)
    robots.seed(seed)
    robots.reset()
    told = []
    for _ in range(steps):
        shape = (robots.num_envs, *robots.action_space.shape)
        *_, infos = robots.step(random.uniform(-1, 1, shape).astype(np.float32))
        told += [info["episode"] for info in infos if "episode" in info]
    return told


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ({}, {"progress", "time_penalty", "rendezvous_bonus", "other"}),
        ({"contact_penalty": 0.0}, {"progress", "time_penalty", "rendezvous_bonus"}),
        (
            {
                "learning_preset": False,
                "reward": {"custom": {"hits": 0.25}, "collision_penalty": 0.5},
            },
            {"progress", "time_penalty", "collision_penalty", "rendezvous_bonus", "hits"},
        ),
    ],
)
def test_reward_terms_of_an_episode_add_up_to_its_return(arguments, names):
    told = episodes_of(robots_of(**arguments))
    assert len(told) >= 6
    found = set()
    for episode in told:
        terms = {k.removeprefix("reward_"): v for k, v in episode.items() if k[:7] == "reward_"}
        found |= terms.keys()
        assert sum(terms.values()) == pytest.approx(episode["r"], abs=1e-5)
        assert terms.get("rendezvous_bonus", 0.0) == float(episode["success"])
    assert found == names


def test_costs_of_an_episode_are_told_by_name():
    told = episodes_of(robots_of(contact_penalty=0.0))
    assert any(episode["cost_contact"] > 0 for episode in told)
    for episode in told:
        each = [episode[f"cost_{name}"] for name in ("contact", "rise", "hits")]
        assert episode["cost"] == pytest.approx(sum(each))
        assert episode["cost_hits"] == episode["cost_contact"]


def test_episode_numbers_are_shares_and_means():
    row = {"r": 1.0, "success": True, "contacts": 0, "time": 4.0, "path_length": 3.0}
    others = [
        row | {"success": True, "contacts": 2, "time": 6.0, "r": 0.0, "cost_rise": 0.5},
        row | {"success": False, "contacts": 0, "time": 9.0, "reward_progress": 0.3},
    ]
    numbers = episode_numbers([row, *others])
    assert numbers["episodes"] == 3
    assert numbers["success"] == pytest.approx(2 / 3)
    assert numbers["collision_free_success"] == pytest.approx(1 / 3)
    assert (numbers["median_time"], numbers["return"]) == (6.0, pytest.approx(2 / 3))
    assert numbers["contacts"] == pytest.approx(2 / 3)
    assert numbers["cost_rise"] == pytest.approx(0.5 / 3)
    assert numbers["reward_progress"] == pytest.approx(0.1)
    assert np.isnan(episode_numbers([])["collision_free_success"])


def test_tensorboard_has_the_names_of_rendezvous_train(tmp_path):
    robots = robots_of()
    model = PPO("MlpPolicy", robots, tensorboard_log=str(tmp_path), **SETTINGS)
    model.learn(2 * 16 * robots.num_envs, callback=EpisodeLog())
    (folder,) = tmp_path.iterdir()
    events = EventAccumulator(str(folder))
    events.Reload()
    names = set(events.Tags()["scalars"])
    wanted = (
        "success",
        "collision_free_success",
        "contacts",
        "return",
        "path_length",
        "cost_contact",
    )
    assert {f"train/{name}" for name in wanted} <= names
    assert {"train/reward_progress", "train/reward_time_penalty", "train/cost_rise"} <= names
    assert 0.0 <= events.Scalars("train/collision_free_success")[0].value <= 1.0


def test_weights_and_biases_get_what_the_logger_gets(tmp_path, monkeypatch):
    logged, ended = [], []
    run = SimpleNamespace(
        log=lambda values, step: logged.append((step, values)), finish=lambda: ended.append(True)
    )
    asked = []
    fake = SimpleNamespace(init=lambda **given: asked.append(given) or run)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    robots = robots_of()
    model = PPO("MlpPolicy", robots, **SETTINGS)
    model.set_logger(configure(str(tmp_path), ["csv"]))
    writers = list(model.logger.output_formats)
    model.learn(3 * 16 * robots.num_envs, callback=[EpisodeLog(), WandbLog(project="mine")])
    model.logger.close()
    assert asked == [{"project": "mine"}]
    assert ended == [True]
    assert model.logger.output_formats == writers
    steps = [step for step, _ in logged]
    assert steps == sorted(steps) and len(steps) == 3
    assert "train/collision_free_success" in {name for _, values in logged for name in values}
    assert all(isinstance(value, float) for _, values in logged for value in values.values())


def test_weights_and_biases_say_how_to_get_them(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    model = PPO("MlpPolicy", robots_of(), **SETTINGS)
    with pytest.raises(ImportError, match="pip install wandb"):
        model.learn(16, callback=WandbLog())
