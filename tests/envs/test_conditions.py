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


FAILING = rv.Events(crashes=[[1, 0.1]], sensor_failures=[[2, 0.1, 0.2]], adversaries=[[3, 0.2]])


def test_failures_are_reported_by_kind():
    scenario = SCENARIO.replace(events=FAILING, time_step=0.1, allow_long_step=True)
    env = rv.make_vec(scenario, 3, autoreset_mode="disabled")
    one = rv.parallel_env(scenario)
    env.reset(seed=0), one.reset(seed=0)
    wanted = {
        "crashed": [[], [1], [1]],
        "blind": [[2], [], []],
        "adversarial": [[], [], [3]],
    }
    for step in range(3):
        infos = env.step(np.zeros((3, 4, 2), np.float32))[4]
        told = one.step({name: np.zeros(2, np.float32) for name in one.agents})[4]
        for key, robots in wanted.items():
            assert (infos[key] == np.isin(np.arange(4), robots[step])).all()
            assert [info[key] for info in told.values()] == infos[key][0].tolist()


def test_trajectory_keeps_conditions_in_a_file(tmp_path):
    scenario = SCENARIO.replace(events=FAILING)
    played = rv.rollout(scenario, lambda seen, time: np.zeros((2, 4, 2)), num_envs=2)
    assert {*played.conditions} == {"activated", "crashed", "blind", "adversarial"}
    shape = len(played.times) - 1, 2, 4
    assert all(array.shape == shape for array in played.conditions.values())
    assert (played.conditions["activated"][:8, 0] == WANTED).all()
    copy = rv.Trajectory.load(played.save(tmp_path / "played.npz"))
    assert copy.conditions.keys() == played.conditions.keys()
    for key, array in played.conditions.items():
        assert (copy.conditions[key] == array).all()


def test_picture_marks_failed_robots():
    pictures = []
    for events in ({}, {"crashes": [[0, 0.0]]}):
        start = [[0.0, 0.0], [5.0, 0.0], [0.0, 5.0], [5.0, 5.0]]
        scenario = rv.Scenario(n_robots=4, start_positions=start, events=events)
        env = rv.parallel_env(scenario, render_mode="rgb_array")
        env.reset(seed=0)
        env.step({name: np.zeros(2, np.float32) for name in env.agents})
        pictures.append(env.render())
        place = env.renderer.pixels(np.zeros(2)).round().astype(int)
    plain, marked = (picture.astype(int) for picture in pictures)
    x, y = place
    around = np.abs(plain - marked)[y - 20 : y + 20, x - 20 : x + 20]
    assert around.max() > 100
