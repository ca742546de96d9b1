"""Functions of what robots see as policies: they do and keep what the wrappers do and keep."""

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines import HeadingPolicy, TankPolicy
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper

CLUTTER = rv.scenarios.get("clutter-12").replace(time_limit=4.0)
CARS = rv.scenarios.get("unicycle-6").replace(time_limit=4.0)
SPACE = rv.scenarios.get("uav-6").replace(time_limit=4.0)
TEAMS, STEPS = 4, 40


class Sideways:
    """Depends on every row, so that whoever is shown anything else chooses otherwise."""

    def __init__(self, size):
        self.size, self.asked = size, 0

    def __call__(self, observations):
        self.asked += 1
        weights = np.cos(np.arange(observations.shape[-2] * self.size)).reshape(-1, self.size)
        return np.tanh(observations[..., 0] @ weights)


def actions_of_wrapper(wrapper, choose, periods):
    """Positions after each period."""
    seen, _ = wrapper.reset(seed=3)
    places = []
    for _ in range(periods):
        seen, *_ = wrapper.step(choose(seen))
        places.append(wrapper.env.simulator.positions)
    return np.stack(places)


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
    ],
)
def test_it_moves_robots_as_the_wrapper_does(scenario, options, period):
    venv = rv.make_vec(scenario, TEAMS, autoreset_mode="Disabled")
    wrapper = HeadingVectorWrapper(venv, decision_period=period, **options)
    choose = Sideways(wrapper.single_action_space.shape[-1])
    wanted = actions_of_wrapper(wrapper, choose, STEPS // period)
    policy = HeadingPolicy(scenario, choose, decision_period=period, **options)
    simulator, choose.asked = rv.Simulator(scenario, TEAMS), 0
    seen = simulator.reset(3)
    for step in range(1, STEPS + 1):
        seen = simulator.step(policy(seen, simulator.time)).observations
        if step % period == 0:
            found = simulator.positions
            np.testing.assert_allclose(found, wanted[step // period - 1], rtol=0, atol=1e-6)
    assert choose.asked == STEPS // period
    assert np.abs(wanted[-1] - wanted[0]).max() > 0.3


def test_a_tank_does_as_the_wrapper_until_something_touches_or_merges():
    scenario = CLUTTER.replace(obstacles=())
    options = {"budget": 0.5, "observe_level": True, "decision_period": 2}
    wrapper = EnergyTankWrapper(rv.make_vec(scenario, TEAMS, autoreset_mode="Disabled"), **options)
    choose = Sideways(2)
    wanted = actions_of_wrapper(wrapper, choose, 10)
    policy, simulator = TankPolicy(scenario, choose, **options), rv.Simulator(scenario, TEAMS)
    seen = simulator.reset(3)
    for step in range(1, 21):
        seen = simulator.step(policy(seen, simulator.time)).observations
        if step % 2 == 0:
            np.testing.assert_array_equal(simulator.positions, wanted[step // 2 - 1])
    assert simulator.active.all() and (policy.levels != 0.5).any()
    np.testing.assert_array_equal(policy.levels, wrapper.tank.levels)


def test_a_margin_is_promised_where_headings_are_certified():
    assert HeadingPolicy(CLUTTER, Sideways(2)).min_alignment == 0.1
    assert HeadingPolicy(CLUTTER, Sideways(2), certified=False).min_alignment is None


def test_the_memory_of_what_chooses_is_forgotten_too():
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


def test_a_robot_that_ticks_twice_as_often_decides_as_often():
    choose = Sideways(2)
    policy = HeadingPolicy(CLUTTER, choose, decision_period=4, frame="local", max_turn_rate=1.0)
    robot, tau = baselines.RobotPolicy(CLUTTER, policy), CLUTTER.tau
    bearings = np.array([[0.0, 1.0], [0.6, 0.8]])
    first = robot.act(bearings)
    for _ in range(7):
        robot.act(bearings, dt=tau / 2)
    assert choose.asked == 1
    robot.act(bearings, dt=tau / 2)
    assert choose.asked == 2 and policy._filter.headings[0, 0] @ first > 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"choose": 3}, "choose is 3; it must be a function of observations"),
        ({"min_alignment": 2.0}, "min_alignment is 2.0"),
        ({"frame": "mine"}, "frame is 'mine'"),
        ({"decision_period": 0}, "decision_period is 0; it must be a whole number"),
        ({"scenario": rv.Scenario(robot_model="double_integrator")}, r"law \(4\) needs robots"),
    ],
)
def test_what_cannot_be_is_refused_when_it_is_made(options, message):
    with pytest.raises(ValueError, match=message):
        HeadingPolicy(**{"scenario": CLUTTER, "choose": Sideways(2), **options})


def test_what_is_chosen_wrongly_is_refused_by_its_robot():
    n, layout = CLUTTER.n_robots, CLUTTER.observation_layout
    seen = np.zeros((3, n, *layout.shape))
    with pytest.raises(ValueError, match=rf"choose gave .* \(2,\); .* \(3, {n}, 2\)"):
        HeadingPolicy(CLUTTER, lambda _: [0.0, 1.0])(seen, 0.0)
    raw = np.zeros((3, n, 2))
    raw[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="action of robot_2 in team 1 is"):
        HeadingPolicy(CLUTTER, lambda _: raw)(seen, 0.0)
    with pytest.raises(ValueError, match="observations have shape"):
        HeadingPolicy(CLUTTER, lambda _: raw)(seen[:, :1], 0.0)
    assert baselines.HeadingPolicy is HeadingPolicy
