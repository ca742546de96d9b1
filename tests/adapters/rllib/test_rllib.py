"""RLlib episodes, compared with separately simulated environments; and the set network."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from small_scenario import BARE, ROBOTS, SCENARIO, SEED, Lives
from test_examples import JUDGED, run

import rendezvous_env as rv
from rendezvous_env.adapters.slots import RobotSlots
from rendezvous_env.vector import training_env

pytest.importorskip("ray.rllib")
torch = pytest.importorskip("torch")

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.tune.registry import register_env

from rendezvous_env.adapters import rllib
from rendezvous_env.adapters.rllib_module import SetModule, sets_of
from rendezvous_env.adapters.rllib_rollout import Rollout

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # RLlib's own
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
TEAMS = 8


@pytest.fixture(scope="module")
def local_ray():
    quiet = dict.fromkeys(("include_dashboard", "log_to_driver", "configure_logging"), False)
    ray.init(address="local", num_cpus=1, **quiet)
    yield
    ray.shutdown()


def test_episodes_match_each_robot_alone():
    robots = RobotSlots(rv.make_vec(SCENARIO, TEAMS, autoreset_mode="SameStep"))
    rollout = Rollout(robots, robots.reset(SEED))
    lives = [Lives(team) for team in range(TEAMS)]
    names = lives[0].env.possible_agents
    random, chunks, taken = np.random.default_rng(0), [], 0
    for t in range(90):
        slots = np.flatnonzero(robots.active)
        actions = random.uniform(-2, 2, (len(slots), 2)).astype(np.float32)
        table = dict(zip(slots.tolist(), actions, strict=True))
        rollout.add(slots, {Columns.ACTIONS: actions, "mark": slots + 1000 * t}, actions)
        for team, life in enumerate(lives):
            life.step({name: table.get(team * ROBOTS + i) for i, name in enumerate(names)})
        if t in (30, 31, 89):
            taken += rollout.count
            chunks += rollout.cut()
            assert rollout.count == 0
    assert taken == sum(map(len, chunks))
    whole = {}
    for chunk in chunks:
        assert chunk.is_numpy and chunk.t_started == sum(map(len, whole.get(chunk.id_, [])))
        whole.setdefault(chunk.id_, []).append(chunk)
    ended = {}
    for parts in whole.values():
        slot = int(parts[0].get_extra_model_outputs("mark")[0] % 1000)
        if parts[-1].is_done:
            ended.setdefault(slot, []).append(parts)
        assert not any(part.is_done for part in parts[:-1])
    counts = {"met": 0, "merged": 0, "late": 0}
    for team, life in enumerate(lives):
        for robot, one, last, kind in life.found:
            parts = ended[team * ROBOTS + robot].pop(0)
            seen = np.concatenate([part.get_observations()[:-1] for part in parts])
            np.testing.assert_array_equal(seen, one.seen)
            np.testing.assert_array_equal(
                np.concatenate([part.get_actions() for part in parts]), one.acts
            )
            np.testing.assert_allclose(
                np.concatenate([part.get_rewards() for part in parts]), one.rewards, atol=1e-6
            )
            if kind != "met":  # after a rendezvous nothing is valued
                np.testing.assert_array_equal(parts[-1].get_observations(-1), last)
            assert parts[-1].is_terminated == (kind == "met")
            assert parts[-1].is_truncated == (kind != "met")
            counts[kind] += 1
    assert min(counts.values()) >= 3 and not any(ended.values())


def module_of(sets, context, actions, **config):
    size = sum(count * width for count, width in sets) + context
    torch.manual_seed(1)
    module = SetModule(
        observation_space=Box(-1, 1, (size,), np.float32),
        action_space=actions,
        model_config={"sets": sets, "units": 16, **config},
    )
    torch.nn.init.normal_(module.choice.weight)
    return module


@pytest.mark.parametrize("actions", [Box(-1, 1, (2,), np.float32), Discrete(5)])
def test_set_module_is_permutation_invariant(actions):
    few, many = (module_of(((k, 3), (m, 4)), 2, actions) for k, m in ((4, 3), (6, 5)))
    many.load_state_dict(few.state_dict())
    random = np.random.default_rng(0)
    neighbours, obstacles = random.normal(size=(7, 4, 3)), random.normal(size=(7, 3, 4))
    neighbours[:, 3], obstacles[:, 1] = 0.0, 0.0  # absent
    context = random.normal(size=(7, 2))

    def out(module, *parts):
        flat = np.concatenate([part.reshape(7, -1) for part in parts], axis=1)
        batch = {Columns.OBS: torch.as_tensor(flat, dtype=torch.float32)}
        return module.forward_inference(batch)[Columns.ACTION_DIST_INPUTS], module.compute_values(
            batch
        )

    first = out(few, neighbours, obstacles, context)
    turned = out(few, neighbours[:, [2, 3, 0, 1]], obstacles[:, ::-1], context)
    padding = np.zeros((7, 2, 3)), np.zeros((7, 2, 4))
    padded = out(
        many,
        np.concatenate([padding[0], neighbours], axis=1),
        np.concatenate([obstacles, padding[1]], axis=1),
        context,
    )
    for same in (turned, padded):
        torch.testing.assert_close(first, same)
    neighbours[:, 0] *= -1.0
    changed = out(few, neighbours, obstacles, context)
    assert (changed[0] != first[0]).any(dim=1).all() and (changed[1] != first[1]).all()


def test_sets_of_splits_layouts():
    rows = training_env("clutter-8", **BARE).layout
    assert sets_of(rows) == ((rows.neighbour_slots, 2), (rows.obstacle_slots, 4))
    shown = training_env("clutter-8").layout
    assert sets_of(shown) == ((shown.neighbour_slots, 3), (shown.obstacle_slots, 6))
    assert sets_of(training_env("duo", **BARE).layout)[1] == (0, 0)


def small(**arguments):
    config = rllib.configure(PPOConfig(), SCENARIO, num_envs=TEAMS, units=16, **BARE | arguments)
    return config.env_runners(num_env_runners=0).training(
        train_batch_size=600, minibatch_size=200, num_epochs=2
    )


def test_ppo_trains_on_sampled_episodes(local_ray):
    algorithm = small().debugging(seed=SEED).build_algo()
    before = {k: v.clone() for k, v in algorithm.get_module().state_dict().items()}
    told = algorithm.train()["env_runners"]
    assert 600 <= told["num_env_steps_sampled"] < 600 + TEAMS * ROBOTS
    assert 0.0 <= told["success"] <= 1.0 and told["num_episodes"] >= 3
    assert told["episode_len_max"] <= SCENARIO.time_limit / SCENARIO.tau
    assert told["episode_return_max"] <= 2.0 + 1e-6  # progress and bonus, at most 1 each
    after = algorithm.get_module().state_dict()
    assert all((after[name] != value).any() for name, value in before.items())
    algorithm.stop()


def test_evaluation_runs_full_greedy_episodes(local_ray):
    algorithm = small().debugging(seed=SEED).build_algo()
    runner = algorithm.env_runner
    first = runner.sample(num_episodes=5, explore=False)
    again = runner.sample(num_episodes=5, explore=False)
    assert all(episode.is_done and episode.t_started == 0 for episode in [*first, *again])
    dists = first[0].get_extra_model_outputs(Columns.ACTION_DIST_INPUTS)
    np.testing.assert_array_equal(first[0].get_actions(), dists[:, :2])
    explored = runner.sample(num_timesteps=50, explore=True, force_reset=True)
    dists = explored[0].get_extra_model_outputs(Columns.ACTION_DIST_INPUTS)
    assert (explored[0].get_actions() != dists[:, :2]).all()
    algorithm.stop()


def test_env_runners_have_distinct_seeds(local_ray):
    config = small().debugging(seed=SEED)
    runners = [rllib.RobotEnvRunner(config=config, worker_index=index) for index in (1, 2)]
    seeds = []
    for runner in runners:
        runner.sample(num_timesteps=1, random_actions=True)
        seeds += runner.env.simulator.seeds.tolist()
    assert len(set(seeds)) == 2 * TEAMS


@pytest.mark.slow
def test_remote_env_runner_samples(local_ray):
    algorithm = small().env_runners(num_env_runners=1).debugging(seed=SEED).build_algo()
    assert algorithm.train()["env_runners"]["num_env_steps_sampled"] >= 600
    algorithm.stop()


@pytest.mark.slow
def test_example_runs():
    told = run("08_rllib_ppo.py", "--updates", "2", "--held-out", "50")
    assert len(JUDGED.findall(told)) == 2


@pytest.mark.nightly
def test_example_learns():
    """Evaluated on held-out initial conditions."""
    told = run("08_rllib_ppo.py", "--updates", "28", "--held-out", "100")
    (_, met, clean), (_, met_after, clean_after) = JUDGED.findall(told)
    assert float(met_after) > float(met)
    assert float(clean_after) > float(clean) + 20


def test_infos_hold_cost_of_previous_step():
    scenario = SCENARIO.replace(costs=("rise",))
    robots = RobotSlots(rv.make_vec(scenario, TEAMS, autoreset_mode="SameStep"))
    rollout, paid = Rollout(robots, robots.reset(SEED)), 0.0
    for actions in np.random.default_rng(0).uniform(-1, 1, (9, TEAMS * ROBOTS, 2)):
        slots = np.flatnonzero(robots.active)
        chosen = {Columns.ACTIONS: actions[slots].astype(np.float32)}
        paid += rollout.add(slots, chosen, chosen[Columns.ACTIONS]).costs["cost"].sum()
    episodes = list(rollout.cut())
    assert all(len(one.get_infos()) == len(one.get_rewards()) + 1 for one in episodes)
    assert all(one.get_infos()[0] == {} for one in episodes) and paid > 0
    told = sum(info["cost_rise"] for one in episodes for info in one.get_infos()[1:])
    np.testing.assert_allclose(told, paid)


def test_env_runner_rejects_bad_configuration(local_ray):
    with pytest.raises(ValueError, match="env_to_module_connector is given"):
        small().env_runners(env_to_module_connector=lambda *_: []).build_algo()
    register_env("other mode", lambda settings: rv.make_vec(SCENARIO, settings["num_envs"]))
    with pytest.raises(ValueError, match="SAME_STEP"):
        small().environment("other mode", env_config={}).build_algo()
    with pytest.raises(TypeError, match="spawn_size"):
        small(spawn_sise=2.0)
