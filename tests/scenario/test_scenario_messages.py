"""What scenarios, graphs and obstacles say to values of the wrong kind: field, value and remedy."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from soup import DEEP, HUGE, UNWRITABLE, in_numpy, refusal

import rendezvous_env as rv
from rendezvous_env import Disc, ObstacleField, Polygon, RewardWeights, Scenario, graphs
from rendezvous_env.checks import UnknownFieldError
from rendezvous_env.limits import MOST_OBSTACLES, MOST_ROBOTS
from rendezvous_env.scenario import scenarios

PAIR = Scenario(n_robots=2)


# ---- scenarios ----------------------------------------------------------------------------------

FIELDS = ("merge_radius", "time_step", "time_limit", "max_speed", "max_turn_rate", "spawn_size")
REFUSED = [
    *[({field: HUGE}, f"{field} is a whole number of about 401 digits; it") for field in FIELDS],
    *[({field: 1e300}, rf"{field} is 1e\+300; .* from 1e-09 to 1e\+09") for field in FIELDS],
    *[({field: 1e-300}, rf"{field} is 1e-300; .* from 1e-09") for field in FIELDS],
    *[({field: np.ones(2)}, rf"{field} is array\(\[1\., 1\.\]\)") for field in FIELDS],
    ({"obstacle_range": 1e300}, r"obstacle_range is 1e\+300"),
    ({"n_robots": HUGE}, "n_robots is a whole number of about 401 digits"),
    ({"n_robots": 10**9}, f"n_robots is 1000000000; .* at most {MOST_ROBOTS}"),
    ({"dim": UNWRITABLE}, "dim is a whole number of about 5001 digits; it must be 2 or 3"),
    ({"dim": [2]}, r"dim is \[2\]; it must be 2 or 3"),
    *[
        ({field: ["a", "word"]}, rf"{field} is \['a', 'word'\]; it must be one of")
        for field in ("robot_model", "obstacle_contact", "local_frames", "on_merge")
    ],
    ({"robot_model": np.array(["unicycle"])}, r"robot_model is array\(\['unicycle'\]"),
    ({"require_connected": 1}, "require_connected is 1; it must be one of True, False"),
    ({"allow_long_step": np.ones(2, bool)}, r"allow_long_step is array\(\[ True, True\]\)"),
    ({"name": 5}, "name is 5; it must be a word"),
    ({"name": "x" * 300}, r"name is 'x+\.\.\.x+'; .* at most 255 printable"),
    ({"name": "a\0b"}, r"name is 'a\\x00b'; .* printable"),
    ({"name": "\ud800"}, r"name is '\\ud800'"),
    ({"graph": 5}, r"graph: weights have shape \(\); they must be"),
    ({"graph": None}, "graph is None; it must be numbers"),
    ({"graph": DEEP}, r"graph is \[\[\[\[\[\[\.\.\.\]\]\]\]\]\]"),
    ({"graph": [["a"]]}, r"graph is \[\['a'\]\]; it must be numbers"),
    ({"graph": {"kind": ["path"]}}, r"graph: \['path'\] is not a graph; choose one of complete"),
    ({"graph": {5: "path"}}, "graph has no key 5; known are"),
    ({"graph": {"kind": "path", "weight_range": 5.0j}}, "graph: weight_range .* finite"),
    ({"graph": {"kind": "path", "weight_range": [1, HUGE]}}, "graph: weight_range .* 1e-09 to 1e"),
    ({"graph": {"kind": "erdos_renyi", "probability": "x"}}, "graph: probability 'x' must be"),
    ({"graph": {"edges": 5}}, "graph: edges is 5; it must be a sequence"),
    ({"graph": {"edges": [5]}}, r"graph: an edge is 5; it must be \(i, j\) or"),
    ({"graph": {"edges": [[0, 1.5]]}}, r"graph: an edge is \[0, 1\.5\]; .* whole indices"),
    ({"graph": {"edges": [[0, math.nan]]}}, r"graph: an edge is \[0, nan\]; .* whole indices"),
    ({"graph": {"edges": [[0, 1]], "n_nodes": "x"}}, "graph: n_nodes is 'x'; .* whole number"),
    ({"graph": {"edges": [[0, 1, 1e300]]}}, r"edge \(0, 1\) has weight 1e\+300; it must be pos"),
    ({"graph": 1e-300 * (1 - np.eye(5))}, r"a\[0, 1\] = 1e-300 must be 0, or from 1e-09 to 1e\+09"),
    ({"obstacles": 5}, "obstacles: 5 must be a sequence of obstacles"),
    ({"obstacles": [5]}, r"obstacles\[0\]: 5 must be a Disc"),
    ({"obstacles": [{"kind": ["disc"]}]}, r"obstacles: kind \['disc'\] must be one of disc"),
    ({"obstacles": {5: 5}}, "obstacles: a disc has no key 5; known are"),
    ({"obstacles": [{"centre": DEEP, "radius": 1}]}, r"obstacles: centre .* must be 2 finite"),
    ({"obstacles": [{"centre": [0, HUGE], "radius": 1}]}, "centre .* of a Disc must be 2 finite"),
    ({"obstacles": [{"centre": "12", "radius": 1}]}, "centre '12' of a Disc must be 2 finite"),
    ({"obstacles": [{"centre": [0, 0], "radius": 1e300}]}, r"radius 1e\+300 of a Disc .* at most"),
    ({"obstacles": [{"vertices": [1, 2, 3]}]}, r"vertices\[0\] 1 of a Polygon must be 2 finite"),
    ({"obstacle_slots": True}, "obstacle_slots is True; it must be None or at least the number"),
    ({"obstacle_slots": 10**9}, f"obstacle_slots is 1000000000; .* at most {MOST_OBSTACLES}"),
    ({"obstacle_slots": 2.0}, r"obstacle_slots is 2\.0"),
    ({"neighbour_slots": True}, "neighbour_slots is True"),
    ({"neighbour_slots": 10**9}, "neighbour_slots is 1000000000; .* from 1 to n_robots - 1 = 4"),
    ({"start_positions": 5}, r"start_positions has shape \(\); it must be \(5, 2\)"),
    ({"start_positions": [[HUGE, 0]] * 5}, r"start_positions is \[\[.*; it must be numbers"),
    ({"start_positions": [[1, 2], [3]]}, r"start_positions is \[\[1, 2\], \[3\]\]; .*without gaps"),
    ({"start_positions": [[1e160 * k, 0] for k in range(5)]},
        r"start_positions of robot_1 is \[1e\+160, 0\.0\]; it must be finite, and from -1e\+09"),
    ({"start_positions": DEEP}, r"start_positions is \[\[\[\[\[\["),
    ({"time_limit": 1e9, "time_step": 1e-9}, r"time_limit is 1e\+09 s: 1e\+18 steps of 1e-09 s"),
]  # fmt: skip


@pytest.mark.parametrize(("fields", "message"), REFUSED)
def test_scenarios_say_what_is_wrong_with_a_value_of_any_kind(fields, message):
    assert re.search(message, refusal(Scenario, **fields)), refusal(Scenario, **fields)


def test_an_unknown_field_is_told_with_the_nearest_one_at_every_door():
    for call in (Scenario, Scenario().replace, lambda **f: Scenario.from_plain(f)):
        for kind in (TypeError, ValueError, UnknownFieldError):
            assert "scenario has no field 'n_robot'; did you mean 'n_robots'" in refusal(
                call, kind=kind, n_robot=3
            )
    assert "did you mean 'progress'" in refusal(RewardWeights, progres=1, kind=TypeError)
    assert "no field 'merge_radios'" in refusal(rv.parallel_env, "duo", merge_radios=1)
    with pytest.raises(TypeError, match="positional"):
        RewardWeights(1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Scenario(n_agents=3), "no field 'n_agents'; did you mean 'n_robots'"),
        (lambda: rv.make_vec("duo", num_envs=1, num_agents=3), "did you mean 'n_robots'"),
        (lambda: Scenario(dt=0.1), "no field 'dt'; did you mean 'time_step'"),
        (lambda: Scenario(max_steps=9), "'max_steps'; did you mean 'time_limit'.* not in steps"),
        (lambda: rv.parallel_env("duo", max_steps=9), "'max_steps'; did you mean 'max_cycles'"),
        (lambda: Scenario(graph="ring"), "'ring' is not a graph; .* did you mean 'cycle'"),
        (lambda: Scenario(graph="line"), "did you mean 'path'"),
        (lambda: Scenario(obstacles=[(0, 0, 1)]), r"\(0, 0, 1\) must be a Disc.*rv\.Disc\(\(0"),
        (lambda: Scenario(sensing={"nois": 0.1}), "sensing has no field 'nois'; .*'noise'"),
        (lambda: Scenario(sensing=0.1), "sensing is 0.1; it must be a Sensing, or a table"),
        (lambda: Scenario(graph={"kind": "directed", "edges": np.array(3)}), "edges is array.3.;"),
    ],
)
def test_words_of_other_packages_lead_to_ours(call, said):
    assert re.search(said, refusal(call)), refusal(call)


EVERY_FIELD = Scenario(
    n_robots=3,
    graph={"kind": "edges", "edges": [(0, 1, 2.0), (1, 2)], "weight_range": [0.5, 2.0]},
    time_step=0.01,
    max_speed=1.0,
    max_turn_rate=1.0,
    max_acceleration=1.0,
    obstacles=[Disc((20.0, 0.0), 1.0), Polygon(((30, 0), (31, 0), (30, 1)))],
    obstacle_slots=3,
    neighbour_slots=2,
    start_positions=((0, 0), (1, 0), (0, 1)),
    sensing=rv.Sensing(range=5.0, noise=0.1, delay=2, sectors=8),
    reward=RewardWeights(clearance_penalty=0.1),
)
FIELDS_OF_NUMPY = in_numpy(EVERY_FIELD.to_plain())


def test_numpy_numbers_become_pythons_own_in_every_field(tmp_path):
    assert Scenario(sensing={"noise": 0.1}) == Scenario(sensing=rv.Sensing(noise=0.1))
    made = Scenario(
        **FIELDS_OF_NUMPY
        | {
            "reward": RewardWeights(**FIELDS_OF_NUMPY["reward"]),
            "require_connected": np.bool_(True),
        }
    )
    assert made == EVERY_FIELD and hash(made) == hash(EVERY_FIELD)
    made.to_toml(tmp_path / "all.toml")
    assert Scenario.from_toml(tmp_path / "all.toml") == EVERY_FIELD
    kept = [*vars(made.reward).values(), *vars(made.sensing).values(), *vars(made).values()]
    assert not any(isinstance(value, np.generic) for value in kept)
    assert type(made.neighbour_slots) is int and made.require_connected is True
    assert type(Scenario(merge_radius=np.float32(0.5)).merge_radius) is float


SPAN = (np.float64(7.0), np.float32(8.0))
DRAWN = [
    ObstacleField(np.int64(2), SPAN, region=np.float32(20.0), keep_out=np.float64(0.5)),
    rv.WallField("trap", SPAN, SPAN, np.float64(0.5), region=np.float64(2.0), keep_out=np.int8(1)),
]


@pytest.mark.parametrize("drawn", DRAWN, ids=lambda drawn: type(drawn).__name__)
def test_numpy_numbers_become_pythons_own_in_fields_of_obstacles(drawn, tmp_path):
    scenario = Scenario(obstacles=drawn)
    scenario.to_toml(tmp_path / "drawn.toml")
    assert Scenario.from_toml(tmp_path / "drawn.toml").obstacles == drawn


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        (5, "a scenario's plain data is 5; it must be a mapping"),
        ({"reward": 5}, "reward is 5; it must be a table of its weights"),
        ({"reward": {"progress": HUGE}}, "reward.progress is a whole number of about 401"),
        ({"reward": {"progress": 1e300}}, r"reward.progress is 1e\+300; it must be a finite"),
        ({5: 5}, "scenario has no field 5; known are name, n_robots"),
    ],
)
def test_plain_data_of_the_wrong_kind(plain, message):
    assert re.search(message, refusal(Scenario.from_plain, plain))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("n_robots = " + "9" * 400, "n_robots is a whole number of about 40[01] digits"),
        ("n_robots = " + "9" * 5000, "mine.toml: not a TOML file"),
        ("graph = " + "[" * 5000 + "]" * 5000, "mine.toml: its tables and lists are nested too"),
        ("graph = " + "[" * 60 + "]" * 60, "graph"),
        ("reward = 5", "reward is 5; it must be a table"),
        ("obstacle_slots = true", "obstacle_slots is True"),
        ("time_limit = 1e308", r"time_limit is 1e\+308"),
        ("time_limit = 1979-05-27", "time_limit is datetime.date"),
        ("robot_model = ['unicycle']", r"robot_model is \['unicycle'\]"),
        ("time_step = 1e-300\nallow_long_step = true", "time_step is 1e-300"),
        ("n_robots = 1000000000", "n_robots is 1000000000"),
        ("name = '\\ud800'\nx", "not a TOML file"),
    ],
)
def test_toml_of_the_wrong_kind(text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    assert re.search(message, refusal(Scenario.from_toml, path))
    path.write_bytes(b"name = '\xff\xfe'")
    assert "mine.toml: not a TOML file" in refusal(Scenario.from_toml, path)


def test_names_and_paths_that_no_file_can_have(tmp_path):
    long, nul = str(tmp_path / ("x" * 300 + ".toml")), str(tmp_path / "a\0b.toml")
    for call in (Scenario.from_toml, Scenario().to_toml, rv.parallel_env, scenarios.resolve):
        assert "it is too long for a file" in refusal(call, long)
        assert "no file can be called that" in refusal(call, nul)
    assert list(tmp_path.iterdir()) == []
    for name in ("x" * 300, "a\0b", "", "fig33"):
        assert re.search(r"scenario '.*' is unknown; .*known are", refusal(scenarios.get, name))
    for name in (5, None, ["fig3"], b"fig3", {}):
        assert "is unknown; known are fig3" in refusal(scenarios.get, name)
        assert "it must be a Scenario, the name of one, or the path" in refusal(rv.make_vec, name)
    for path in (5, None, ["a.toml"]):
        assert "path is" in refusal(Scenario.from_toml, path)
    with pytest.raises(FileNotFoundError):
        Scenario().to_toml(tmp_path / "absent" / "x.toml")


def test_a_file_that_cannot_be_replaced_leaves_nothing_behind(tmp_path):
    (tmp_path / "taken.toml").mkdir()
    with pytest.raises(OSError, match="taken"):
        Scenario().to_toml(tmp_path / "taken.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["taken.toml"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Disc(np.zeros(()), 1), r"centre array\(0\.\) of a Disc"),
        (lambda: Polygon(np.array(5)), r"vertices array\(5\) of a Polygon"),
        (lambda: Polygon([(0, 0)] * 2000), "at most 1000"),
        (lambda: ObstacleField(10**9, (1, 2), 1, 1), "count 1000000000 .* <= 10000"),
        (lambda: ObstacleField(1, (1, HUGE), 1, 1), "radius .* low <= high"),
        (lambda: ObstacleField(1, (1, 2), HUGE, 1), "region a whole number of about 401"),
        (lambda: ObstacleField(1, (1, 2), 1, 1e300), r"keep_out 1e\+300 .* at most 1e\+09"),
        (lambda: graphs.path("a"), "weight_range .*'a'"),
        (lambda: graphs.path((1, 2, 3)), r"weight_range \(1, 2, 3\)"),
        (lambda: graphs.erdos_renyi(math.nan), r"probability nan must be in \(0, 1\]"),
        (lambda: graphs.Graph("edges", edges=((0, 9, 1.0),), n_nodes=3), r"edge \(0, 9\)"),
        (lambda: graphs.Graph("edges"), "n_nodes is None"),
        (lambda: graphs.Graph("path", edges=((0, 1, 1.0),)), "a path has neither edges"),
        (lambda: graphs.from_edges([(0, HUGE)]), "n_nodes is a whole number of about 401"),
    ],
)
def test_obstacles_and_graphs_of_the_wrong_kind(make, message):
    assert re.search(message, refusal(make)), refusal(make)


def test_simulators_and_certificates_take_names_and_files(tmp_path):
    PAIR.to_toml(tmp_path / "pair.toml")
    for one in (PAIR, tmp_path / "pair.toml"):
        assert rv.Simulator(one).scenario == PAIR
        assert rv.certificate(one) == rv.certificate(PAIR)
    assert rv.Simulator("duo").scenario == scenarios.get("duo")
    for call in (rv.Simulator, rv.certificate):
        assert "did you mean 'ring-12'" in refusal(call, "ring12")
        assert "it must be a Scenario, the name of one, or the path" in refusal(call, 5)
