"""Fuzzing of the core's borders: whatever comes in, it is refused in words or gives finite numbers.

Every case asserts the same rule. A refusal is an exception of the kinds that the interface names,
raised by a ``raise`` of this project and not by what happens to fail inside, with a message of
readable length, and nothing has changed; what is accepted then runs without a number that is not
finite; and neither takes longer than a few seconds. A few cases run by default, thousands under
the ``slow`` marker; all are the same in every run.
"""

from __future__ import annotations

import dataclasses
import time
import traceback
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soup
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from soup import absurd, any_table, nearly

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, TimeStepWarning, vector
from rendezvous_env.engine.memory import RUNNING
from rendezvous_env.envs.gymnasium_env import make_env
from rendezvous_env.safety.turning import gated_turn_rate
from rendezvous_env.scenario import scenarios
from rendezvous_env.scenario.start_options import OPTIONS

FEW, MANY = 2, 28
EFFORTS = [
    pytest.param(FEW, id="few"),
    pytest.param(MANY, id="many", marks=pytest.mark.slow),
]
LONGEST = 5.0
"""Seconds of processor time that one call may take."""
OURS = tuple(str(Path(module.__file__).parent) for module in (rv, baselines))
TEAMS = {
    "plane": Scenario(
        n_robots=3,
        obstacles=[{"centre": [1.0, 2.0], "radius": 0.5}],
        time_limit=5.0,
        graph={"kind": "random_tree", "weight_range": [0.5, 2.0]},
    ),
    "space": Scenario(n_robots=2, dim=3, obstacle_slots=1, time_limit=5.0),
    "unicycle": Scenario(n_robots=3, robot_model="unicycle", obstacle_slots=1, time_limit=5.0),
    "flyer": Scenario(n_robots=2, dim=3, robot_model="nonholonomic_3d", time_limit=5.0),
}
teams = st.sampled_from(sorted(TEAMS))


def explore(check: Callable[..., None], count: int, *given_values: st.SearchStrategy) -> None:
    """Run a check on many cases, the same in every run."""
    limits = settings(
        max_examples=count, database=None, suppress_health_check=list(HealthCheck), deadline=None
    )
    limits(given(*given_values)(check))()


@dataclasses.dataclass
class Refused:
    """How a call refused."""

    error: Exception


def attempt(call: Callable[[], Any], *kinds: type[Exception]) -> Any:
    """What a call returns, or how it refused; any other end is a failure."""
    begun, refusals = time.process_time(), kinds or (ValueError,)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TimeStepWarning)
            return call()
    except refusals as error:
        assert len(str(error)) < 2000
        if isinstance(error, OSError):  # as the system puts it
            return Refused(error)
        last = traceback.extract_tb(error.__traceback__)[-1]
        assert last.filename.startswith(OURS), f"refused by {last.filename}: {error!r}"
        assert (last.line or "").startswith("raise"), f"refused by {last.line}: {error!r}"
        return Refused(error)
    finally:
        assert time.process_time() - begun < LONGEST


def assert_finite(*arrays: Any) -> None:
    for array in arrays:
        assert np.isfinite(array).all(), array


def play(simulator: Simulator, steps: int, seed: int = 0) -> None:
    """Steps under wild actions, of which every number must be finite."""
    random, shape = np.random.default_rng(seed), simulator._acted
    largest = np.finfo(np.float32).max
    for k in range(steps):
        scale = (0.0, 1.0, largest)[k % 3]
        actions = (scale * random.uniform(-1, 1, shape)).astype(np.float32)
        outcome = simulator.step(actions)
        assert_finite(
            simulator.positions, simulator.headings, simulator.frames, simulator.lyapunov(),
            simulator.path_length, simulator.initial_lyapunov, outcome.observations,
            outcome.rewards, outcome.robot_rewards, outcome.lyapunov_before_merge,
            outcome.lyapunov_after_merge, outcome.merge_rise, outcome.merge_excess,
        )  # fmt: skip
        assert not np.isnan(outcome.clearance).any()


def start_and_play(simulator: Simulator, steps: int = 6) -> None:
    """An episode, if there is room for its start, which may be too little."""
    begun = attempt(lambda: simulator.reset(0), ValueError, RuntimeError)
    if not isinstance(begun, Refused):
        assert_finite(begun, simulator.positions, simulator.lyapunov())
        play(simulator, steps)


@pytest.fixture(scope="module", autouse=True)
def warm() -> None:
    """Compile what the cases need, so that its time does not count as theirs."""
    for scenario in TEAMS.values():
        for num_envs in (1, 3):
            simulator = Simulator(scenario, num_envs)
            simulator.reset(0)
            play(simulator, 6)
        for name in baselines.names(scenario):
            rv.rollout(scenario.replace(time_limit=0.3), baselines.make(name, scenario))
        wrapped = rv.HeadingVectorWrapper(rv.parallel_env(scenario))
        observations, _ = wrapped.reset(seed=0)
        wrapped.step({name: np.ones(wrapped.steering.action_size) for name in observations})
        tank = rv.EnergyTankWrapper(rv.parallel_env(scenario))
        observations, _ = tank.reset(seed=0)
        tank.step({name: np.ones(scenario.action_size) for name in observations})
        d = scenario.dim
        ones = np.ones(d)
        rv.certified_heading(ones, ones, ones, min_alignment=0.1, dead_zone=0.1, max_turn=0.1)
        gated_turn_rate(
            np.ones(d - 1), ones, None if d == 2 else 0.1,
            min_alignment=0.1, dead_zone=0.1, duration=0.1, max_rate=1.0,
        )  # fmt: skip
        rv.certificate(scenario)
    Scenario(obstacles={"count": 1, "radius": 0.1, "region": 1, "keep_out": 0})


# ---- scenarios ----------------------------------------------------------------------------------


@pytest.mark.parametrize("effort", EFFORTS)
def test_scenarios(effort):
    def check(fields):
        plain = isinstance(fields.get("reward"), dict)
        scenario = attempt(lambda: Scenario.from_plain(fields) if plain else Scenario(**fields))
        if isinstance(scenario, Refused):
            return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TimeStepWarning)
            assert Scenario.from_plain(scenario.to_plain()) == scenario
        assert_finite(scenario.action_bounds, scenario.tau, scenario.max_steps)
        certificate = attempt(lambda: rv.certificate(scenario))
        assert not np.isnan(certificate.time_bound)
        start_and_play(Simulator(scenario))

    explore(check, 60 * effort, soup.scenario_fields())


@pytest.mark.parametrize("effort", EFFORTS)
def test_toml(effort, tmp_path):
    path = tmp_path / "mine.toml"
    keys = [field.name for field in dataclasses.fields(Scenario)]

    def check(text):
        path.write_bytes(text)
        scenario = attempt(lambda: Scenario.from_toml(path))
        if not isinstance(scenario, Refused):
            scenario.to_toml(path)

    explore(check, 40 * effort, soup.toml_texts(keys))


@pytest.mark.parametrize("effort", EFFORTS)
def test_names_and_paths(effort, tmp_path):
    def check(name, door):
        if isinstance(name, str) and (name.endswith(".toml") or "/" in name):
            name = str(tmp_path / name)
        attempt(lambda: door(name), ValueError, OSError)

    doors = [scenarios.get, scenarios.resolve, Scenario.from_toml, rv.parallel_env, rv.make_vec]
    words = st.text(max_size=20) | st.sampled_from(["fig3", "x" * 300 + ".toml", "a\0.toml"])
    explore(check, 15 * effort, words | absurd, st.sampled_from(doors))


# ---- resets -------------------------------------------------------------------------------------


class Door:
    """One kind of environment, and how to look at its episode."""

    def __init__(self, name: str, scenario: Scenario) -> None:
        together = {"simulator": 3, "vector": 3, "same step": 2, "disabled": 2}
        self.num_envs = together.get(name, 2 if name.startswith("vector ") else 1)
        self.size, self.n = scenario.action_size, scenario.n_robots
        self.env = getattr(self, "_" + name.replace(" ", "_"))(scenario)
        if "heading" in name:
            self.size = self.env.steering.action_size

    def _simulator(self, scenario: Scenario) -> Any:
        return Simulator(scenario, self.num_envs)

    def _pettingzoo(self, scenario: Scenario) -> Any:
        return rv.parallel_env(scenario)

    def _aec(self, scenario: Scenario) -> Any:
        return rv.rendezvous_v0.env(scenario)

    def _gymnasium(self, scenario: Scenario) -> Any:
        return make_env(scenario)

    def _vector(self, scenario: Scenario) -> Any:
        return rv.make_vec(scenario, self.num_envs, max_cycles=2)

    def _same_step(self, scenario: Scenario) -> Any:
        return rv.make_vec(scenario, self.num_envs, "SameStep", max_cycles=2)

    def _disabled(self, scenario: Scenario) -> Any:
        return rv.make_vec(scenario, self.num_envs, "Disabled", max_cycles=2)

    def _heading(self, scenario: Scenario) -> Any:
        return rv.HeadingVectorWrapper(rv.parallel_env(scenario), decision_period=2)

    def _vector_heading(self, scenario: Scenario) -> Any:
        env = rv.make_vec(scenario, self.num_envs, max_cycles=3)
        return vector.HeadingVectorWrapper(env, decision_period=2)

    def _tank(self, scenario: Scenario) -> Any:
        return rv.EnergyTankWrapper(rv.parallel_env(scenario), decision_period=2)

    def _vector_tank(self, scenario: Scenario) -> Any:
        env = rv.make_vec(scenario, self.num_envs, max_cycles=3)
        return vector.EnergyTankWrapper(env, budget=1.0, observe_level=True)

    @property
    def simulator(self) -> Simulator:
        """What everything is around."""
        return self.env if isinstance(self.env, Simulator) else self.env.unwrapped.simulator

    def state(self) -> Any:
        """All that a refusal must leave as it is."""
        env = self.env
        if hasattr(env, "get_state"):
            return env.get_state()
        return env.agent_selection, env.rewards, env.unwrapped.get_state()

    def refuses_or_plays(self, call: Callable[[], Any], *kinds: type[Exception]) -> bool:
        """The rule; whether the call was accepted."""
        before = self.state()
        if isinstance(attempt(call, *kinds), Refused):
            np.testing.assert_equal(self.state(), before)
            return False
        simulator = self.simulator
        assert_finite(simulator.positions, simulator.lyapunov(), simulator.observe())
        return True


@cache
def door(name: str, team: str) -> Door:
    """Made once, for all cases."""
    return Door(name, TEAMS[team])


NAMES = ["simulator", "pettingzoo", "aec", "gymnasium", "vector", "same step", "disabled",
         "heading", "vector heading", "tank", "vector tank"]  # fmt: skip
names = st.sampled_from(NAMES)


@st.composite
def options_of(draw: st.DrawFn, team: str, num_envs: int) -> Any:
    """Options of a reset."""
    n, d = TEAMS[team].n_robots, TEAMS[team].dim
    turn = np.eye(d)[::-1] * np.array([1.0] + [-1.0] * (d - 1))[:, None]
    ones = np.ones((n, n)) - np.eye(n)
    values = {
        "positions": any_table(n, d) | any_table(num_envs, n, d),
        "headings": any_table(n, d - 1) | any_table(n) | any_table(num_envs, n, d - 1),
        "frames": any_table(n, d, d) | st.sampled_from([np.tile(turn, (n, 1, 1)), np.eye(d)]),
        "weights": any_table(n, n) | st.sampled_from([ones, 0 * ones, 0.9 * ones, 1e300 * ones]),
        "obstacles": soup.obstacles(d),
        "position": absurd,
        "else": absurd,
    }
    keys = draw(st.lists(st.sampled_from(sorted(values)), max_size=3, unique=True))
    options: dict[Any, Any] = {key: draw(values[key]) for key in keys}
    if draw(st.integers(0, 5)) == 0:
        return draw(absurd)
    if draw(st.integers(0, 5)) == 0:
        options[draw(st.sampled_from([5, None, 10**5000, ("a",), 1.5, "\0"]))] = 5
    if draw(st.integers(0, 3)) == 0:
        options["reset_mask"] = draw(absurd | st.lists(st.booleans(), max_size=3))
    return options


@pytest.mark.parametrize("effort", EFFORTS)
def test_options_of_a_reset(effort):
    def check(name, team, data):
        it = door(name, team)
        it.env.reset(seed=1)
        options = data.draw(options_of(team, it.num_envs))
        reset = lambda: it.env.reset(seed=2, options=options)  # noqa: E731
        if it.refuses_or_plays(reset, ValueError, RuntimeError):
            play(it.simulator, 3)

    explore(check, 60 * effort, names, teams, st.data())
    assert set(OPTIONS) <= {"positions", "headings", "frames", "weights", "obstacles"}


@pytest.mark.parametrize("effort", EFFORTS)
def test_seeds_and_masks(effort):
    def check(name, team, seed, mask):
        it = door(name, team)
        it.env.reset(seed=1)
        it.refuses_or_plays(lambda: it.env.reset(seed=seed))
        if name == "simulator":
            it.refuses_or_plays(lambda: it.env.reset(mask=mask))
            it.refuses_or_plays(lambda: it.env.restart(mask))

    some = st.integers(0, 2**63 - 1)
    seeds = nearly(some | some.map(np.array) | some.map(np.uint64), -1, 2**63 - 1, 2**64, [None])
    masks = st.lists(st.booleans(), min_size=2, max_size=3) | absurd
    explore(check, 40 * effort, names, teams, seeds | st.lists(seeds, max_size=3), masks)


# ---- actions ------------------------------------------------------------------------------------

robots = st.sampled_from(["robot_0", "robot_1", "robot_2", "robot_9", 5, None, ("a",)])


@st.composite
def actions_of(draw: st.DrawFn, it: Door) -> Any:
    """What a door may be given in place of actions."""
    if draw(st.integers(0, 6)) == 0:
        return draw(absurd)
    if hasattr(it.env, "agent_selection"):
        return draw(any_table(it.size))
    if hasattr(it.env, "agents"):
        table = {name: draw(any_table(it.size)) for name in it.env.agents}
        if draw(st.integers(0, 4)) == 0:
            table.pop(draw(robots), None)
        if draw(st.integers(0, 4)) == 0:
            table[draw(robots)] = draw(any_table(it.size))
        return table
    single = () if type(it.env).__name__ == "RendezvousEnv" else (it.num_envs,)
    return draw(any_table(*single, it.n, it.size))


@pytest.mark.parametrize("effort", EFFORTS)
def test_actions(effort):
    def check(name, team, data):
        it = door(name, team)
        it.env.reset(seed=data.draw(st.integers(0, 3)))
        for _ in range(data.draw(st.integers(1, 4))):
            actions = data.draw(actions_of(it))
            it.refuses_or_plays(lambda given=actions: it.env.step(given), ValueError, KeyError)

    explore(check, 60 * effort, names, teams, st.data())


# ---- policies -----------------------------------------------------------------------------------


@st.composite
def policies(draw: st.DrawFn) -> tuple[Any, str, dict[str, Any]]:
    """A name, the team that it is for, and options."""
    team = draw(teams)
    name = draw(nearly(st.sampled_from(baselines.names()), "bearing", "learn"))
    values = {
        "clearance": nearly(st.floats(0, 3)),
        "persistence": nearly(st.floats(0, 3)),
        "min_alignment": nearly(st.floats(0.01, 0.99)),
        "max_turn_rate": nearly(soup.lengths),
        "seed": nearly(st.integers(0, 5)),
        "clearence": absurd,
    }
    keys = draw(st.lists(st.sampled_from(sorted(values)), max_size=2, unique=True))
    return name, team, {key: draw(values[key]) for key in keys}


@pytest.mark.parametrize("effort", EFFORTS)
def test_policies(effort):
    def check(made, data):
        name, team, options = made
        scenario = TEAMS[team]
        policy = attempt(lambda: baselines.make(name, scenario, **options))
        if isinstance(policy, Refused) or hasattr(policy, "watch"):  # sees more than observations
            return
        shape = (2, scenario.n_robots, *scenario.observation_layout.shape)
        seen = data.draw(any_table(*shape) | any_table(*shape[1:]))
        usual = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
        assert_finite(policy(usual, 0.0))
        time = data.draw(nearly(st.floats(0, 9), [0.0, 1.0]))
        with np.errstate(all="ignore"):  # such observations no simulator gives out
            attempt(lambda: policy(seen, time))
        attempt(lambda: policy.reset(data.draw(absurd | st.lists(st.booleans()))))
        policy.reset()
        assert_finite(policy(usual, np.zeros(2)))

    explore(check, 30 * effort, policies(), st.data())


# ---- settings -----------------------------------------------------------------------------------

margins, periods = st.floats(0.01, 0.99), st.sampled_from([1, 3])
WRAPPER = {
    "min_alignment": nearly(margins, 0, 1),
    "max_turn_rate": nearly(soup.lengths, 0),
    "frame": nearly(st.sampled_from(["net_bearing", "local"]), "body"),
    "decision_period": nearly(periods, 0, 2.0),
    "certified": nearly(st.booleans(), 1),
}
TANK = {
    "budget": nearly(soup.lengths, -1e-9),
    "observe_level": nearly(st.booleans(), 1),
    **{name: WRAPPER[name] for name in ("min_alignment", "frame", "decision_period")},
}
GAINS = {
    "min_gain": nearly(st.none() | soup.lengths, 0.0, np.nan),
    "max_gain": nearly(st.none() | soup.lengths, -1.0),
    **{name: WRAPPER[name] for name in ("frame", "decision_period")},
}
LINKS = {
    "share": nearly(st.floats(0.01, 1.0), 0.0, 1.1),
    "bearing_error": nearly(st.floats(0.0, 1.5), -0.1, 2.0),
    **{name: WRAPPER[name] for name in ("frame", "decision_period")},
}
WRAPPERS = [
    ("HeadingVectorWrapper", WRAPPER),
    ("EnergyTankWrapper", TANK | {"bearing_error": LINKS["bearing_error"]}),
    ("GainWrapper", GAINS),
    ("LinkKeepingWrapper", LINKS),
]
BATCH = {
    "num_envs": nearly(st.integers(1, 4), 0, 2.0),
    "num_threads": nearly(st.sampled_from([None, 1, 2]), 0),
    "max_cycles": nearly(st.sampled_from([None, 1, 5, 10**15]), 0),
    "autoreset_mode": nearly(st.sampled_from(["NextStep", "SameStep", "Disabled"]), "Next"),
    "render_mode": nearly(st.none(), "window"),
    "merge_radius": nearly(soup.lengths),
    "merge_radios": absurd,
}


def some_of(values: dict[str, st.SearchStrategy]) -> st.SearchStrategy:
    """A few keywords."""
    keys = st.lists(st.sampled_from(sorted(values)), max_size=3, unique=True)
    return keys.flatmap(lambda chosen: st.fixed_dictionaries({key: values[key] for key in chosen}))


@pytest.mark.parametrize("effort", EFFORTS)
def test_arguments_of_wrappers(effort):
    def check(team, alone, kind, data):
        scenario = TEAMS[team]
        base = rv.parallel_env(scenario) if alone else rv.make_vec(scenario, 2, max_cycles=3)
        name, settings = kind
        wrap, arguments = getattr(rv if alone else vector, name), data.draw(some_of(settings))
        if data.draw(st.integers(0, 9)) == 0:
            base = data.draw(absurd)
        env = attempt(lambda: wrap(base, **arguments), ValueError, TypeError)
        if isinstance(env, Refused):
            return
        env.reset(seed=0)
        size, simulator = env.filter.action_size, env.unwrapped.simulator
        for k in range(3):
            raw = np.full(size, (1.0, -3e38, 1e-40)[k])
            if alone:
                env.step({name: raw for name in env.agents})
            else:
                env.step(np.tile(raw, (2, scenario.n_robots, 1)))
            assert_finite(simulator.positions, simulator.lyapunov(), simulator.observe())

    explore(check, 60 * effort, teams, st.booleans(), st.sampled_from(WRAPPERS), st.data())


@pytest.mark.parametrize("effort", EFFORTS)
def test_arguments_of_batches(effort):
    def check(team, arguments):
        env = attempt(lambda: rv.make_vec(TEAMS[team], **arguments))
        if isinstance(env, Refused):
            return
        start_and_play(env.simulator, 3)

    explore(check, 30 * effort, teams, some_of(BATCH))


@pytest.mark.parametrize("effort", EFFORTS)
def test_headings_turn_rates_and_certificates(effort):
    constants = {
        "min_alignment": nearly(margins),
        "dead_zone": nearly(soup.lengths),
        "max_turn": nearly(soup.lengths, np.inf),
    }
    rates = {
        "min_alignment": nearly(margins),
        "dead_zone": nearly(soup.lengths),
        "duration": nearly(soup.lengths),
        "max_rate": nearly(soup.lengths, np.inf, [1.0, 2.0]),
    }

    def check(vectors, given, turns, limits, margin, scenario):
        heading = attempt(lambda: rv.certified_heading(*vectors, **given))
        if not isinstance(heading, Refused):
            assert np.allclose(np.linalg.norm(heading, axis=-1), 1.0)
        for pitch in (None, 0.3):
            turn = attempt(lambda p=pitch: gated_turn_rate(turns, vectors[0], p, **limits))
            if not isinstance(turn, Refused):
                assert_finite(turn)
        certificate = attempt(lambda: rv.certificate(scenario, margin))
        if not isinstance(certificate, Refused):
            assert not np.isnan(certificate.time_bound)

    explore(
        check, 30 * effort, st.tuples(*[any_table(2) | any_table(3)] * 3),
        st.fixed_dictionaries(constants), any_table(1) | any_table(2),
        st.fixed_dictionaries(rates), nearly(margins),
        st.sampled_from(list(TEAMS.values())) | absurd,
    )  # fmt: skip


@pytest.mark.parametrize("effort", EFFORTS)
def test_rollouts(effort):
    def check(policy, answer, seed, num_envs):
        scenario = TEAMS["plane"].replace(time_limit=0.1, time_step=0.02, allow_long_step=True)
        act = (lambda observations, time: answer) if policy is None else policy
        call = lambda: rv.rollout(scenario, act, seed, num_envs, record="all")  # noqa: E731
        trajectory = attempt(call, ValueError, TypeError)
        if not isinstance(trajectory, Refused):
            assert_finite(trajectory.positions, trajectory.lyapunov, trajectory.observations)

    answers = any_table(1, 3, 2) | absurd
    explore(check, 15 * effort, st.none() | st.none() | soup.uncallable,
            answers, nearly(st.integers(0, 9), -1), nearly(st.integers(1, 2), 0))  # fmt: skip


# ---- states -------------------------------------------------------------------------------------


@st.composite
def spoilt(draw: st.DrawFn, state: Any) -> tuple[str, Any]:
    """A state with one entry changed: its name, and the state."""
    if not isinstance(state, dict) or draw(st.integers(0, 19)) == 0:
        return "", draw(absurd)
    name = draw(st.sampled_from(sorted(state)))
    kind = draw(st.sampled_from(["number", "number", "number", "value", "shape", "type", "gone"]))
    changed, value = dict(state), state[name]
    if isinstance(value, dict):
        inner, changed[name] = draw(spoilt(value))
        return inner, changed
    if kind == "gone":
        del changed[name]
    elif kind == "value" or not isinstance(value, np.ndarray) or not value.size:
        changed[name] = draw(absurd)
    elif kind == "shape":
        changed[name] = draw(st.sampled_from([value[None], value[:-1], value.ravel()]))
    elif kind == "type":
        kind = draw(st.sampled_from([object, str, np.float32, np.int8]))
        with np.errstate(all="ignore"):
            changed[name] = value.astype(kind)
    else:
        changed[name] = value.copy()
        place = draw(st.integers(0, value.size - 1))
        wrong = draw(soup.edges) if value.dtype.kind == "f" else draw(_whole(value.dtype))
        with np.errstate(all="ignore"):
            changed[name].flat[place] = wrong
    return name, changed


def _whole(dtype: np.dtype) -> st.SearchStrategy:
    if dtype == np.bool_:
        return st.booleans()
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    return st.sampled_from([0, 1, 2, 5, 10**9, low, high]) | st.integers(low, high)


@pytest.mark.parametrize("effort", EFFORTS)
def test_states(effort):
    def check(name, team, data):
        it = door(name, team)
        it.env.reset(seed=data.draw(st.integers(0, 3)))
        play(it.simulator, data.draw(st.integers(0, 2)))
        entry, state = data.draw(spoilt(it.state()))
        before = it.state()
        accepted = attempt(lambda: it.env.set_state(state))
        if isinstance(accepted, Refused):
            message, related = str(accepted.error), ("weights", "status", "merged_into", "agents")
            assert (entry or "state") in message or any(name in message for name in related)
            np.testing.assert_equal(it.state(), before)
        else:
            play(it.simulator, 20)
            assert (it.simulator.status >= RUNNING).all()

    stateful = st.sampled_from([name for name in NAMES if name != "aec"])
    explore(check, 40 * effort, stateful, teams, st.data())
