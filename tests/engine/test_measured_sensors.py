"""Effects of measured sensors: blind zone, samples, delays, biases of observers, levels of robots,
errors and detection with a memory, detection by range, outliers.
"""

import itertools
import math

import numpy as np
import pytest
from conftest import actions_shape, assert_same_state
from parameters import slow
from scipy import stats
from test_sensing_engine import (
    BOTH,
    OTHERS,
    PLANE,
    SPACE,
    WALLED,
    act,
    angles,
    by_robot,
    neighbours,
    rest,
    sensing,
    silhouettes,
    simulator,
    true_rows,
    turned,
    turns,
)

import rendezvous_env as rv

STEP = PLANE.tau
ALL = {
    "min_range": 1.0, "sample_period": 2.5 * STEP, "delay_time": 2.0 * STEP, "observer_bias": 0.1,
    "noise": (0.1, 0.2, 0.0, 0.3, 0.05), "noise_correlation": 4.0 * STEP,
    "detection": ((0.0, 1.0), (5.0, 0.9), (20.0, 0.5)), "persistence": 5.0 * STEP,
    "outliers": 0.1, "outlier_kind": "robot", "field_of_view": 6.0, "view_falloff": 1.0,
    "dropout": 0.1, "bias": 0.05, "sectors": 720, "range": 30.0,
}  # fmt: skip
"""Every effect at once."""
MEASURED = rv.Sensing(**ALL)


def distances(sim: rv.Simulator) -> np.ndarray:
    """Distances of robots, (B, n, n), m."""
    return np.linalg.norm(sim.positions[:, None] - sim.positions[:, :, None], axis=-1)


def seen(sim: rv.Simulator) -> np.ndarray:
    """True where robot i sees robot j, (B, n, n)."""
    return by_robot(neighbours(sim)).any(axis=-1)


@BOTH
@pytest.mark.parametrize("batch", [2, 40])
def test_min_range_hides_exactly_the_nearer_neighbours(scenario, batch):
    blind, exact = simulator(sensing(scenario, min_range=5.0), batch), simulator(scenario, batch)
    for step in range(3):
        near = distances(blind) < 5.0
        rows = by_robot(neighbours(exact))
        linked = true_rows(blind).any(axis=-1)
        assert (near & linked & ~np.eye(5, dtype=bool)).any() and (linked & ~near).any()
        assert (by_robot(neighbours(blind)) == np.where(near[..., None], 0.0, rows)).all()
        act(blind, step), act(exact, step)


def test_min_range_leaves_links_and_obstacles():
    graph = rv.graphs.proximity(0.7)
    exact = WALLED.replace(graph=graph, sensing=rv.Sensing(range=9.0), require_connected=False)
    blind, exact = simulator(sensing(exact, range=9.0, min_range=2.0)), simulator(exact)
    assert (blind.weights == exact.weights).all() and not seen(blind).all()
    assert (silhouettes(blind) == silhouettes(exact)).all() and silhouettes(blind).any()


@pytest.mark.parametrize("fields", [{}, {"noise": 0.2, "dropout": 0.3}], ids=["exact", "noisy"])
@pytest.mark.parametrize("batch", [2, 40])
def test_sample_period_refreshes_rows_at_the_first_step_of_each_sample(fields, batch):
    """Of 2.5 steps: samples are due at steps 0, 3, 5, 8, 10 ..."""
    every = simulator(sensing(PLANE, **fields), batch)
    held = simulator(sensing(PLANE, sample_period=2.5 * STEP, **fields), batch)
    for step in range(11):
        rows, now = held.observe(), every.observe()
        if step in (0, 3, 5, 8, 10):
            last = now
        gone = ~held.active
        assert (rows == np.where(gone[..., None, None], 0.0, last)).all(), step
        if step == 4:
            assert (rows != now).any()
        act(every, step), act(held, step)


def test_sample_period_of_at_most_a_step_refreshes_always():
    every, held = simulator(PLANE), simulator(sensing(PLANE, sample_period=STEP))
    for step in range(5):
        assert (every.observe() == held.observe()).all()
        act(every, step), act(held, step)


@pytest.mark.parametrize(("time", "steps"), [(0.49, 0), (0.5, 1), (1.0, 1), (3.4, 3)])
def test_delay_time_is_a_delay_of_the_nearest_number_of_steps(time, steps):
    late = simulator(sensing(PLANE, delay_time=time * STEP))
    same = simulator(sensing(PLANE, delay=steps))
    assert late.scenario.delay_steps == steps
    for step in range(6):
        assert (late.observe() == same.observe()).all()
        act(late, step), act(same, step)


@BOTH
def test_observer_bias_turns_all_that_a_robot_sees_alike(scenario):
    sigma = 0.2
    sim = simulator(sensing(scenario, observer_bias=sigma), batch=300)
    rows, true = by_robot(neighbours(sim)), true_rows(sim)
    if scenario.dim == 2:
        found = turned(sim).reshape(300, 5, 4)
        assert np.ptp(found, axis=-1).max() < 1e-5
        assert stats.kstest(found[..., 0].ravel() / sigma, "norm").pvalue > 0.01
        of_robots = found[..., 0]
    else:
        found = angles(rows, true)[:, OTHERS]
        mean_square = np.mean(found**2) / sigma**2  # 2 of 3 equal parts of the rotation turn a row
        assert mean_square == pytest.approx(1.0, abs=0.08)
        inner = np.einsum("bijk,bilk->bijl", rows, rows)  # a rotation keeps angles between rows
        exact = np.einsum("bijk,bilk->bijl", true, true)
        assert inner == pytest.approx(exact, abs=1e-5)
        of_robots = angles(rows, true)[:, [0, 1], [1, 2]]
    assert abs(np.corrcoef(of_robots[:, 0], of_robots[:, 1])[0, 1]) < 0.2
    act(sim, 0)
    whole = sim.active.all(axis=1)
    again = turned(sim) if scenario.dim == 2 else None
    if again is not None:
        assert again[whole] == pytest.approx(found.reshape(300, -1)[whole], abs=1e-5)
    sim.reset()
    fresh = angles(by_robot(neighbours(sim)), true_rows(sim)) if scenario.dim == 3 else None
    found_now = turned(sim).reshape(300, 5, 4)[..., 0] if fresh is None else fresh[:, 0, 1]
    before = found[..., 0] if fresh is None else of_robots[:, 0]
    assert abs(np.corrcoef(before.ravel(), found_now.ravel())[0, 1]) < 0.2


def test_observer_bias_turns_obstacles_as_it_turns_robots():
    exact, askew = simulator(WALLED, 40), simulator(sensing(WALLED, observer_bias=0.2), 40)
    true, found = silhouettes(exact), silhouettes(askew)
    there = true.any(axis=-1)
    of_points = turns(found, true)
    of_robots = turned(askew).reshape(40, 5, 4)[..., :1]
    wanted = np.broadcast_to(of_robots, of_points.shape)
    assert there.sum() > 100 and of_points[there] == pytest.approx(wanted[there], abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [WALLED, SPACE], ids=["plane", "space"])
def test_equal_levels_of_noise_are_bitwise_one_level(scenario):
    one = simulator(sensing(scenario, noise=0.3, bias=0.1, sectors=90), 40)
    each = simulator(sensing(scenario, noise=[0.3] * 4 + [0.0], bias=0.1, sectors=90), 40)
    for step in range(3):
        found = one.observe(), each.observe()
        assert (found[0] == found[1])[:, :4].all()
        act(one, step), act(each, step)


@pytest.mark.parametrize("correlation", [0.0, 3.0 * STEP], ids=["white", "correlated"])
def test_levels_of_noise_belong_to_the_robot_that_sees(correlation):
    levels = np.array([0.0, 0.01, 0.1, 0.3, 0.6])
    sim = simulator(sensing(PLANE, noise=tuple(levels), noise_correlation=correlation), 500)
    found = turned(sim).reshape(500, 5, 4)
    assert np.abs(found[:, 0]).max() < 1e-6
    for robot in range(1, 5):
        z = found[:, robot].ravel() / levels[robot]
        assert stats.kstest(z[np.abs(found[:, robot].ravel()) < 3.0], "norm").pvalue > 0.001


@BOTH
def test_correlated_noise_is_an_autoregression_of_the_same_distribution(scenario):
    """Errors k steps apart have correlation exp(−kτ/T); pairs are independent."""
    sigma, constant = 0.1, 4.0 * scenario.tau
    sim = simulator(sensing(scenario, noise=sigma, noise_correlation=constant), batch=400)
    found = []
    for _ in range(12):
        if scenario.dim == 2:
            found.append(turned(sim) / sigma)
        else:
            found.append(angles(by_robot(neighbours(sim)), true_rows(sim))[:, OTHERS] / sigma)
        rest(sim)
    z = np.array(found)
    law = "norm" if scenario.dim == 2 else "halfnorm"
    for step in (0, 1, 11):
        assert stats.kstest(z[step].ravel(), law).pvalue > 0.01
    if scenario.dim == 2:
        for apart in (1, 2, 6):
            rho = math.exp(-apart / 4.0)
            assert np.mean(z[apart] * z[0]) == pytest.approx(rho, abs=0.06)
        assert abs(np.mean(z[0, :, 0] * z[0, :, 4])) < 0.15  # robots 0 and 1 of each other
        assert abs(np.mean(z[5, :, 1] * z[5, :, 2])) < 0.15


def test_correlated_noise_turns_silhouettes_with_a_memory_of_each_point():
    sigma = 0.1
    exact = simulator(WALLED, 40)
    sim = simulator(sensing(WALLED, noise=sigma, noise_correlation=4.0 * WALLED.tau), 40)
    true, first = silhouettes(exact), silhouettes(sim)
    rest(sim)
    there, second = true.any(axis=-1), silhouettes(sim)
    one, two = turns(first, true)[there] / sigma, turns(second, true)[there] / sigma
    assert stats.kstest(one, "norm").pvalue > 0.01 and stats.kstest(two, "norm").pvalue > 0.01
    rho = math.exp(-0.25)
    assert np.mean(one * two) == pytest.approx(rho, abs=0.2) and len(set(one)) == len(one)


def test_detection_follows_its_table_between_the_distances_given():
    table = ((2.0, 0.9), (6.0, 0.5), (10.0, 0.1))
    sim = simulator(sensing(PLANE, detection=table, dropout=0.2), batch=400)
    far, found = distances(sim), np.zeros((400, 5, 5))
    for _ in range(25):
        found += seen(sim)
        rest(sim)
    chance = 0.8 * np.interp(far, *zip(*table, strict=True))
    for low, high in itertools.pairwise([0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 30.0]):
        within = (far >= low) & (far < high) & ~np.eye(5, dtype=bool)
        hits, trials = found[within].sum(), 25 * within.sum()
        sd = math.sqrt(25.0 * (chance * (1.0 - chance))[within].sum())
        assert trials > 500 or low == 0.0
        assert abs(hits - 25.0 * chance[within].sum()) < 4.0 * sd + 1e-9, (low, high)


@pytest.mark.parametrize("scenario", [PLANE, slow(SPACE)], ids=["plane", "space"])
def test_detection_falls_off_to_the_edge_of_the_field_of_view(scenario):
    sim = simulator(sensing(scenario, field_of_view=4.0, view_falloff=1.0), batch=400)
    true, found = true_rows(sim), np.zeros((400, 5, 5))
    for _ in range(25):
        found += seen(sim)
        rest(sim)
    angle = np.arctan2(np.linalg.norm(true[..., 1:], axis=-1), true[..., 0])
    for low, high in itertools.pairwise([0.0, 1.0, 1.25, 1.5, 1.75, 2.0]):
        within = (angle > low) & (angle < high) & ~np.eye(5, dtype=bool)
        chance = np.clip(2.0 - angle[within], 0.0, 1.0)
        sd = math.sqrt(25.0 * (chance * (1.0 - chance)).sum())
        assert abs(found[within].sum() - 25.0 * chance.sum()) < 4.0 * sd + 1e-9, (low, high)
    assert not found[(angle > 2.0) & ~np.eye(5, dtype=bool)].any()


@BOTH
@pytest.mark.parametrize("by", ["dropout", "detection"])
def test_persistence_is_a_two_state_markov_chain_of_each_pair(scenario, by):
    p, constant = 0.6, 5.0 * scenario.tau
    fields = {"dropout": 1.0 - p} if by == "dropout" else {"detection": ((1.0, p),)}
    sim = simulator(sensing(scenario, persistence=constant, **fields), batch=400)
    found = []
    for _ in range(20):
        found.append(seen(sim)[:, OTHERS])
        rest(sim)
    states, kept = np.array(found), math.exp(-0.2)
    for step in (0, 10, 19):
        assert stats.binomtest(int(states[step].sum()), states[step].size, p).pvalue > 0.001
    before, after = states[:-1], states[1:]
    for was, chance in ((True, p + (1.0 - p) * kept), (False, p * (1.0 - kept))):
        out = after[before == was]
        assert stats.binomtest(int(out.sum()), out.size, chance).pvalue > 0.001, was
    twice = states[2:][~states[1:-1] & states[:-2]]  # a chain knows no step but the last
    assert stats.binomtest(int(twice.sum()), twice.size, p * (1.0 - kept)).pvalue > 0.001


def test_persistence_without_a_miss_changes_nothing():
    sim, exact = simulator(sensing(PLANE, persistence=1.0)), simulator(PLANE)
    for step in range(4):
        assert (sim.observe() == exact.observe()).all()
        act(sim, step), act(exact, step)


@pytest.mark.parametrize(
    "scenario",
    [pytest.param(PLANE, marks=pytest.mark.kernels), slow(SPACE)],
    ids=["plane", "space"],
)
def test_outliers_are_uniform_directions_of_the_length_of_a_row(scenario):
    sim, exact = simulator(sensing(scenario, outliers=0.25), 400), simulator(scenario, 400)
    rows, true = by_robot(neighbours(sim)), by_robot(neighbours(exact))
    lengths = np.linalg.norm(rows, axis=-1)[:, OTHERS]
    assert lengths == pytest.approx(np.linalg.norm(true, axis=-1)[:, OTHERS], abs=1e-6)
    changed = (rows != true).any(axis=-1)[:, OTHERS]
    assert stats.binomtest(int(changed.sum()), changed.size, 0.25).pvalue > 0.001
    units = rows[:, OTHERS][changed] / lengths[changed][:, None]
    if scenario.dim == 2:
        share = np.arctan2(units[:, 1], units[:, 0]) / (2.0 * np.pi) + 0.5
        assert stats.kstest(share, "uniform").pvalue > 0.001
    else:
        for axis in range(3):
            assert stats.kstest(0.5 * (units[:, axis] + 1.0), "uniform").pvalue > 0.001
    rest(sim)
    again = (by_robot(neighbours(sim)) != true).any(axis=-1)[:, OTHERS]
    both = stats.binomtest(int((again & changed).sum()), changed.size, 0.0625)
    assert both.pvalue > 0.001


@BOTH
def test_outliers_of_robots_are_bearings_of_others(scenario):
    kind = {"outliers": 0.5, "outlier_kind": "robot"}
    sim, exact = simulator(sensing(scenario, **kind), 200), simulator(scenario, 200)
    rows, true = by_robot(neighbours(sim)), by_robot(neighbours(exact))
    changed = (rows != true).any(axis=-1) & ~np.eye(5, dtype=bool)
    assert stats.binomtest(int(changed.sum()), 4000, 0.5).pvalue > 0.001
    counts = np.zeros(5)
    for b, i, j in np.argwhere(changed):
        gaps = np.linalg.norm(true[b, i] - rows[b, i, j], axis=-1)
        others = [k for k in range(5) if k not in (i, j)]
        nearest = min(others, key=lambda k: gaps[k])
        assert gaps[nearest] < 1e-5
        counts[nearest] += 1
    assert counts.min() > 0.7 * counts.mean()


def test_outliers_of_robots_need_a_third_robot():
    two = PLANE.replace(n_robots=2)
    sim = simulator(sensing(two, outliers=1.0, outlier_kind="robot"))
    assert (sim.observe() == simulator(two).observe()).all()


def models() -> list[rv.Scenario]:
    """Every robot model, a sparse graph, arcs, few rows, obstacles in the plane and in space."""
    common = {"n_robots": 5, "graph": rv.graphs.complete(0.7)}
    plane = ("single_integrator", "unicycle", "double_integrator")
    made = [rv.Scenario(robot_model=model, **common) for model in plane]
    made += [SPACE, WALLED, PLANE.replace(graph="cycle", neighbour_slots=3)]
    made += [PLANE.replace(graph=rv.graphs.switching([rv.graphs.directed_cycle(), "path"], 1.0))]
    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenario",
    [*models()[:1], *map(slow, models()[1:])],
    ids=lambda one: f"{one.robot_model}-{one.dim}",
)
def test_a_batch_with_all_effects_equals_singles_bitwise(scenario):
    tau = scenario.tau / STEP
    times = {k: ALL[k] * tau for k in ("sample_period", "delay_time", "noise_correlation")}
    scenario = sensing(scenario, **ALL | times)
    many = rv.Simulator(scenario, 33, num_threads=2)
    many.reset(seed=list(range(33)))
    singles = {team: rv.Simulator(scenario, 1) for team in (0, 7, 32)}
    for team, one in singles.items():
        one.reset(seed=[team])
    for step in range(8):
        state, found = many.get_state(), many.observe()
        assert np.isfinite(found).all()
        for team, one in singles.items():
            assert (one.observe()[0] == found[team]).all(), (step, team)
            one.observe()  # to look twice changes nothing
        if step == 4:
            other = rv.Simulator(scenario, 33)
            other.set_state(state)
            assert (other.observe() == found).all()
            many = other
        actions = np.random.default_rng(step).normal(size=(33, 5, scenario.action_size))
        actions = 0.3 * actions * scenario.action_bounds
        many.step(actions)
        for team, one in singles.items():
            one.step(actions[team : team + 1])


def test_an_episode_with_memories_starts_anew_with_each_reset():
    scenario = sensing(PLANE, **ALL)
    first, second = simulator(scenario, 40), simulator(scenario, 40)
    for step in range(5):
        act(second, step)
    second.reset(seed=list(range(3, 43)))
    first.reset(seed=list(range(3, 43)))
    for step in range(4):
        assert (first.observe() == second.observe()).all(), step
        act(first, step), act(second, step)


def test_to_reset_some_teams_leaves_what_others_remember():
    """Others in the block are looked at anew, in the same step."""
    sim, alone = simulator(sensing(PLANE, **ALL), 40), simulator(sensing(PLANE, **ALL), 40)
    mask = np.arange(40) % 3 == 0
    for step in range(6):
        if step == 3:
            sim.reset(mask=mask)
        assert (sim.observe()[~mask] == alone.observe()[~mask]).all(), step
        assert_same_state(*({k: v[~mask] for k, v in s.get_state().items()} for s in (sim, alone)))
        actions = np.random.default_rng(step).normal(size=actions_shape(sim))
        sim.step(actions), alone.step(actions)


def test_vector_and_parallel_environments_show_the_same_measured_episode():
    scenario = sensing(PLANE, **ALL)
    teams = rv.make_vec(scenario, 33)
    env = rv.parallel_env(scenario)
    found, _ = teams.reset(seed=5)
    one, _ = env.reset(seed=5)
    robots, space = list(one), teams.action_space
    space.seed(1)
    for _ in range(6):
        rows = np.array([one[robot] for robot in robots]).reshape(5, -1)
        assert (rows == found[0].reshape(5, -1)).all()
        actions = space.sample()
        found, *_ = teams.step(actions)
        own = np.asarray(actions)[0].reshape(5, -1)
        one, *_ = env.step(dict(zip(robots, own, strict=True)))


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("detection", (0, 0, 0), 1.5, "it must be at most 1"),
        ("detection", (0, 0, 0), -0.5, "it must be 0 or more"),
        ("errors", (0, 1, 0), np.nan, "it must be finite"),
        ("errors", (0, 1, 0), 1e9, "it must be at most 6.5"),
        ("held", (0, 0, 0, 0), np.inf, "it must be finite"),
    ],
)
def test_a_memory_that_no_episode_has_is_refused(name, place, value, message):
    sim = simulator(sensing(PLANE, **ALL), 2)
    state = sim.get_state()
    assert set(state) - set(simulator(PLANE, 2).get_state()) == {
        "detection",
        "errors",
        "held",
        "past",
    }
    state[name][place] = value
    with pytest.raises(ValueError, match=message):
        sim.set_state(state)


@pytest.mark.parametrize(
    ("fields", "stages"),
    [
        ({}, set()),
        ({"noise": 0.1, "bias": 0.1, "dropout": 0.2, "range": 9.0}, set()),
        ({"delay_time": 2.0 * STEP}, set()),
        ({"min_range": 1.0}, {"apply_effects"}),
        ({"sample_period": 1.0}, {"hold_observations"}),
        ({"observer_bias": 0.1}, {"turn_observers"}),
        ({"persistence": 1.0, "dropout": 0.2}, {"remember_detection", "apply_effects"}),
        ({"noise": 0.1, "noise_correlation": 1.0}, {"remember_errors", "apply_effects"}),
        ({"range": [5.0, *[9.0] * 4], "dropout": [0.2, *[0.1] * 4]}, set()),
        ({"bias": [0.2, *[0.1] * 4], "delay": [1, *[0] * 4], "noise": [0.2, *[0.1] * 4]}, set()),
        ({"bias": [0.1] * 5, "delay": [1] * 5, "persistence": [0.0] * 5}, set()),
    ],
)
def test_only_stages_that_are_used_are_compiled(fields, stages):
    known = {"apply_effects", "hold_observations", "turn_observers", "remember_detection"}
    known |= {"remember_errors", "turn_silhouettes", "round_silhouettes"}
    sim = simulator(sensing(PLANE, **fields))
    rest(sim)
    assert {kernel.__name__ for kernel in sim._runner._stages._entries} & known == stages


def test_fields_are_absent_from_plain_data_at_their_defaults():
    old = {"field_of_view", "noise", "bias", "error", "dropout", "delay", "occlusion"}
    assert set(rv.Sensing(noise=0.1).to_plain()) == old


def test_fields_go_through_toml(tmp_path):
    scenario = sensing(PLANE, **ALL)
    scenario.to_toml(tmp_path / "all.toml")
    found = rv.Scenario.from_toml(tmp_path / "all.toml")
    assert found.sensing == scenario.sensing and found.sensing.detection == ALL["detection"]
    assert "detection = " in scenario.sensing.departures()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"min_range": -1.0}, "sensing.min_range is -1.0; it must be a finite number from 0"),
        ({"sample_period": -0.1}, "sensing.sample_period is -0.1; it must be"),
        ({"delay": 2, "delay_time": 0.3}, "sensing.delay is 2 steps and sensing.delay_time is 0.3"),
        ({"noise": [0.1, -1.0]}, r"sensing.noise\[1\] is -1.0; it must be"),
        ({"noise": []}, r"sensing.noise is \[\]; it must be one value, or a list"),
        ({"noise_correlation": math.nan}, "sensing.noise_correlation is nan"),
        ({"persistence": "long"}, "sensing.persistence is 'long'"),
        ({"outliers": 1.5}, "sensing.outliers is 1.5; it must be a finite number from 0 to 1"),
        ({"outlier_kind": "ghost"}, "sensing.outlier_kind is 'ghost'; it must be one of"),
        ({"observer_bias": 7.0}, "sensing.observer_bias is 7.0; it must be"),
        ({"detection": [[1.0, 0.5], [1.0, 0.2]]}, r"sensing.detection\[1\]\[0\] is 1.0; .* more"),
        ({"detection": [[1.0, 1.5]]}, r"sensing.detection\[0\]\[1\] is 1.5; it must be"),
        ({"detection": [1.0, 0.5]}, r"sensing.detection\[0\] is 1.0; it must be a list of pairs"),
        ({"detection": 0.5}, "sensing.detection is 0.5; it must be a list of pairs"),
        ({"view_falloff": 0.2}, "sensing.view_falloff is 0.2 rad .* or give a field_of_view"),
    ],
)
def test_a_wrong_field_is_refused_with_its_value_and_the_remedy(fields, words):
    with pytest.raises(ValueError, match=words):
        rv.Sensing(**fields)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"noise": (0.1, 0.2)}, r"sensing.noise is \[0.1, 0.2\]; it must be 5 numbers"),
        ({"delay_time": 1e6}, "sensing.delay_time is 1000000.0; it must be at most 10000 steps"),
    ],
)
def test_what_does_not_fit_the_team_is_refused(fields, words):
    with pytest.raises(ValueError, match=words):
        sensing(PLANE, **fields)


@pytest.mark.parametrize(
    "fields",
    [
        {"min_range": 1.0}, {"sample_period": 1.0}, {"observer_bias": 0.1},
        {"noise": (*[0.1] * 4, 0.2)},
        {"noise": 0.1, "noise_correlation": 1.0}, {"detection": ((1.0, 0.0),)}, {"outliers": 0.01},
        {"field_of_view": 1.0, "view_falloff": 0.1},
    ],
    ids=lambda fields: next(iter(fields)),
)  # fmt: skip
def test_no_certificate_is_given_for_what_no_theorem_knows(fields):
    scenario = sensing(PLANE, **fields)
    found = rv.certificate(scenario)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert math.isinf(found.expected_time_bound) and next(iter(fields)) in str(found)


def test_the_certificate_of_a_delay_in_seconds_is_that_of_its_steps():
    short = PLANE.replace(time_step=0.2 * PLANE.certified_step)
    late = rv.certificate(sensing(short, delay_time=2.0 * short.tau))
    same = rv.certificate(sensing(short, delay=2))
    assert late.time_bound == same.time_bound < math.inf
