"""A model plays as it was trained: what it sees, how often it decides, what becomes of it."""

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines import TrainedPolicy
from rendezvous_env.vector import training_env

OPEN = rv.scenarios.get("clutter-4").replace(obstacles=(), time_limit=6.0, merge_radius=0.05)
CARS = rv.scenarios.get("unicycle-6").replace(time_limit=3.0, merge_radius=0.05)
TEAMS, DECISIONS = 3, 4


class Model:
    """Chooses by every number it is shown; gives a state, too, as stable-baselines3 does."""

    def __init__(self, size, choices=None):
        self.size, self.choices = size, choices

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic and observation.ndim == 2
        weights = np.cos(np.arange(observation.shape[-1] * self.size)).reshape(-1, self.size)
        chosen = np.tanh(observation @ weights)
        if self.choices is not None:
            chosen = (np.abs(chosen[:, 0]) * self.choices).astype(np.int64)
        return chosen.astype(np.float32 if self.choices is None else np.int64), None


CASES = [
    (OPEN, {}),
    (OPEN, {"discrete": True}),
    (OPEN, {"guarantee": "tank"}),
    (OPEN, {"min_alignment": 0.3, "decision_period": 3}),
    (OPEN, {"learning_preset": False}),
    (OPEN, {"learning_preset": False, "flatten": False, "frame": "local"}),
    (OPEN, {"learning_preset": False, "guarantee": "tank", "budget": 1.0, "observe_level": True}),
    (OPEN, {"learning_preset": False, "guarantee": "gains"}),
    (OPEN, {"learning_preset": False, "guarantee": "links"}),
    (OPEN, {"learning_preset": False, "guarantee": None}),
    (CARS, {}),
    (CARS, {"guarantee": "tank"}),
]


@pytest.mark.parametrize(("scenario", "arguments"), CASES)
def test_robots_move_as_in_the_training_environment(scenario, arguments):
    teams = training_env(scenario, TEAMS, autoreset_mode="Disabled", **arguments)
    space = teams.single_action_space
    discrete = arguments.get("discrete", False)
    model = Model(1 if discrete else space.shape[-1], 9 if discrete else None)
    table = not arguments.get("flatten", True)

    def predict(observation, deterministic=False):
        rows = observation.reshape(len(observation), -1)
        return model.predict(rows, deterministic=deterministic)

    policy = TrainedPolicy(scenario, predict if table else model.predict, **arguments)
    seen, _ = teams.reset(seed=3)
    simulator = rv.Simulator(teams.scenario, TEAMS)
    own = simulator.reset(3)
    period = getattr(teams.env, "decision_period", 1)
    for _ in range(DECISIONS):
        rows = seen.reshape(-1, *seen.shape[2:])
        chosen = predict(rows, deterministic=True)[0].reshape(TEAMS, *space.shape)
        seen, *_ = teams.step(chosen)
        for _ in range(period):
            own = simulator.step(policy(own, simulator.time)).observations
        apart = simulator.active.all(axis=1)  # a policy's tank is not told of a merge
        there, here = teams.simulator.positions, simulator.positions
        assert apart.any()
        np.testing.assert_allclose(here[apart], there[apart], atol=1e-6)
    start = rv.Simulator(teams.scenario, TEAMS)
    start.reset(3)
    assert np.abs(simulator.positions - start.positions).max() > 1e-3


def test_a_model_of_whole_teams_is_asked_for_teams():
    asked = []

    def predict(seen):
        asked.append(seen.shape)
        return np.zeros((*seen.shape[:2], 2))

    policy = TrainedPolicy("clutter-4", predict, by_team=True)
    found = rv.rollout("clutter-4", policy, seed=0, num_envs=3)
    assert {shape[:2] for shape in asked} == {(3, 4)}
    assert found.success.any()  # no direction at all is the rule itself


def test_what_is_no_model_is_refused():
    with pytest.raises(ValueError, match="predict is 3; it must be a function of observations"):
        TrainedPolicy("duo", 3)
    with pytest.raises(TypeError, match="guarante"):
        TrainedPolicy("duo", lambda seen: seen, guarante="tank")
    policy = TrainedPolicy("duo", lambda seen: seen)
    with pytest.raises(ValueError, match=r"predict gave an array of shape .* it must be \(2, 2\)"):
        policy(rv.Simulator(rv.scenarios.get("duo"), 1).reset(0), 0.0)


# ---- dicts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("flatten", [False, True])
@pytest.mark.parametrize("name", ["bearing-only", "tangent-joined-tuned", "learned", "tank-joined"])
def test_policies_take_pettingzoos_dicts_whoever_has_merged(name, flatten):
    scenario = rv.scenarios.get("clutter-4").replace(time_limit=8.0, merge_radius=1.0)
    env, policy = rv.parallel_env(scenario, flatten=flatten), baselines.make(name, scenario)
    observations, _ = env.reset(seed=1)
    found, counts = [], set()
    while env.agents:
        actions = policy(observations, env.unwrapped.simulator.time[0])
        assert list(actions) == list(observations)
        counts.add(len(actions))
        observations, *_ = env.step({robot: actions[robot] for robot in env.agents})
        observations = {robot: observations[robot] for robot in env.agents}
        found.append(env.unwrapped.simulator.positions[0].copy())
    policy.reset()
    batch = rv.rollout(scenario, policy, seed=1)
    assert len(counts) > 1
    np.testing.assert_allclose(found, batch.positions[1 : len(found) + 1, 0], atol=1e-9)


def test_unknown_robots_and_other_shapes_are_refused():
    policy = baselines.make("bearing-only", "duo")
    assert policy({}, 0.0) == {}
    with pytest.raises(KeyError, match="no robot is called 'robot_2'"):
        policy({"robot_2": np.zeros((1, 2))}, 0.0)
    with pytest.raises(ValueError, match="observation of robot_0 has shape"):
        policy({"robot_0": np.zeros(5)}, 0.0)
