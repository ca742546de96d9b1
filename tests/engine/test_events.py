"""Failures and disturbances: what robots do and observe, and when."""

import numpy as np
import pytest
from conftest import actions_shape, assert_same_state
from parameters import marked, slow
from strategies import refusal
from test_activation import tape

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.engine.stages import commands
from rendezvous_env.robots.events import NEVER

N = 5
PLANE = rv.Scenario(n_robots=N, local_frames="global", max_speed=9.0)
TAU = PLANE.tau
SPACE = PLANE.replace(dim=3)
BOTH = pytest.mark.parametrize("scenario", [PLANE, slow(SPACE)], ids=["plane", "space"])
BATCHES = pytest.mark.parametrize("batch", [2, slow(40)])
ALL = {
    "plane": {"n_crashed": 1, "n_blind": 2, "slip": 0.3, "compass_walk": 0.5, "disturbance": 0.2},
    "space": {"dim": 3, "n_adversarial": 1, "disturbance_noise": 0.2, "compass_drift": 0.4},
    "turning": {"robot_model": "unicycle", "n_crashed": 2, "slip": 0.9, "n_blind": 1},
    "clocks": {"activation": "random", "n_crashed": 1, "slip": 0.4},
}
KEYS = rv.Events().__dataclass_fields__


def apart(scenario=PLANE, batch=2, seed=3, **fields):
    """A simulator whose robots are far from each other."""
    sim = rv.Simulator(scenario.replace(**{"spawn_size": 40.0, **fields}), batch)
    sim.reset(seed)
    return sim


def eventful(**fields):
    """A scenario from fields and, among them, those of events."""
    events = {name: fields.pop(name) for name in [*fields] if name in KEYS}
    return rv.Scenario(n_robots=N, events=events, **fields)


@BOTH
@BATCHES
def test_crashed_robot_stands_still_from_its_time_on(scenario, batch):
    sim = apart(scenario, batch, events={"crashes": [[1, 4.5 * TAU], [3, 0.0]]})
    moves, told = [], []
    for given in tape(sim, 8):
        before = sim.positions
        sim.step(given)
        moves.append((sim.positions != before).any(axis=-1))
        told.append(sim.conditions["crashed"])
    moved, crashed = np.array(moves), np.array(told)
    assert moved[:5, :, 1].all() and not moved[5:, :, 1].any()
    assert not moved[:, :, 3].any() and moved[:, :, [0, 2, 4]].all()
    assert (crashed == ~moved).all()


@pytest.mark.kernels
@BATCHES
def test_robot_that_merges_with_a_crashed_one_has_crashed(batch):
    places = ((0.0, 0.0), (1.0, 0.0), (50.0, 0.0), (0.0, 50.0), (50.0, 50.0))
    sim = apart(batch=batch, start_positions=places, events={"crashes": [[1, 0.0]]})
    while sim.active[:, 1].any():
        sim.step(np.broadcast_to(np.float32([1.0, 0.0]), actions_shape(sim)))
    assert (sim.merged_into[:, 1] == 0).all() and sim.conditions["crashed"][:, 0].all()
    before = sim.positions
    sim.step(np.ones(actions_shape(sim)))
    assert (sim.positions[:, :2] == before[:, :2]).all()
    assert (sim.positions[:, 2:] != before[:, 2:]).any()


@BOTH
@BATCHES
def test_sensor_failure_hides_all_rows_in_its_time(scenario, batch):
    failing = {"events": {"sensor_failures": [[2, 2 * TAU, 5 * TAU]]}}
    shapes = {
        "obstacles": [{"centre": [0.0] * scenario.dim, "radius": 0.5}],
        "obstacle_range": 99.0,
    }
    sim, exact = apart(scenario, batch, **failing, **shapes), apart(scenario, batch, **shapes)
    for step, given in enumerate(tape(sim, 8)):
        seen, wanted = sim.observe(), exact.observe()
        blind = 2 <= step < 5
        assert (sim.conditions["blind"][:, 2] == blind).all()
        assert seen[:, 2].any() != blind
        others = [0, 1, 3, 4] if blind else slice(None)
        assert (seen[:, others] == wanted[:, others]).all()
        assert (sim.step(given).observations == sim.observe()).all()
        exact.step(given)


@pytest.mark.parametrize(
    "scenario",
    [pytest.param(PLANE, marks=pytest.mark.kernels), slow(SPACE)],
    ids=["plane", "space"],
)
def test_adversary_moves_at_full_speed_against_f(scenario):
    sim = apart(scenario, 3, events={"adversaries": [[0, 2 * TAU]]})
    for step, given in enumerate(tape(sim, 5)):
        offsets = sim.positions[:, 1:] - sim.positions[:, :1]
        f = (offsets / np.linalg.norm(offsets, axis=-1, keepdims=True)).sum(axis=1)
        before = sim.positions[:, 0]
        sim.step(given)
        wanted = -9.0 * TAU * f / np.linalg.norm(f, axis=-1, keepdims=True)
        moved = sim.positions[:, 0] - before
        if step >= 2:
            np.testing.assert_allclose(moved, wanted, atol=1e-5)
        else:
            np.testing.assert_allclose(moved, TAU * given[:, 0], atol=1e-5)
        assert (sim.conditions["adversarial"][:, 0] == (step >= 2)).all()


def test_drawn_failures_are_uniform_in_robots_and_times():
    sim = apart(batch=2000, events={"n_crashed": 2, "n_blind": 1}, time_limit=100 * TAU)
    faults = sim.get_state()["faults"]
    crashed, blind = faults[..., 0] < NEVER, faults[..., 1] < NEVER
    assert (crashed.sum(axis=1) == 2).all() and (blind.sum(axis=1) == 1).all()
    for chosen, share in ((crashed, 0.4), (blind, 0.2)):
        assert np.abs(chosen.mean(axis=0) - share).max() < 0.05
    times = faults[crashed][:, 0]
    assert 0 <= times.min() and times.max() < 100 and abs(times.mean() - 49.5) < 2.0
    start, end = faults[blind][:, 1], faults[blind][:, 2]
    assert (start < end).all() and end.max() <= 100
    assert abs((crashed & blind).any(axis=1).mean() - 0.4) < 0.05  # independent kinds
    again = sim.get_state()["faults"].copy()
    sim.reset()
    assert (sim.get_state()["faults"] != again).any()
    sim.reset(3)
    assert (sim.get_state()["faults"] == again).all()


@BOTH
def test_compass_drift_turns_frames_and_nothing_else(scenario):
    rates = [0.5, -1.0, 0.0, 2.0, 3.0]
    sim = apart(scenario, 3, events={"compass_drift": rates}, local_frames="random")
    before, level = sim.frames, sim.positions.copy()
    for _ in range(100):
        sim.step(np.zeros(actions_shape(sim)))
    angle = 100 * TAU * np.array(rates)
    turn = np.zeros((N, scenario.dim, scenario.dim))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(angle), -np.sin(angle)
    if scenario.dim == 3:
        turn[:, 2, 2] = 1.0
    np.testing.assert_allclose(sim.frames, turn @ before, atol=1e-12)
    assert (sim.positions == level).all()
    sim.set_state(sim.get_state())  # frames are rotations


def test_compass_walk_spreads_with_the_root_of_time():
    sim = apart(batch=400, events={"compass_walk": 0.2}, time_step=0.02)
    for _ in range(50):
        sim.step(np.zeros(actions_shape(sim)))
    angles = np.arctan2(sim.frames[..., 1, 0], sim.frames[..., 0, 0]).ravel()
    assert abs(angles.std() - 0.2) < 0.01 and abs(angles.mean()) < 0.02
    assert abs(np.mean(angles[:-1] * angles[1:])) < 0.005


@BOTH
@BATCHES
def test_slip_and_disturbance_have_their_distributions(scenario, batch):
    """Of robots that are commanded 1 m/s along x."""

    def moves(**events):
        sim = apart(scenario, batch, events=events)
        given = np.zeros(actions_shape(sim))
        given[..., 0] = 1.0
        found = []
        for _ in range(2000 // batch):
            before = sim.positions
            sim.step(given)
            found.append((sim.positions - before) / TAU)
        return np.array(found).reshape(-1, scenario.dim)

    slipped = moves(slip=0.5)
    assert 0.5 <= slipped[:, 0].min() < 0.51 and 0.99 < slipped[:, 0].max() < 1.0 + 1e-6
    assert abs(slipped[:, 0].mean() - 0.75) < 0.01 and not slipped[:, 1:].any()
    disturbed = moves(disturbance=0.3) - np.eye(scenario.dim)[0]
    lengths = np.linalg.norm(disturbed, axis=-1)
    assert lengths.max() < 0.3 + 1e-6
    # a share of q of the volume lies within q^(1/d) of the radius
    for share in (0.25, 0.5, 0.75):
        within = (lengths < 0.3 * share ** (1 / scenario.dim)).mean()
        assert abs(within - share) < 0.03
    assert np.abs(disturbed.mean(axis=0)).max() < 0.01
    noisy = moves(disturbance_noise=0.3) - np.eye(scenario.dim)[0]
    assert np.abs(noisy.std(axis=0) - 0.3).max() < 0.012
    assert np.abs(np.corrcoef(noisy.T) - np.eye(scenario.dim)).max() < 0.05


@BOTH
def test_disturbance_never_exceeds_its_bound_and_has_no_direction(scenario):
    """The bound is a premise of theorem N2."""
    bound, d = 0.3, scenario.dim
    sim = apart(scenario, 400, events={"disturbance": bound})
    found = []
    for _ in range(50):
        before = sim.positions
        sim.step(np.zeros(actions_shape(sim)))
        found.append((sim.positions - before) / TAU)
    drawn = np.array(found).reshape(-1, d)
    lengths = np.linalg.norm(drawn, axis=-1)
    assert 0.999 * bound < lengths.max() <= bound
    # E[v vᵀ] = w²/(d + 2) of the uniform ball, also conditioned on the robot and the step
    moments = drawn.T @ drawn / len(drawn)
    np.testing.assert_allclose(moments, np.eye(d) * bound**2 / (d + 2), atol=3e-4)
    steps = np.array(found)
    for first, second in ((steps[1:], steps[:-1]), (steps[:, :, 1:], steps[:, :, :-1])):
        assert abs((first * second).mean()) < 3e-4


@pytest.mark.parametrize("name", marked(ALL, slow=["space", "turning"]))
def test_batch_equals_singles_with_events(name):
    scenario = eventful(**ALL[name], spawn_size=4.0, time_limit=2.0)
    law = baselines.make("unicycle" if name == "turning" else "bearing-only", scenario)
    many = rv.Simulator(scenario, 40, num_threads=2)
    singles = {b: rv.Simulator(scenario) for b in (0, 17, 39)}
    seen = many.reset(5)
    alone = {b: sim.reset(5 + b) for b, sim in singles.items()}
    for _ in range(40):
        seen = many.step(law(seen, many.time)).observations
        for b, sim in singles.items():
            alone[b] = sim.step(law(alone[b], sim.time)).observations
            assert (alone[b][0] == seen[b]).all() and (sim.frames[0] == many.frames[b]).all()
            for key, values in many.conditions.items():
                assert (sim.conditions[key][0] == values[b]).all()
    other = rv.Simulator(scenario, 40)
    other.set_state(many.get_state())
    for given in tape(many, 5):
        many.step(given), other.step(given)
    assert_same_state(many, other)


def test_scenario_without_events_neither_stores_nor_compiles_them():
    sim = apart()
    sim.step(tape(sim, 1)[0])
    stages = commands.disturb_commands, commands.turn_frames, commands.hide_from_blind
    assert not {*stages} & {*sim._runner._stages._entries}
    assert "faults" not in sim.get_state() and "events" not in PLANE.to_plain()
    assert sim.conditions == {}


@pytest.mark.parametrize("name", [*ALL])
def test_events_pass_through_plain_data_and_files(name, tmp_path):
    scenario = eventful(**ALL[name], crashes=[[0, 1.5]], sensor_failures=[[1, 0.5, 2.0]])
    assert rv.Scenario.from_plain(scenario.to_plain()) == scenario
    scenario.to_toml(tmp_path / "custom.toml")
    assert rv.Scenario.from_toml(tmp_path / "custom.toml") == scenario
    assert hash(scenario)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"crashes": [[5, 1.0]]}, "events.crashes[0][0] is 5; it must be below n_robots = 5"),
        ({"crashes": [[1, -1.0]]}, "events.crashes[0]"),
        ({"crashes": [[1, 1.0], [1, 2.0]]}, "each robot once"),
        ({"crashes": 3}, "a list of pairs [robot, time in s]"),
        ({"sensor_failures": [[1, 2.0, 2.0]]}, "later than 2.0 s"),
        ({"n_crashed": 6}, "at most 5, the other robots"),
        ({"n_crashed": 5, "crashes": [[0, 0.0]]}, "at most 4"),
        ({"slip": 1.5}, "events.slip"),
        ({"compass_drift": [1.0, 2.0]}, "one for each robot"),
        ({"robot_model": "unicycle", "compass_drift": 1.0}, "robot_model='unicycle'"),
        ({"robot_model": "unicycle", "disturbance": 1.0}, "robot_model='unicycle'"),
        ({"robot_model": "double_integrator", "n_crashed": 1}, "robot_model='double_integrator'"),
        (
            {"robot_model": ["unicycle", *["single_integrator"] * 4], "disturbance": 1.0},
            "robot_model=('unicycle', 'single_integrator'",
        ),
    ],
)
def test_invalid_events_are_named_with_a_remedy(fields, words):
    assert words in refusal(lambda: eventful(**fields))


def test_unknown_event_is_named_with_the_nearest():
    assert "did you mean 'crashes'" in refusal(lambda: PLANE.replace(events={"crash": []}))
