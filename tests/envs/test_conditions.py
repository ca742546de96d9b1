"""Conditions of robots in infos: which ones took a new command in a step."""

import gymnasium
import numpy as np

import rendezvous_env as rv

CLOCKS = {"kind": "periodic", "period": [1, 2, 3, 4]}
SCENARIO = rv.Scenario(n_robots=4, spawn_size=40.0, activation=CLOCKS, time_limit=0.5)
WANTED = [[step % period == robot % period for robot, period in enumerate(CLOCKS["period"])]
          for step in range(8)]  # fmt: skip


def test_vector_environment_reports_activation():
    env = rv.make_vec(SCENARIO, 3)
    _, infos = env.reset(seed=0)
    assert not infos["activated"].any()
    for wanted in WANTED:
        infos = env.step(np.zeros((3, 4, 2), np.float32))[4]
        assert (infos["activated"] == wanted).all() and infos["_activated"].all()


def test_agents_report_activation_by_name():
    env = rv.parallel_env(SCENARIO)
    env.reset(seed=0)
    for wanted in WANTED:
        actions = {name: np.zeros(2, np.float32) for name in env.agents}
        infos = env.step(actions)[4]
        assert [infos[name]["activated"] for name in env.possible_agents] == wanted
    guarded = rv.HeadingVectorWrapper(rv.parallel_env(SCENARIO), 0.3)
    _, infos = guarded.reset(seed=0)
    assert infos["robot_0"]["activated"] is False
    infos = guarded.step({name: np.ones(2, np.float32) for name in guarded.agents})[4]
    assert [infos[name]["activated"] for name in guarded.possible_agents] == WANTED[0]


def test_gymnasium_environment_reports_activation():
    env = gymnasium.make("rendezvous/Rendezvous-v0", scenario=SCENARIO)
    env.reset(seed=0)
    for wanted in WANTED:
        assert env.step(np.zeros((4, 2), np.float32))[4]["activated"].tolist() == wanted


def test_final_infos_keep_the_conditions_of_the_last_step():
    env = rv.vector.training_env(SCENARIO, 2, guarantee=None, learning_preset=False)
    env.reset(seed=0)
    steps = SCENARIO.max_steps
    for _ in range(steps):
        infos = env.step(np.zeros(env.action_space.shape, np.float32))[4]
    wanted = [(steps - 1) % period == k % period for k, period in enumerate(CLOCKS["period"])]
    assert (infos["final_info"]["activated"] == wanted).all()
    assert not infos["activated"].any()


def test_synchronous_environment_has_no_such_key():
    env = rv.make_vec(SCENARIO.replace(activation="synchronous"), 2)
    _, infos = env.reset(seed=0)
    assert "activated" not in infos
