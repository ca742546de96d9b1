"""Learned policies of unicycles: a frame that does not turn with the body, and tanks on arcs."""

import pickle

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from tanks_that_last import check_v_and_tanks

import baselines
import rendezvous_env as rv
from baselines.learned import checkpoints, shipped
from baselines.learned.guide import CommandedTank, GuidedTeams
from baselines.learned.policy_settings import PolicySettings
from baselines.learned.training_environment import FeatureVectorEnv
from baselines.steady_frames import SteadyFrames
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.safety.tank import certain_descent
from train.learn.settings import Config

CLUTTER = rv.scenarios.get("clutter-12").replace(
    robot_model="unicycle", max_turn_rate=1.5, time_limit=10.0
)
PERIOD = 4
HEADING = PolicySettings(
    8, (16,), clearance=0.2, persistence=0.5, min_alignment=0.1, max_turn_rate=1.2,
    decision_time=PERIOD * CLUTTER.tau,
)  # fmt: skip
TANK = PolicySettings(
    **HEADING.__dict__ | {"guarantee": "tank", "budget": 2.0, "memory": "features"}
)
BOTH = pytest.mark.parametrize("settings", [HEADING, TANK], ids=["heading", "tank"])


def directions(length, teams=3, seed=0):
    shape = (length, teams, CLUTTER.n_robots)
    return np.random.default_rng(seed).integers(9, size=shape)


def yaws(simulator):
    frames = simulator.frames
    return np.arctan2(frames[..., 1, 0], frames[..., 0, 0])


def test_what_is_seen_does_not_turn_with_the_body():
    """For 190 steps of any inputs: rows in the frames of the start."""
    simulator, frames = rv.Simulator(CLUTTER, 3), SteadyFrames(CLUTTER, 3, 0.2)
    seen, random = simulator.reset(5), np.random.default_rng(0)
    start, teams = simulator.frames.copy(), (0, 3, 0)
    for _ in range(190):
        steady = frames.seen(seen, np.arange(3))
        globally = np.einsum("bnij,bnkj->bnki", simulator.frames, seen)
        from_start = np.einsum("bnji,bnkj->bnki", start, globally)
        np.testing.assert_allclose(steady, from_start, atol=2e-6)
        actions = random.uniform(-2.0, 2.0, (3, CLUTTER.n_robots, 2)).astype(np.float32)
        actions[..., 0] *= 0.01
        before = simulator.positions.copy()
        frames.turn(teams, actions)
        seen = simulator.step(actions).observations
        moved = np.einsum("bnij,bnj->bni", start, frames.velocities) * CLUTTER.tau
        free = simulator.contacts == 0
        np.testing.assert_allclose((simulator.positions - before)[free], moved[free], atol=1e-9)
    assert np.abs(yaws(simulator)).max() > 0.5 and free.all()


@BOTH
def test_robots_turn_to_where_they_choose(settings):
    """Choice 0 in the open: the body comes to point along f, and the team meets."""
    free = CLUTTER.replace(obstacles=(), time_limit=60.0)
    guided, simulator = GuidedTeams(settings, free, 4), rv.Simulator(free, 4)
    seen = simulator.reset(1)
    layout = free.observation_layout
    for step in range(500):
        if step == 80:
            f = layout.net_bearing(seen)
            off = np.abs(np.arctan2(f[..., 1], f[..., 0]))
        seen = simulator.step(guided.act(seen)).observations
    assert np.median(off) < 0.1 and (simulator.status == RENDEZVOUS).all()


@pytest.mark.parametrize("model", ["single_integrator", "unicycle"])
@pytest.mark.parametrize("budget", [0.0, 3.0])
def test_v_and_the_tanks_together_never_rise(model, budget):
    """Points choose in every step, unicycles every twenty."""
    settings = PolicySettings(**TANK.__dict__ | {"budget": budget / 0.6})  # in units of r D̄
    scenario, points = CLUTTER.replace(robot_model=model), model == "single_integrator"
    every = 1 if points else 20
    rises, apart = check_v_and_tanks(scenario, settings, level=budget, every=every)
    assert apart > 4 - points and (rises > 20 or (budget == 0.0 and not points))


def test_an_arc_that_is_cut_short_books_no_more_than_it_earned():
    scenario = CLUTTER.replace(obstacles=())
    tank, simulator = CommandedTank(scenario, 50, budget=100.0), rv.Simulator(scenario, 50)
    bodies, random = SteadyFrames(scenario, 50, 0.2), np.random.default_rng(3)
    seen, everyone = simulator.reset(2), (0, 50, 0)
    f = scenario.observation_layout.net_bearing(seen).astype(float)
    tight = 0
    for share in (0.1, 0.5, 0.9, 1.0, 2.0):
        actions = np.zeros((50, scenario.n_robots, 2), np.float32)
        tank.forget()
        tank.hold(random.uniform(-1, 1, actions.shape))
        tank.act_of(everyone, seen, actions)
        bodies.turn(everyone, actions)
        tank.settle(share, bodies.settle(share))
        swept = np.minimum(share, 1.0) * scenario.tau * actions[..., 1].astype(float)
        along = np.minimum(share, 1.0) * scenario.tau * actions[..., 0].astype(float) / swept
        arcs = along[..., None] * np.stack([np.sin(swept), 1.0 - np.cos(swept)], axis=-1)
        for team in range(50):
            for i in range(scenario.n_robots):
                net, moved = (*f[team, i], 0.0), (*arcs[team, i], 0.0)
                exact = certain_descent(net, 3.0, moved, scenario.merge_radius)
                booked = tank.levels[team, i] - 100.0
                assert exact - 0.03 <= booked <= exact + 1e-6
                tight += booked > exact - 1e-3
    assert tight > 200


@BOTH
def test_episodes_go_on_bit_by_bit_from_their_state(settings):
    def make():
        venv = rv.make_vec(CLUTTER, 3, autoreset_mode=AutoresetMode.SAME_STEP)
        return FeatureVectorEnv(venv, settings)

    one, other = make(), make()
    one.reset(seed=3)
    other.reset(seed=9)
    chosen = directions(70)
    for choices in chosen[:20]:
        one.step(choices)
    state = pickle.loads(pickle.dumps(one.get_state()))
    other.set_state(state)
    for choices in chosen[20:]:
        for a, b in zip(one.step(choices)[:4], other.step(choices)[:4], strict=True):
            np.testing.assert_array_equal(a, b)
    state["bodies"]["angles"] = state["bodies"]["angles"][:1]
    with pytest.raises(ValueError, match="angles must be an array of shape"):
        other.set_state(state)


def test_unicycles_have_weights_of_their_own_and_hardly_touch_anything():
    scenario = rv.scenarios.get("clutter-16").replace(robot_model="unicycle", max_turn_rate=1.0)
    folder = shipped.folder("learned-tank", scenario)
    assert folder != shipped.folder("learned-tank")
    policy = baselines.make("learned-tank", scenario)
    trained = Config.from_plain(checkpoints.describe(folder)["config"])
    assert policy.settings == trained.policy_settings()
    assert trained.base_scenario().robot_model == "unicycle"
    found = rv.rollout(scenario, policy, seed=2000, num_envs=60, record=())
    clean = found.success & ~found.contacts.any(axis=(0, 2))
    assert clean.sum() >= 57


def test_a_robot_that_ticks_sooner_turns_its_memory_by_what_it_turned():
    """Ten ticks of τ/4: the body has turned by ω τ/4 in each."""
    robot = baselines.RobotPolicy(CLUTTER, "learned-tank")
    guided, turned = None, 0.0
    for _ in range(10):
        angle = 2.0 - turned
        action = robot.act([[np.cos(angle), np.sin(angle)]], dt=CLUTTER.tau / 4)
        guided = robot.policy._guided
        ahead = guided.bodies.seen(robot._team, np.arange(1))[
            0, 0, 0
        ]  # after the step that was commanded
        turned += float(action[1]) * CLUTTER.tau / 4
        whole = float(action[1]) * CLUTTER.tau
        assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(2.0 + whole, abs=1e-6)
    assert turned == pytest.approx(1.5 * 10 * CLUTTER.tau / 4)
