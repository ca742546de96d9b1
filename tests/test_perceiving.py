"""The environment of a heading policy, recomputed from its parts."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import rendezvous_env as rv
from rendezvous_env.steering import Steering
from rendezvous_env.vector import HeadingVectorWrapper
from train.perceiving import PerceivingTeams
from train.perception import Perception
from train.run_state import flatten, unflatten
from train.sb3_vec_env import RobotVecEnv

TEAMS, PERIOD = 5, 3
SCENARIO = rv.scenarios.get("clutter-12").replace(time_limit=6.0)


def base(**options):
    return rv.make_vec(SCENARIO, TEAMS, autoreset_mode=AutoresetMode.SAME_STEP, **options)


def teams(**options):
    return PerceivingTeams(base(), decision_period=PERIOD, **options)


def tape(length, seed=0):
    shape = (length, TEAMS, SCENARIO.n_robots, 2)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def test_it_is_the_heading_wrapper_seen_through_perception():
    """Episodes end, and what is shown last is what perception shows with the old memory."""
    ours, plain = teams(), HeadingVectorWrapper(base(), decision_period=PERIOD)
    shown, _ = ours.reset(seed=3)
    plain.reset(seed=3)
    perception = Perception(SCENARIO, TEAMS, decision_time=PERIOD * SCENARIO.tau)
    steering, ended = Steering(SCENARIO, TEAMS), 0
    np.testing.assert_array_equal(shown, perception.see(plain._observed, steering))
    for raw in tape(90):
        final = _final_base_observations(plain, raw)
        shown, rewards, ends, cuts, infos = ours.step(raw)
        _, other_rewards, *_ = plain.step(raw)
        np.testing.assert_array_equal(rewards, other_rewards)
        over = ends | cuts
        last = perception.see(np.where(over[:, None, None, None], final, plain._observed), steering)
        if over.any():
            ended += over.sum()
            seen = np.stack(infos["final_obs"][over].tolist())
            np.testing.assert_array_equal(seen, last[over])
            perception.forget(over)
            steering.forget(over)
            last[over] = perception.see(plain._observed, steering, over)[over]
        np.testing.assert_array_equal(shown, last)
    assert ended >= TEAMS


def _final_base_observations(wrapper, raw):
    """What the robots of teams that end in this decision see in the end, in their own frames."""
    ghost = HeadingVectorWrapper(
        rv.make_vec(SCENARIO, TEAMS, autoreset_mode=AutoresetMode.DISABLED), decision_period=PERIOD
    )
    ghost.set_state(wrapper.get_state())
    ghost.step(raw)
    return ghost._observed


def test_the_first_touch_costs_the_robot_and_nobody_else():
    ours, plain = teams(touch_penalty=7.0), HeadingVectorWrapper(base(), decision_period=PERIOD)
    for env in (ours, plain):
        env.reset(seed=3)
    touched, paid = np.zeros((TEAMS, SCENARIO.n_robots), bool), 0
    for raw in tape(90):
        *_, ends, cuts, infos = ours.step(raw)
        *_, others = plain.step(raw)
        over = (ends | cuts)[:, None]
        contact = infos["contact"]
        if over.any():
            contact = np.where(over, infos["final_info"]["contact"], contact)
        cost = others["robot_rewards"] - infos["robot_rewards"]
        np.testing.assert_allclose(cost, 7.0 * (contact & ~touched), atol=1e-12)
        paid += (cost > 0).sum()
        touched = np.where(over, False, touched | contact)
    assert paid >= 5


def test_robots_go_on_bit_by_bit_from_their_state():
    robots = RobotVecEnv(teams(touch_penalty=1.0))
    robots.seed(8)
    robots.reset()
    actions = tape(80).reshape(80, -1, 2)
    for raw in actions[:30]:
        robots.step(raw)
    state = unflatten(flatten(robots.get_state()))
    other = RobotVecEnv(teams(touch_penalty=1.0))
    other.reset()
    other.set_state(state)
    for raw in actions[30:]:
        for a, b in zip(robots.step(raw)[:3], other.step(raw)[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(robots.bootstrapped, other.bootstrapped)
        np.testing.assert_array_equal(robots.bootstrap_observations, other.bootstrap_observations)
    with pytest.raises(ValueError, match="active must be an array of shape"):
        other.set_state({**state, "active": np.zeros(3)})
    state["teams"]["touched"] = np.zeros(2)
    with pytest.raises(ValueError, match="touched must be an array of shape"):
        other.set_state(state)


def test_other_autoreset_modes_are_refused():
    with pytest.raises(ValueError, match="must be SAME_STEP"):
        PerceivingTeams(rv.make_vec(SCENARIO, 2))
