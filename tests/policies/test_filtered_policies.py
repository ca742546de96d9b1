"""Functions and models as policies, compared with wrappers and training environments."""

from functools import partial
from operator import itemgetter

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines import HeadingPolicy, TankPolicy, TrainedPolicy
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.trajectory import begin
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env

CLUTTER = rv.scenarios.get("clutter-12").replace(time_limit=4.0)
OPEN = rv.scenarios.get("clutter-4").replace(obstacles=(), time_limit=6.0, merge_radius=0.05)
CARS = rv.scenarios.get("unicycle-6").replace(time_limit=4.0, merge_radius=0.05)
SPACE = rv.scenarios.get("uav-6").replace(time_limit=4.0)
TEAMS = 4


def mixed(numbers, size):
    """Choices from −1 to 1 that depend on every number."""
    weights = np.cos(np.arange(numbers.shape[-1] * size)).reshape(-1, size)
    return np.tanh(numbers @ weights)


class Sideways:
    """Choices that depend on every row, so that any difference changes them."""

    def __init__(self, size):
        self.size, self.asked = size, 0

    def __call__(self, observations):
        self.asked += 1
        return mixed(observations[..., 0], self.size)


def places_of(wrapper, choose, periods):
    """Positions after each period."""
    seen, _ = wrapper.reset(seed=3)
    places = []
    for _ in range(periods):
        seen, *_ = wrapper.step(choose(seen))
        places.append(wrapper.env.simulator.positions)
    return np.stack(places)


def places_under(policy, scenario, steps, period):
    """Positions of a policy after each period."""
    simulator = rv.Simulator(scenario, TEAMS)
    seen, places = simulator.reset(3), []
    for step in range(1, steps + 1):
        seen = simulator.step(policy(seen, simulator.time)).observations
        places += [simulator.positions] if step % period == 0 else []
    return np.stack(places), simulator


def test_single_integrators_of_mixed_teams_keep_their_direction_at_the_speed_limit():
    """Commands are those of the filter, no longer than the limit, and parallel to them."""
    team = rv.Scenario(
        n_robots=6, robot_model=["single_integrator"] * 5 + ["unicycle"], max_speed=0.5
    )
    choose = team.observation_layout.net_bearing
    policy = HeadingPolicy(team, choose, frame="local")
    safety = HeadingFilter(team, 3, frame="local")
    seen = rv.Simulator(team, 3).reset(0)
    safety.hold(choose(seen))
    wanted, sent = safety.compute(seen)[:, :5], policy(seen, 0.0)[:, :5]
    sizes = np.linalg.norm(wanted, axis=-1, keepdims=True)
    assert (sizes > 0.6).sum() > 5
    np.testing.assert_allclose(sent, wanted * np.minimum(1.0, 0.5 / sizes), atol=1e-6)


@pytest.mark.parametrize(
    ("make", "models", "said"),
    [
        (HeadingPolicy, "single_integrator", "k = 2 parts of a heading vector"),
        (HeadingPolicy, "unicycle", "k = 1 turn rates in units of the maximum"),
        (HeadingPolicy, ["single_integrator", "unicycle"], "or for nonholonomic robots first turn"),
        (TankPolicy, "unicycle", "k = 2 parts of an action in units of its bounds"),
    ],
)
def test_wrong_shape_of_choose_names_its_numbers(make, models, said):
    policy = make(rv.Scenario(n_robots=2, robot_model=models), lambda seen: np.zeros((1, 2, 7)))
    with pytest.raises(ValueError, match=r"choose returned shape \(1, 2, 7\)") as caught:
        policy(np.zeros((1, 2, 1, 2), np.float32), 0.0)
    assert said in str(caught.value)


class TestFunctions:
    @pytest.mark.parametrize("period", [1, 4])
    @pytest.mark.parametrize(
        ("scenario", "options"),
        [
            (CLUTTER, {}),
            (CLUTTER, {"frame": "local", "min_alignment": 0.4, "max_turn_rate": 1.0}),
            (CLUTTER, {"certified": False}),
            (CLUTTER, {"bearing_error": 0.1}),
            (CARS, {"max_turn_rate": 0.5}),
            (SPACE, {}),
            # until something touches or merges, of which tanks are not told
            (CLUTTER.replace(obstacles=()), {"budget": 0.5, "observe_level": True}),
        ],
    )
    def test_policy_equals_wrapper(self, scenario, options, period):
        tank = "budget" in options
        steps, make, wrap = 40, HeadingPolicy, HeadingVectorWrapper
        if tank:
            steps, make, wrap = 20, TankPolicy, EnergyTankWrapper
        venv = rv.make_vec(scenario, TEAMS, autoreset_mode="Disabled")
        wrapper = wrap(venv, decision_period=period, **options)
        choose = Sideways(wrapper.single_action_space.shape[-1])
        wanted = places_of(wrapper, choose, steps // period)
        policy, choose.asked = make(scenario, choose, decision_period=period, **options), 0
        found, simulator = places_under(policy, scenario, steps, period)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=0.0 if tank else 1e-6)
        assert choose.asked == steps // period
        assert np.abs(wanted[-1] - wanted[0]).max() > 0.3
        if tank:
            assert simulator.active.all() and (policy.levels != 0.5).any()
            np.testing.assert_array_equal(policy.levels, wrapper.tank.levels)

    @pytest.mark.parametrize("make", [HeadingPolicy, TankPolicy])
    def test_function_may_modify_observations(self, make):
        def spoils(observations):
            chosen = Sideways(2)(observations)
            observations[...] *= -1.0
            return chosen

        policies = (make(CLUTTER, choose, frame="local") for choose in (Sideways(2), spoils))
        usual, spoilt = (places_under(policy, CLUTTER, 10, 1)[0] for policy in policies)
        np.testing.assert_array_equal(spoilt, usual)

    def test_certified_headings_have_alignment_guarantee(self):
        assert HeadingPolicy(CLUTTER, Sideways(2)).min_alignment == 0.1
        assert HeadingPolicy(CLUTTER, Sideways(2), certified=False).min_alignment is None

    def test_reset_resets_function(self):
        class Counts(Sideways):
            def reset(self, mask):
                self.forgot = mask

        choose = Counts(2)
        policy = HeadingPolicy(CLUTTER, choose)
        policy.reset()
        assert choose.forgot is None
        policy(np.zeros((2, CLUTTER.n_robots, *CLUTTER.observation_layout.shape)), 0.0)
        policy.reset(np.array([True, False]))
        np.testing.assert_array_equal(choose.forgot, [True, False])

    def test_faster_ticks_keep_decision_rate(self):
        choose = Sideways(2)
        policy = HeadingPolicy(CLUTTER, choose, decision_period=4, frame="local", max_turn_rate=1.0)
        robot, tau = baselines.RobotPolicy(CLUTTER, policy), CLUTTER.tau
        bearings = np.array([[0.0, 1.0], [0.6, 0.8]])
        first = robot.act(bearings)
        for _ in range(7):
            last = robot.act(bearings, dt=tau / 2)
        assert choose.asked == 1
        last = robot.act(bearings, dt=tau / 2)
        assert choose.asked == 2 and last @ first > 0.0

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"choose": 3}, "choose is 3; it must be a function of observations"),
            ({"min_alignment": 2.0}, "min_alignment is 2.0"),
            ({"frame": "mine"}, "frame is 'mine'"),
            ({"decision_period": 0}, "decision_period is 0; it must be an integer"),
            ({"scenario": rv.Scenario(robot_model="double_integrator")}, r"law \(4\) needs robots"),
        ],
    )
    def test_invalid_arguments_are_rejected(self, options, message):
        with pytest.raises(ValueError, match=message):
            HeadingPolicy(**{"scenario": CLUTTER, "choose": Sideways(2), **options})

    def test_invalid_action_names_robot(self):
        n, layout = CLUTTER.n_robots, CLUTTER.observation_layout
        seen, raw = np.zeros((3, n, *layout.shape)), np.zeros((3, n, 2))
        raw[1, 2, 0] = np.nan
        for choice, given, message in (
            ([0.0, 1.0], seen, rf"choose returned .* \(2,\); .* \(3, {n}, 2\)"),
            (raw, seen, "action of robot_2 in environment 1 is"),
            (raw, seen[:, :1], "observations have shape"),
        ):
            with pytest.raises(ValueError, match=message):
                HeadingPolicy(CLUTTER, lambda _, choice=choice: choice)(given, 0.0)


class TestModels:
    @pytest.mark.parametrize(
        ("scenario", "arguments"),
        [
            (OPEN, {}),
            (OPEN, {"discrete": True}),
            (OPEN, {"guarantee": "tank"}),
            (OPEN, {"min_alignment": 0.3, "decision_period": 3}),
            (OPEN, {"learning_preset": False}),
            (OPEN, {"learning_preset": False, "flatten": False, "frame": "local"}),
            (OPEN, {"learning_preset": False, "guarantee": "tank", "budget": 1.0,
                    "observe_level": True}),
            (OPEN, {"learning_preset": False, "guarantee": "gains"}),
            (OPEN, {"learning_preset": False, "guarantee": "links"}),
            (OPEN, {"learning_preset": False, "guarantee": None}),
            (OPEN, {"n_robots": 6, "time_step": 0.02}),
            (OPEN, {"learning_preset": False, "n_robots": 6}),
            (OPEN, {"learning_preset": False, "guarantee": None, "n_robots": 6}),
            (CARS, {}),
            (CARS, {"guarantee": "tank"}),
        ],
    )  # fmt: skip
    def test_model_policy_equals_training_environment(self, scenario, arguments):
        teams = training_env(scenario, TEAMS, autoreset_mode="Disabled", **arguments)
        space = teams.single_action_space
        discrete = arguments.get("discrete", False)
        dims = 2 if arguments.get("flatten", True) else 3

        def predict(observation, state=None, episode_start=None, deterministic=False):
            """Model that also returns a state, as in stable-baselines3."""
            assert deterministic and observation.ndim == dims
            rows = observation.reshape(len(observation), -1)
            chosen = mixed(rows, 1 if discrete else space.shape[-1])
            chosen = np.abs(9 * chosen[:, 0]).astype(int) if discrete else chosen.astype(np.float32)
            return chosen, None

        policy = TrainedPolicy(scenario, predict, **arguments)
        seen, _ = teams.reset(seed=3)
        simulator = rv.Simulator(teams.scenario, TEAMS)
        own = simulator.reset(3)
        start = simulator.positions.copy()
        for _ in range(4):
            rows = seen.reshape(-1, *seen.shape[2:])
            chosen = predict(rows, deterministic=True)[0].reshape(TEAMS, *space.shape)
            seen, *_ = teams.step(chosen)
            for _ in range(getattr(teams.env, "decision_period", 1)):
                own = simulator.step(policy(own, simulator.time)).observations
            apart = simulator.active.all(axis=1)  # a policy's tank is not told of a merge
            assert apart.any()
            here, there = simulator.positions[apart], teams.simulator.positions[apart]
            np.testing.assert_allclose(here, there, atol=1e-6)
        assert np.abs(simulator.positions - start).max() > 1e-3

    def test_team_model_receives_whole_teams(self):
        asked = []

        def predict(seen):
            asked.append(seen.shape)
            return np.zeros((*seen.shape[:2], 2))

        policy = TrainedPolicy("clutter-4", predict, by_team=True)
        found = rv.rollout("clutter-4", policy, seed=0, num_envs=3)
        assert {shape[:2] for shape in asked} == {(3, 4)}
        assert found.success.any()  # no direction at all is the rule itself

    def test_deterministic_argument_is_passed(self):
        told = []

        def predict(seen, *, deterministic=False):
            told.append(deterministic)
            return np.zeros((len(seen), 2))

        class Caller:
            def __call__(self, seen, deterministic=False):
                return predict(seen, deterministic=deterministic)

        seen = rv.Simulator(rv.scenarios.get("duo"), 1).reset(0)
        for model in (predict, partial(predict), Caller()):
            TrainedPolicy("duo", model)(seen, 0.0)
        TrainedPolicy("duo", itemgetter((slice(None), slice(2))))(seen, 0.0)  # says nothing
        assert told == [True] * 3

    def test_invalid_model_is_rejected(self):
        with pytest.raises(ValueError, match="predict is 3; it must be a function of observations"):
            TrainedPolicy("duo", 3)
        with pytest.raises(TypeError, match="guarante"):
            TrainedPolicy("duo", lambda seen: seen, guarante="tank")
        policy = TrainedPolicy("duo", lambda seen: seen)
        with pytest.raises(ValueError, match=r"output of predict .*; it must be \(2, 2\)"):
            policy(rv.Simulator(rv.scenarios.get("duo"), 1).reset(0), 0.0)
        policy = TrainedPolicy("duo", lambda seen: np.full(len(seen), 1.5), discrete=True)
        with pytest.raises(
            ValueError, match=r"robot_0 in environment 0 is 1.5; it must be an integer"
        ):
            policy(rv.Simulator(rv.scenarios.get("duo"), 1).reset(0), 0.0)


@pytest.mark.parametrize(
    ("made_for", "played", "message"),
    [
        ("clutter-4", "clutter-8", "made for 'clutter-4'; in 'clutter-8' obstacle_slots is 8 inst"),
        ("duo", "ring-12", "made for 'duo'; in 'ring-12' neighbour_slots is 2 instead of 1"),
        (
            rv.Scenario(n_robots=3, name="free"),
            rv.Scenario(n_robots=3, name="turning", robot_model="unicycle"),
            "robot_model is 'unicycle' instead of 'single_integrator': make the policy with",
        ),
    ],
)
def test_policy_made_for_another_scenario_is_rejected_with_both_values(made_for, played, message):
    policy = HeadingPolicy(made_for, itemgetter((..., 0, slice(None))))
    with pytest.raises(ValueError, match=message):
        rv.rollout(played, policy)


class TestDicts:
    @pytest.mark.parametrize("flatten", [False, True])
    @pytest.mark.parametrize(
        "name",
        ["bearing-only", "tangent-merged-tuned", "learned", "tank-merged", "privileged-planner"],
    )
    def test_policies_accept_pettingzoo_dicts(self, name, flatten):
        scenario = rv.scenarios.get("clutter-4").replace(time_limit=8.0, merge_radius=1.0)
        env, policy = rv.parallel_env(scenario, flatten=flatten), baselines.make(name, scenario)
        observations, _ = env.reset(seed=1)
        begin(policy, env.unwrapped.simulator)
        found, counts = [], set()
        while env.agents:
            actions = policy(observations, env.unwrapped.simulator.time[0])
            assert list(actions) == list(observations)
            counts.add(len(actions))
            observations, *_ = env.step({robot: actions[robot] for robot in env.agents})
            observations = {robot: observations[robot] for robot in env.agents}
            found.append(env.unwrapped.simulator.positions[0].copy())
        batch = rv.rollout(scenario, policy, seed=1)
        assert len(counts) > 1
        np.testing.assert_allclose(found, batch.positions[1 : len(found) + 1, 0], atol=1e-9)

    def test_unknown_agents_and_shapes_are_rejected(self):
        policy = baselines.make("bearing-only", "duo")
        assert policy({}, 0.0) == {}
        with pytest.raises(KeyError, match="there is no robot 'robot_2'"):
            policy({"robot_2": np.zeros((1, 2))}, 0.0)
        with pytest.raises(ValueError, match="observation of robot_0 has shape"):
            policy({"robot_0": np.zeros(5)}, 0.0)
