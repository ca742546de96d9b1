"""Training environment of a heading policy, recomputed from its parts."""

from dataclasses import replace

import numpy as np
import pytest
import test_nonholonomic_features
from gymnasium.vector import AutoresetMode
from test_nonholonomic_features import CARS, POINTS, UAV

import rendezvous_env as rv
from baselines.learned.base_controller import BaseController
from baselines.learned.features import Features
from baselines.learned.policy_settings import ALL_ROUND, ANGLES, CHOICES
from baselines.learned.training_environment import FeatureVectorEnv
from baselines.obstacle_rules.obstacle_avoidance import tangent_merged_heading
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.vector import HeadingVectorWrapper, training_env
from train.learn.checkpoint import flatten, unflatten

TEAMS, PERIOD = 5, 3
SCENARIO = rv.scenarios.get("clutter-12").replace(time_limit=6.0)
CHANGES = {"clearance": 0.1, "max_turn_rate": 3.0, "decision_time": PERIOD * SCENARIO.tau}
HEADING = replace(test_nonholonomic_features.HEADING, **CHANGES)
TANK = replace(test_nonholonomic_features.TANK, budget=0.5, **CHANGES)


def aim(observations, choices, carried):
    """Merged-interval rule with f rotated by the chosen angle."""
    layout, (c, s) = SCENARIO.observation_layout, (np.cos(ANGLES[choices]), np.sin(ANGLES[choices]))
    x, y = np.moveaxis(layout.net_bearing(observations), -1, 0)
    turned = np.stack((c * x - s * y, s * x + c * y), axis=-1)
    limits = {"clearance": HEADING.clearance, "persistence": HEADING.persistence}
    obstacles = layout.split(observations).obstacles
    return tangent_merged_heading(turned, obstacles, carried=carried, **limits)


def teams(settings=HEADING, mode=AutoresetMode.SAME_STEP, scenario=SCENARIO, **options):
    return FeatureVectorEnv(rv.make_vec(scenario, TEAMS, autoreset_mode=mode), settings, **options)


def tape(length, seed=0, choices=CHOICES):
    """Choices that prevent straight motion, so that episodes are long and have contacts."""
    shape = (length, TEAMS, SCENARIO.n_robots)
    return np.random.default_rng(seed).integers(choices, size=shape)


def test_environment_is_heading_wrapper_with_features():
    """At an episode end, the final features use the old memory."""
    ours = teams()
    venv = rv.make_vec(SCENARIO, TEAMS, autoreset_mode=AutoresetMode.DISABLED)
    wrapper = HeadingVectorWrapper(venv, frame="local")
    shown, _ = ours.reset(seed=3)
    seen, _ = wrapper.reset(seed=3)
    perception = Features(SCENARIO, TEAMS, decision_time=PERIOD * SCENARIO.tau)
    headings, ended = wrapper.steering, 0
    np.testing.assert_array_equal(shown, perception.see(seen, headings.headings))
    for choices in tape(60):
        shown, rewards, ends, cuts, infos = ours.step(choices)
        wanted = np.zeros(TEAMS)
        for _ in range(PERIOD):
            seen, earned, *_ = wrapper.step(aim(seen, choices, headings.headings))
            wanted += earned
        over = wrapper.env.simulator.ended
        np.testing.assert_array_equal(rewards, wanted)
        np.testing.assert_array_equal(ends | cuts, over)
        last = perception.see(seen, headings.headings)
        if over.any():
            ended += over.sum()
            np.testing.assert_array_equal(np.stack(infos["final_obs"][over].tolist()), last[over])
            seen, _ = wrapper.reset(options={"reset_mask": over})
            perception.forget(over)
            last[over] = perception.see(seen, headings.headings, over)[over]
        np.testing.assert_array_equal(shown, last)
    assert ended >= TEAMS


PRICED = {
    "choices": (1, lambda mode, price: teams(mode=mode, contact_penalty=price)),
    "velocities": (50, lambda mode, price: training_env(
        SCENARIO, TEAMS, guarantee=None, autoreset_mode=mode, contact_penalty=price
    )),
}  # fmt: skip
"""Duration and owner of choices that prevent robots from resting."""


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("form", PRICED)
def test_first_contact_costs_robot_once(form, mode):
    held, made = PRICED[form]
    free, paid = (made(mode, price) for price in (0.0, 7.0))
    for env in (free, paid):
        env.reset(seed=3)
    free.action_space.seed(0)
    touched, touches = np.zeros((TEAMS, SCENARIO.n_robots), bool), 0
    for step in range(300):
        if step % held == 0:
            actions = free.action_space.sample()
        _, bare, ends, cuts, infos = free.step(actions)
        _, rewards, *_, told = paid.step(actions)
        contact, over = infos["contact"], (ends | cuts)[:, None]
        if "final_info" in infos:
            contact = np.where(over, infos["final_info"]["contact"], contact)
            last = told["final_info"]["robot_rewards"]
            np.testing.assert_array_equal(last, told["robot_rewards"])
        first = contact & ~touched
        cost = infos["robot_rewards"] - told["robot_rewards"]
        np.testing.assert_allclose(cost, 7.0 * first, atol=1e-12)
        np.testing.assert_allclose(bare - rewards, cost.mean(axis=1), atol=1e-12)
        touched, touches = (touched | contact) & ~over, touches + first.sum()
    assert touches > 1


def test_tank_robots_move_at_speed_of_law_1():
    """Without obstacles, also away from f; the velocity is along R(φ) f."""
    free = SCENARIO.replace(obstacles=())
    settings = replace(TANK, budget=1e6)
    controller, simulator = BaseController(settings, free, 4), rv.Simulator(free, 4)
    observations = simulator.reset(0)
    choices = np.arange(16).reshape(4, 4) % len(ALL_ROUND)
    controller.choose(choices)
    v = controller.apply(observations).astype(np.float64)
    f = free.observation_layout.net_bearing(observations)
    turned = np.arctan2(f[..., 0] * v[..., 1] - f[..., 1] * v[..., 0], np.sum(f * v, axis=-1))
    off = np.abs(np.angle(np.exp(1j * (turned - ALL_ROUND[choices]))))
    np.testing.assert_allclose(off, 0.0, atol=1e-5)
    strength = np.linalg.norm(f, axis=-1)
    scale = np.minimum(1.0, free.merge_radius / (2 * 3 * free.tau))
    expected = np.minimum(free.max_speed, scale * strength)
    np.testing.assert_allclose(np.linalg.norm(v, axis=-1), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("scenario", "settings", "steps"),
    [
        *((SCENARIO, settings, 80) for settings in (HEADING, TANK)),
        *((CARS, settings, 70) for settings in (HEADING, TANK)),
        (POINTS, TANK, 20),
        (UAV, TANK, 20),
    ],
)
def test_state_resumes_bitwise(scenario, settings, steps):
    robots, other = (
        RobotVecEnv(teams(settings, scenario=scenario, contact_penalty=1.0)) for _ in range(2)
    )
    robots.seed(8)
    for each in (robots, other):
        each.reset()
    shape = steps, robots.num_envs
    actions = np.random.default_rng(0).integers(len(settings.angles), size=shape)
    for raw in actions[: steps // 3]:
        robots.step(raw)
    state = unflatten(flatten(robots.get_state()))
    other.set_state(state)
    for raw in actions[steps // 3 :]:
        for a, b in zip(robots.step(raw)[:3], other.step(raw)[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(robots.bootstrapped, other.bootstrapped)
        np.testing.assert_array_equal(robots.bootstrap_observations, other.bootstrap_observations)
    if bodies := state["teams"].get("bodies"):
        bodies["angles"] = np.zeros(2)
        with pytest.raises(ValueError, match="angles must be an array of shape"):
            other.set_state(state)


def test_autoreset_modes_agree_until_episode_end():
    """Final features are equal; a partial reset keeps the features of the others."""
    modes = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)
    same, following, held = (teams(mode=mode) for mode in modes)
    for each in (same, following, held):
        each.reset(seed=1)
    for choices in tape(60):
        shown, *_, ends, cuts, infos = same.step(choices)
        over = ends | cuts
        later, *_ = following.step(choices)
        rested, *_ = held.step(choices)
        if over.any():
            break
        np.testing.assert_array_equal(later, shown)
    final = np.stack(infos["final_obs"][over].tolist())
    np.testing.assert_array_equal(later[over], final)
    np.testing.assert_array_equal(rested[over], final)
    np.testing.assert_array_equal(following.step(choices)[0][over], shown[over])
    one = np.arange(TEAMS) == 1
    begun, _ = held.reset(options={"reset_mask": one})
    np.testing.assert_array_equal(begun[one], shown[one])
    np.testing.assert_array_equal(begun[~one], rested[~one])


def test_masked_reset_keeps_features_of_others():
    """It returned features from before the state was restored, or zeros."""
    env, again = teams(mode=AutoresetMode.DISABLED), teams(mode=AutoresetMode.DISABLED)
    env.reset(seed=1)
    choices = tape(6)
    for raw in choices[:3]:
        seen, *_ = env.step(raw)
    state = env.get_state()
    for raw in choices[3:]:
        env.step(raw)
    one = np.arange(TEAMS) == 1
    for each in (env, again):
        each.set_state(state)
        shown, _ = each.reset(options={"reset_mask": one})
        np.testing.assert_array_equal(shown[~one], seen[~one])
    del state["shown"]  # as runs of older versions have it
    again.set_state(state)
    np.testing.assert_array_equal(env.step(choices[3])[0][~one], again.step(choices[3])[0][~one])


def test_rewards_are_independent_of_other_environments():
    """A contact elsewhere in the batch changed all rewards to means of robot rewards."""

    @rv.reward_term("effort of some")
    def effort(step):
        return np.abs(step.actions[..., 0]) * np.arange(step.actions.shape[1])

    near = rv.Disc((0.0, 0.0), 0.8)
    scenario = SCENARIO.replace(
        n_robots=4, spawn_size=6.0, obstacles=(near,), merge_radius=0.3, local_frames="global",
        reward=rv.RewardWeights(custom={"effort of some": -1.0}),
    )  # fmt: skip
    choices = {"guarantee": None, "contact_penalty": 1.0, "learning_preset": False}
    teams = [training_env(scenario, count, **choices) for count in (12, 1)]
    for env in teams:
        env.reset(seed=0)
    touched = 0
    for _ in range(40):
        actions = -teams[0].simulator.positions.astype(np.float32)
        (_, many, *_, infos), (_, alone, *_) = (env.step(actions[: env.num_envs]) for env in teams)
        assert many[0] == alone[0]
        touched += infos["contact"][1:].any()
    assert touched > 5
