"""Gymnasium specs: arguments survive JSON, pickle and Minari."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

import rendezvous_env as rv

NAME, HEADING = "rendezvous/Rendezvous-v0", "rendezvous/RendezvousHeading-v0"
MATRIX = np.array([[0.0, 1.0, 0.5], [1.0, 0.0, 0.25], [0.5, 0.25, 0.0]])
FIELD = rv.ObstacleField(count=2, radius=(0.2, 0.4), region=6.0, keep_out=0.3)
SCENARIOS = {
    "default": rv.Scenario(),
    "matrix": rv.Scenario(n_robots=3, graph=MATRIX, time_limit=2.0),
    "shapes": rv.Scenario(obstacles=(rv.Disc((2.0, 0.0), 0.5), rv.Capsule(((3, 3), (4, 4)), 0.2))),
    "field": rv.Scenario(obstacles=FIELD, sensing={"range": 30.0, "dropout": 0.1}),
    "space": rv.Scenario(dim=3, robot_model="nonholonomic_3d", reward={"progress": 2.0}),
    "start": rv.Scenario(n_robots=2, start_positions=((0.0, 0.0), (3.0, 1.0)), costs="contact"),
    "switching": rv.Scenario(graph={"kind": "switching", "graphs": ["path", "star"]}),
    "named": rv.scenarios.get("clutter-16"),
}


def again(spec):
    """Spec after a JSON round trip, which must be equal."""
    text = spec.to_json()
    read = EnvSpec.from_json(text)
    assert read.to_json() == text and pickle.loads(pickle.dumps(spec)).to_json() == text
    return read


def played(env, scenario, seed=5):
    env.reset(seed=seed)
    random = np.random.default_rng(0)
    bounds = scenario.action_bounds
    shape = env.unwrapped.single_action_space.shape if hasattr(env, "num_envs") else None
    shape = env.action_space.shape if shape is None else (env.num_envs, *shape)
    return [
        env.step(random.uniform(-bounds, bounds, shape).astype(np.float32))[0] for _ in range(9)
    ]


@pytest.mark.parametrize("which", SCENARIOS)
@pytest.mark.parametrize("plain", [False, True])
def test_scenario_survives_spec_of_one_agent(which, plain):
    scenario = SCENARIOS[which]
    env = gymnasium.make(NAME, scenario=scenario.to_plain() if plain else scenario)
    for spec in (env.spec, env.unwrapped.spec, copy.deepcopy(env.spec)):
        other = gymnasium.make(again(spec))
        assert other.unwrapped.scenario == scenario
        np.testing.assert_array_equal(played(other, scenario), played(env, scenario))


@pytest.mark.parametrize("which", SCENARIOS)
def test_scenario_survives_spec_of_a_vector_environment(which):
    scenario, mode = SCENARIOS[which], AutoresetMode.SAME_STEP
    env = gymnasium.make_vec(NAME, 2, scenario=scenario, autoreset_mode=mode)
    other = gymnasium.make_vec(again(env.spec))
    assert other.unwrapped.scenario == scenario and other.num_envs == 2
    assert other.metadata["autoreset_mode"] is mode
    np.testing.assert_array_equal(played(other, scenario), played(env, scenario))


@pytest.mark.parametrize("name", [NAME, HEADING])
def test_arguments_of_any_kind_survive_the_spec(name, tmp_path):
    path = tmp_path / "mine.toml"
    rv.scenarios.get("fig3").to_toml(path)
    given = {
        "scenario": path,
        "graph": rv.graphs.path(0.5),
        "obstacles": [rv.Disc((0.0, 0.0), 0.5)],
        "sensing": rv.Sensing(range=30.0),
        "reward": rv.RewardWeights(progress=3.0),
        "max_turn_rate": np.float64(2.0),
        "time_limit": np.float32(4.0),
        "start_headings": None,
        "flatten": np.True_,
    } | ({"min_alignment": np.float64(0.2)} if name == HEADING else {})
    env = gymnasium.make(name, **given)
    other = gymnasium.make(again(env.spec))
    assert other.unwrapped.scenario == env.unwrapped.scenario
    assert other.observation_space == env.observation_space
    field = gymnasium.make(name, obstacles=FIELD, graph=MATRIX, n_robots=3)
    other = gymnasium.make(again(field.spec))
    assert other.unwrapped.scenario == field.unwrapped.scenario


def test_every_entry_takes_plain_data_of_a_scenario():
    scenario = SCENARIOS["matrix"]
    plain = scenario.to_plain()
    for made in (
        rv.parallel_env(plain), rv.make_vec(plain, 2),
        rv.training_env(plain, learning_preset=False),
        rv.vector.training_env(plain, 2, learning_preset=False), rv.Simulator(plain),
        rv.rendezvous_v0.env(plain).unwrapped,
    ):  # fmt: skip
        assert made.scenario.replace(on_merge="remove") == scenario
    assert rv.parallel_env(plain, max_speed=0.5).scenario.max_speed == 0.5
    with pytest.raises(ValueError, match="scenario is 5; it must be a Scenario, its plain data"):
        rv.parallel_env(5)
    with pytest.raises(ValueError, match="n_robot"):
        rv.parallel_env({"n_robot": 3})


@pytest.mark.filterwarnings("ignore:`eval_env` is set to None")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Minari's folder
def test_minari_recovers_the_environment(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("jax")  # which its collector asks for
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    scenario = SCENARIOS["matrix"]
    env = minari.DataCollector(gymnasium.make(NAME, scenario=scenario), record_infos=True)
    for _ in range(3):  # Minari draws seeds of 64 bits
        env.reset()
        over = False
        while not over:
            *_, met, late, _ = env.step(np.zeros(env.action_space.shape, np.float32))
            over = met or late
    data = env.create_dataset(
        "rendezvous/mine-v0", algorithm_name="still", author="me", author_email="me@example.org",
        code_permalink="https://example.org", description="none moves",
    )  # fmt: skip
    env.close()
    assert data.total_episodes == 3 and data.total_steps == 3 * scenario.max_steps
    episode = data[0]
    infos = episode.infos
    assert infos["summary"]["time"].shape == infos["time"].shape == (scenario.max_steps + 1,)
    np.testing.assert_array_equal(infos["summary"]["time"], infos["time"])
    other = data.recover_environment()
    assert other.unwrapped.scenario == scenario
    about = list(data.storage.get_episode_metadata(range(3)))
    for kept, episode in zip(about, data.iterate_episodes(), strict=True):
        seen, _ = other.reset(seed=int(kept["seed"]))
        np.testing.assert_array_equal(seen, episode.observations[0])
