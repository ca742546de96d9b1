"""Clocks of robots: who is active in which step, and what all others do meanwhile."""

import pickle

import numpy as np
import pytest
from conftest import actions_shape, assert_same_state
from strategies import refusal

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.engine.stages.commands import take_commands

N = 5
PLANE = rv.Scenario(n_robots=N, graph=rv.graphs.complete(0.7))
PERIODIC = rv.Activation(kind="periodic", period=[1, 2, 3, 4, 5], phase=[0, 1, 0, 3, 2])
BATCHES = pytest.mark.parametrize("batch", [2, 40])
KINDS = {
    "periodic": PERIODIC,
    "random": rv.Activation(kind="random", probability=0.4),
    "bounded": rv.Activation(kind="bounded", max_wait=3),
}


def apart(scenario=PLANE, batch=2, seed=3, **fields):
    """A simulator and random actions that merge no robots in a few steps."""
    sim = rv.Simulator(scenario.replace(**{"spawn_size": 40.0, **fields}), batch)
    sim.reset(seed)
    return sim


def tape(sim, steps, seed=0):
    """Actions that are the same for every environment of a batch, (steps, B, n, a)."""
    batch, *shape = actions_shape(sim)
    drawn = np.random.default_rng(seed).normal(size=(steps, 1, *shape))
    return np.repeat(drawn, batch, axis=1).astype(np.float32)


def steps_of(sim, actions):
    """Activity of all robots, (steps, B, n), and their displacements, (steps, B, n, d), m."""
    activity, moves = [], []
    for given in actions:
        before = sim.positions
        sim.step(given)
        activity.append(sim.conditions["activated"])
        moves.append(sim.positions - before)
    return np.array(activity), np.array(moves)


def commands_of(activity, actions, hold):
    """Commands in execution by the definition, (steps, B, n, a)."""
    found, command = [], np.zeros_like(actions[0])
    for active, given in zip(activity, actions, strict=True):
        other = np.zeros_like(command) if hold == "stop" else command
        command = np.where(active[..., None], given, other)
        found.append(command)
    return np.array(found)


@pytest.mark.kernels
@BATCHES
def test_periodic_robots_are_active_in_their_own_steps(batch):
    sim = apart(activation=PERIODIC, batch=batch)
    activity, _ = steps_of(sim, tape(sim, 24))
    for robot, (period, phase) in enumerate(zip(PERIODIC.period, PERIODIC.phase, strict=True)):
        wanted = [step % period == phase for step in range(24)]
        assert (activity[:, :, robot] == np.array(wanted)[:, None]).all()


def test_phases_are_staggered_by_default():
    sim = apart(activation={"kind": "periodic", "period": 3})
    activity, _ = steps_of(sim, tape(sim, 3))
    assert activity[:, 0].tolist() == [
        [True, False, False, True, False],
        [False, True, False, False, True],
        [False, False, True, False, False],
    ]


@pytest.mark.kernels
def test_random_activation_has_its_probability_in_each_step():
    sim = apart(activation=rv.Activation(kind="random", probability=0.3), batch=400)
    activity, _ = steps_of(sim, tape(sim, 10))
    error = np.sqrt(0.3 * 0.7 / activity.size)
    assert abs(activity.mean() - 0.3) < 4 * error
    # independent of the robot, of the step before and of the environment
    assert abs((activity[1:] & activity[:-1]).mean() - 0.09) < 0.01
    assert abs((activity[..., 1:] & activity[..., :-1]).mean() - 0.09) < 0.01
    assert abs((activity[:, 1:] & activity[:, :-1]).mean() - 0.09) < 0.01


@pytest.mark.parametrize("hold", ["command", "stop"])
def test_adversary_activates_early_only_what_keeps_v_higher(hold):
    """By the definition, from f_i · v of the new command and of the one in execution."""
    sim = apart(activation=KINDS["bounded"], hold=hold, local_frames="global", batch=3)
    wait, command = np.zeros((3, N), np.int64), np.zeros((3, N, 2))
    early = 0
    for given in tape(sim, 40):
        offsets = sim.positions[:, None] - sim.positions[:, :, None]
        far = np.linalg.norm(offsets, axis=-1, keepdims=True) + np.eye(N)[..., None]
        net_bearing = (sim.weights[..., None] * offsets / far).sum(axis=2)
        new, old = ((net_bearing * one).sum(axis=-1) for one in (given, command))
        forced = wait + 1 >= 3
        wanted = forced | (new < (0.0 if hold == "stop" else old))
        sim.step(given)
        active = sim.conditions["activated"]
        assert (active == wanted).all()
        early += int((active & ~forced).sum())
        wait = np.where(active, 0, wait + 1)
        other = 0.0 if hold == "stop" else command
        command = np.where(active[..., None], given, other)
    assert early > 20


@pytest.mark.parametrize("kind", [*KINDS])
@pytest.mark.parametrize("hold", ["command", "stop"])
@BATCHES
def test_robots_execute_the_command_of_their_last_activation(kind, hold, batch):
    fields = {"activation": KINDS[kind], "hold": hold, "local_frames": "global", "max_speed": 9.0}
    sim = apart(batch=batch, **fields)
    actions = tape(sim, 20)
    activity, moves = steps_of(sim, actions)
    assert activity.any() and not activity.all()
    wanted = commands_of(activity, actions, hold)
    np.testing.assert_allclose(moves / sim.scenario.tau, wanted, rtol=1e-4, atol=1e-5)


def test_robots_rest_before_their_first_activation():
    sim = apart(activation={"kind": "periodic", "period": 4, "phase": 3})
    _, moves = steps_of(sim, tape(sim, 4))
    assert not moves[:3].any() and moves[3].all()
    sim.reset()  # the commands of an episode end with it
    _, moves = steps_of(sim, tape(sim, 4))
    assert not moves[:3].any()


@pytest.mark.slow
def test_turning_robots_keep_or_stop_their_turn_rate():
    clocks = {"activation": {"kind": "periodic", "period": 2, "phase": 0}}
    for hold in ("command", "stop"):
        sim = apart(robot_model="unicycle", hold=hold, **clocks)
        headings = [sim.headings]
        for _ in range(2):
            sim.step(np.broadcast_to(np.float32([0.5, 1.0]), actions_shape(sim)))
            headings.append(sim.headings)
        turned = np.diff(np.array(headings), axis=0)
        assert turned[0].all() and (turned[1].any() == (hold == "command"))


@pytest.mark.parametrize("kind", [*KINDS])
@pytest.mark.parametrize("graph", ["complete", "directed_cycle"])
def test_batch_equals_singles_with_clocks(kind, graph):
    scenario = rv.Scenario(
        n_robots=N, graph=graph, spawn_size=4.0, activation=KINDS[kind], time_limit=2.0
    )
    law = baselines.make("bearing-only", scenario)
    many = rv.Simulator(scenario, 40, num_threads=2)
    singles = {b: rv.Simulator(scenario) for b in (0, 17, 39)}
    seen = many.reset(5)
    alone = {b: sim.reset(5 + b) for b, sim in singles.items()}
    for _ in range(40):
        acting = many.active
        seen = many.step(law(seen, many.time)).observations
        activity = many.conditions["activated"]
        assert not activity[~acting].any()
        for b, sim in singles.items():
            alone[b] = sim.step(law(alone[b], sim.time)).observations
            assert (sim.positions[0] == many.positions[b]).all()
            assert (sim.conditions["activated"][0] == activity[b]).all()
    assert (many.active.sum(axis=1) < N).any()


@pytest.mark.parametrize("kind", [*KINDS])
def test_state_continues_the_clocks(kind):
    counted = kind == "bounded"  # the adversary counts the steps of each robot
    sim = apart(activation=KINDS[kind])
    actions = tape(sim, 13)
    steps_of(sim, actions[:7])
    state, copy = sim.get_state(), pickle.loads(pickle.dumps(sim))
    assert state["commands"].shape == (2, N, 2) and ("last_activation" in state) == counted
    other = rv.Simulator(sim.scenario, 2)
    other.set_state(state)
    first = steps_of(sim, actions[7:])
    for one in (copy, other):
        for own, wanted in zip(steps_of(one, actions[7:]), first, strict=True):
            assert (own == wanted).all()
    assert_same_state(sim, other)
    assert not counted or state["last_activation"].max() == 6
    for name, value in {"last_activation": 7, "commands": np.nan}.items():
        if name not in state:
            continue
        wrong = {key: array.copy() for key, array in state.items()}
        wrong[name].flat[0] = value
        assert name in refusal(other.set_state, wrong)


def test_several_steps_at_once_equal_single_ones():
    class Controller:
        uses_feedback, action_diagnostics = False, ()

        def apply_calls(self, part, observations, actions):
            rows = slice(*part[:2])
            return [lambda: np.copyto(actions[rows], observations[rows].sum(axis=2))]

        def update_calls(self, *_):
            return []

    one, other = (apart(activation=KINDS["random"], batch=6, spawn_size=4.0) for _ in range(2))
    seen = one.observe()
    other.step_n(Controller(), seen.copy(), 8)
    for _ in range(8):
        seen = one.step(seen.sum(axis=2)).observations
    assert_same_state(one, other)


def test_synchronous_scenario_neither_stores_nor_compiles_clocks():
    sim = apart()
    sim.step(tape(sim, 1)[0])
    assert sim.conditions == {} and "commands" not in sim.get_state()
    assert take_commands not in sim._runner._stages._entries
    assert not {"activation", "hold"} & PLANE.to_plain().keys()
    clocked = apart(activation="periodic")
    clocked.step(tape(clocked, 1)[0])
    assert take_commands in clocked._runner._stages._entries


@pytest.mark.parametrize("kind", [*KINDS])
def test_activation_passes_through_plain_data_and_files(kind, tmp_path):
    scenario = PLANE.replace(activation=KINDS[kind], hold="stop")
    assert rv.Scenario.from_plain(scenario.to_plain()) == scenario
    scenario.to_toml(tmp_path / "custom.toml")
    assert rv.Scenario.from_toml(tmp_path / "custom.toml") == scenario
    assert hash(scenario) == hash(rv.Scenario.from_plain(scenario.to_plain()))
    assert PLANE.replace(activation=kind).activation == rv.Activation(kind=kind)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("randum", "did you mean 'random'"),
        ({"kind": "random", "period": 3}, "activation.kind = 'periodic'"),
        ({"kind": "random", "probability": 0.0}, r"in (0, 1]"),
        ({"kind": "bounded", "max_wait": 0}, "activation.max_wait is 0"),
        ({"kind": "periodic", "period": [1, 2]}, "one for each robot"),
        ({"kind": "periodic", "period": 3, "phase": 3}, "below its period of 3 steps"),
        ({"kind": "periodic", "period": [2, 2, 0, 1, 1]}, "activation.period[2]"),
        ({"kinds": "random"}, "did you mean 'kind'"),
        (3, "an Activation or a table"),
    ],
)
def test_invalid_activation_is_named_with_a_remedy(given, words):
    assert words in refusal(lambda: PLANE.replace(activation=given))
