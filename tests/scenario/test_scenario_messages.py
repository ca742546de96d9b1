"""Error messages of scenarios, graphs and obstacles: field, value and remedy."""

import math
import re
import resource
from dataclasses import replace

import numpy as np
import pytest
from conftest import UNEQUAL
from strategies import DEEP, HUGE, in_numpy, refusal

import rendezvous_env as rv
from rendezvous_env import Capsule, Disc, ObstacleField, Polygon, Scenario, Sphere, checks
from rendezvous_env import graphs as g
from rendezvous_env.checks import UnknownFieldError
from rendezvous_env.limits import MAX_OBSTACLES, MAX_ROBOTS
from rendezvous_env.obstacles.parsing import parse
from rendezvous_env.scenario import scenarios

PAIR = Scenario(n_robots=2)
TRIANGLE = Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
ROW = [[k, 0.0] for k in range(5)]
WALLS = rv.WallField("trap", (7.0, 8.0), (2.0, 3.0), 0.5, region=2.0, keep_out=1)


def matrix(**entries: float) -> np.ndarray:
    """UNEQUAL with some entries a_ij changed on one side only, given as a01=…."""
    weights = UNEQUAL.copy()
    for name, value in entries.items():
        weights[int(name[1]), int(name[2])] = value
    return weights


FIELDS = (
    "time_step", "time_limit", "max_speed", "max_turn_rate", "max_acceleration", "obstacle_range",
    "spawn_size", "body_radius",
)  # fmt: skip
REFUSED = [
    ({"n_robots": 1}, r"n_robots is 1; it must be an integer, 2 or more"),
    ({"n_robots": True}, r"n_robots is True"),
    ({"n_robots": HUGE}, "n_robots is an integer of about 401 digits"),
    ({"n_robots": 10**9}, f"n_robots is 1000000000; .* at most {MAX_ROBOTS}"),
    ({"dim": 4}, r"dim is 4; it must be 2 or 3"),
    ({"dim": [2]}, r"dim is \[2\]; it must be 2 or 3"),
    *[
        ({"merge_radius": value}, rf"merge_radius is .*{text}.*; it must be a positive, finite num")
        for value, text in (
            (0, "0"), (-1.5, "-1.5"), (math.inf, "inf"), (math.nan, "nan"), ("1", "'1'"),
            (True, "True"), (None, "None"), (HUGE, "integer of about 401 digits"),
            (1e300, r"1e\+300"), (1e-300, "1e-300"), (np.ones(2), r"array\(\[1\., 1\.\]\)"),
        )
    ],
    *[({field: 0.0}, rf"{field} is 0\.0; .*positive, .* 1e-09 to 1e\+09 \w") for field in FIELDS],
    ({"robot_model": "car"}, r"robot_model is 'car'; it must be one of 'single_integrator'"),
    ({"robot_model": "unicycel"}, r"did you mean 'unicycle'\?"),
    ({"robot_model": "unicycle", "dim": 3},
        r"robot_model is 'unicycle'; .*'nonholonomic_3d'.*dim is 3"),
    ({"robot_model": "nonholonomic_3d"},
        r"robot_model is 'nonholonomic_3d'; .*'unicycle'.*dim is 2"),
    ({"obstacle_contact": "bounce"}, r"obstacle_contact is 'bounce'; .*'slide', 'stop', 'ignore'"),
    ({"require_connected": 1}, "require_connected is 1; it must be one of True, False"),
    ({"name": ""}, r"name is ''; it must be a word"),
    ({"name": "x" * 300}, r"name is 'x+\.\.\.x+'; .* at most 255 printable"),
    ({"name": "a\0b"}, r"name is 'a\\x00b'; .* printable"),
    ({"name": "\ud800"}, r"name is '\\ud800'"),
    ({"reward": 5}, r"reward is 5; it must be a RewardWeights, or a table"),
    ({"reward": {"progress": 1e300}}, r"reward\.progress is 1e\+300; it must be a finite"),
    ({"sensing": 0.1}, "sensing is 0.1; it must be a Sensing, or a table"),
    ({"sensing": {"nois": 0.1}}, r"sensing has no field 'nois'.*'noise'"),
    ({"sensing": {5: 0.1}}, "sensing has no field 5; known are range, "),
    ({"costs": "contacts"}, "did you mean 'contact'"),
    ({"costs": 7}, "costs is 7; it must be names"),
    ({"costs": ("rise", "rise")}, "each name once"),
    ({"neighbour_slots": 10_001}, "neighbour_slots is 10001; .* from 1 to 10000"),
    ({"neighbour_slots": 0}, "neighbour_slots is 0; .* from 1 to 10000"),
    ({"neighbour_overflow": "drop"}, "neighbour_overflow is 'drop'; .*'error', 'nearest'"),
    ({"obstacle_slots": 1, "obstacles": [TRIANGLE, TRIANGLE]},
        r"obstacle_slots is 1; .* obstacles, 2"),
    ({"obstacle_slots": 10**9}, f"obstacle_slots is 1000000000; .* at most {MAX_OBSTACLES}"),
    ({"start_positions": ROW[:4]}, r"start_positions have shape \(4, 2\); .* \(5, 2\)"),
    ({"start_positions": [*ROW[:4], [math.inf, 0]]},
        r"start_positions of robot_4 is \[inf, 0\.0\]; it must be finite, and from -1e\+09"),
    ({"start_positions": [[1.0, 2.0]] * 5}, r"robot_0 and robot_1 are both at \[1\.0, 2\.0\]"),
    ({"start_positions": ROW, "obstacles": [Disc((2.0, 0.3), 0.4)]},
        r"start_positions: robot.2 at \[2\.0, 0\.0\].*inside Disc"),
    ({"start_positions": [[HUGE, 0]] * 5}, r"start_positions is \[\[.*; it must be numbers"),
    ({"start_positions": [[1, 2], [3]]}, r"start_positions is \[\[1, 2\], \[3\]\]; .*without gaps"),
    ({"start_headings": [[0.0]] * 5}, r"start_headings have shape \(5, 1\); .* \(5, 0\)"),
    ({"time_limit": 1e9, "time_step": 1e-9}, r"time_limit is 1e\+09 s: 1e\+18 steps of 1e-09 s"),
    ({"graph": "directed"}, r"graph: 'directed' needs "),
    ({"graph": "ring"}, r"graph is 'ring'; it must be one of 'complete', 'path', .*'cycle'\?"),
    ({"graph": []}, r"graph: weights have shape \(0,\); .* \(n, n\) = \(2, 2\)"),
    ({"graph": matrix(a01=1.0)}, r"graph: weight a\[0, 1\] = 1\.0 must equal its mirror image"),
    ({"graph": -UNEQUAL}, r"graph: weight a\[0, 1\] = -2\.0 must not be negative"),
    ({"graph": matrix(a12=np.nan)}, r"a\[1, 2\] = nan must be finite"),
    ({"graph": matrix(a33=1.0)}, r"a\[3, 3\] = 1\.0 must be 0: no robot is its own neighbour"),
    ({"graph": UNEQUAL[:4]}, r"graph: weights have shape \(4, 5\); .* \(4, 4\)"),
    ({"graph": UNEQUAL, "n_robots": 4},
        r"graph: its matrix or edge list is for 5 robots, not for 4"),
    ({"graph": g.from_edges([(0, 3), (1, 2)], 5)},
        r"not connected: components \[0, 3\] and \[1, 2\] and \[4\].*require_connected"),
    ({"graph": np.zeros((5, 5)), "require_connected": False}, r"time_step is None; .* no edge"),
    ({"graph": g.directed([(0, 1), (0, 2)]), "n_robots": 3},
        r"\[\d\] and \[\d\] observe no robot outside"),
    ({"graph": g.switching([g.from_edges([(0, 1)], 5)])}, "not connected"),
    ({"graph": g.switching(["path"], 0.01)}, r"dwell is 0\.01 s, shorter than the time"),
    ({"graph": g.switching([1 - np.eye(2)])}, "is for 2 robots, not for 5"),
    ({"graph": "proximity"}, "give sensing a range or a field_of_view"),
    ({"graph": "proximity", "sensing": rv.Sensing(range=0.6)}, r"range is 0\.6; .* = 0\.2 m"),
    ({"graph": g.directed([(1, 0)]), "n_robots": 2, "start_positions": ((0, 0), (0, 0))},
        "neighbours robot_0 and robot_1 are both at"),
    ({"graph": DEEP}, r"graph is \[\[\[\[\[\[\.\.\.\]\]\]\]\]\]"),
    ({"graph": {"kind": ["path"]}}, r"graph is \['path'\]; it must be one of 'complete'"),
    ({"graph": {"kind": "path", "weight_range": 5.0j}}, "graph: weight_range is 5j; .* finite num"),
    ({"graph": {"edges": 5}}, "graph: edges is 5; it must be a sequence"),
    ({"graph": {"edges": [5]}}, r"graph: an edge is 5; it must be \(i, j\) or"),
    ({"graph": {"edges": [[0, 1.5]]}}, r"graph: an edge is \[0, 1\.5\]; .* whole indices"),
    ({"graph": {"edges": [[0, math.nan]]}}, r"graph: an edge is \[0, nan\]; .* whole indices"),
    ({"graph": {"edges": [[0, 1]], "n_nodes": "x"}}, "graph: n_nodes is 'x'; .* integer"),
    ({"graph": {"edges": [[0, 1, 1e300]]}}, r"edge \(0, 1\) has weight 1e\+300; it must be pos"),
    ({"graph": 1e-300 * (1 - np.eye(5))}, r"a\[0, 1\] = 1e-300 must be 0, or from 1e-09 to 1e\+09"),
    ({"obstacles": 5}, "obstacles is 5; it must be a sequence of obstacles"),
    ({"obstacles": [5]}, r"obstacles\[0\] is 5; it must be a Disc.*rv\.Disc\(\(0"),
    ({"obstacles": [{"kind": ["disc"]}]}, r"obstacles: kind is \['disc'\]; .* one of 'disc'"),
    ({"obstacles": [{"center": [0, 0], "radius": 1}]}, "disc has no key 'center'; did .* 'centre'"),
    ({"obstacles": {"count": 3, "radii": 1}}, "field has no key 'radii'; did you mean 'radius'"),
    ({"obstacles": {"layout": "trap", "sise": 1}}, "walls has no key 'sise'.* 'size'"),
    ({"obstacles": [{"kind": "capsule", "radius": 1}]}, "a capsule needs ends"),
    ({"obstacles": [Sphere((0, 0, 0), 1)]}, r"obstacles\[0\].*in 2-D use Disc, Polygon or Capsule"),
    ({"obstacles": [Disc((0, 0), 1)], "dim": 3}, r"obstacles\[0\].*in 3-D use Sphere or Capsule"),
    ({"obstacles": [{"centre": DEEP, "radius": 1}]}, r"obstacles: Disc.centre .* must be 2 finite"),
    ({"n_robot": 3}, r"no field 'n_robot'; did you mean 'n_robots'"),
    ({"radius": 0.1}, r"no field 'radius'; did you mean 'body_radius'"),
    ({"merge": 0.1}, r"no field 'merge'; did you mean 'on_merge'"),
    ({"dt": 0.1}, "no field 'dt'; did you mean 'time_step'"),
    ({"speed_limit": 1}, "no field 'speed_limit'; did you mean 'max_speed'"),
    ({"turn_limit": 1}, "no field 'turn_limit'; did you mean 'max_turn_rate'"),
    ({"tau": 1}, "no field 'tau'; did you mean 'time_step'"),
    ({"N_ROBOTS": 3}, "no field 'N_ROBOTS'; did you mean 'n_robots'"),
    ({"action_size": 3}, "no field 'action_size'; it follows from other fields and cannot be set"),
    ({"dropout": 0.1}, "no field 'dropout'; it is a field of sensing; give it there"),
    ({"obstacles": [{"radius": 1, "center": [0, 0]}]}, "did you mean 'centre'"),
    ({"max_steps": 9}, "'max_steps'; did you mean 'time_limit'.* not in steps"),
]  # fmt: skip


@pytest.mark.parametrize(("fields", "message"), REFUSED)
def test_invalid_values_of_any_kind_are_explained(fields, message):
    said = refusal(Scenario, **fields)
    assert re.search(message, said), said


def test_unknown_field_names_closest_match():
    for call in (Scenario, Scenario().replace, lambda **f: Scenario.from_plain(f)):
        for kind in (TypeError, ValueError, UnknownFieldError):
            assert "scenario has no field 'n_robot'; did you mean 'n_robots'" in refusal(
                call, kind=kind, n_robot=3
            )
    assert "did you mean 'progress'" in refusal(rv.RewardWeights, progres=1, kind=TypeError)
    assert "did you mean 'dropout'" in refusal(rv.Sensing, drop_out=0.1)
    assert "Disc has no field 'center'; did you mean 'centre'" in refusal(
        Disc, center=(0, 0), radius=1, kind=TypeError
    )
    assert "did you mean 'max_speed'" in refusal(rv.scenarios.get("duo").replace, speed_limit=1)
    with pytest.raises(TypeError, match="positional"):
        rv.RewardWeights(1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize(
    ("call", "given", "message"),
    [
        (rv.certificate, {"min_aligment": 0.1}, "certificate has no argument .* 'min_alignment'"),
        (rv.rollout, {"num_env": 2}, "rollout has no argument 'num_env'; did you mean 'num_envs'"),
        (rv.graphs.cycle, {"weigth": 2.0}, "cycle has no argument 'weigth'; .* 'weight'"),
        (rv.Sensing.fit, {"posses": 1}, "fit has no argument 'posses'; did you mean 'poses'"),
        (rv.ObstacleField, {"radii": 1}, "ObstacleField has no field 'radii'; .* 'radius'"),
        (rv.Moving, {"velocities": 1}, "Moving has no field 'velocities'; .* 'velocity'"),
    ],
)
def test_unknown_argument_of_a_function_names_the_closest_one(call, given, message):
    said = refusal(call, kind=TypeError, **given)
    assert re.search(message, said), said


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Disc((0, 0), 0), r"Disc\.radius is 0; it must be a finite number from 1e-05"),
        (lambda: Disc((0, 0), 1e300), r"Disc\.radius is 1e\+300; .* to 1e\+09 m"),
        (lambda: Disc("12", 1), r"Disc\.centre is '12'; it must be 2 finite"),
        (lambda: Sphere((0, 0), 1), r"Sphere\.centre is .*; it must be 3 finite numbers"),
        (lambda: Capsule(((0, 0),), 1), r"Capsule\.ends is .*; it must be two points"),
        (lambda: Capsule(((0, 0), (1, 0, 0)), 1), r"ends\[1\] is .*; it must be 2 finite numbers"),
        (lambda: Polygon(None), "must be at least 3 points"),
        (lambda: Polygon([(0, 0)] * 2000), "at most 1000"),
        (lambda: Polygon((1, 2, 3)), r"Polygon\.vertices\[0\] is 1; it must be 2 finite"),
        (lambda: Polygon(((0, 0), (3, 0), (0, 3), (0, 0))), r"vertices\[3\] .* repeats another"),
        (lambda: Polygon(((0, 0), (1, 0), (2, 1e-7))), "degenerate"),
        (lambda: Polygon(((0, 0), (1, 1), (1, 0), (0, 1))), "cross; list them in order"),
        (lambda: Polygon(((3, 0), (-2, 2), (1, -3), (1, 3), (-2, -2))), "cross; "),  # a star
        (lambda: ObstacleField(-1, (1, 2), 9, 1), r"ObstacleField\.count is -1; it must be"),
        (lambda: ObstacleField((5, 2), (1, 2), 9, 1), "count is .* low <= high"),
        (lambda: ObstacleField(10**9, (1, 2), 1, 1), "count is 1000000000; .* <= 10000"),
        (lambda: ObstacleField(2, (0, 1), 9, 1), r"radius is \(0, 1\); .* 1e-05 <= low"),
        (lambda: ObstacleField(2, (1, 2), -9, 1), "region is -9; it must be .* from 0"),
        (lambda: ObstacleField(1, (1, 2), 1, 1e300), r"keep_out is 1e\+300; .* to 1e\+09"),
        (lambda: ObstacleField(2, (1, 2), 9, 1, "no"), "overlap is 'no'; .* True, False"),
        (lambda: ObstacleField(3, (1, 2), 9, 0.5, passage=1.1), "at most twice keep_out, 1 m"),
        (lambda: ObstacleField(3, (1, 2), 9, 0.5, passage=-1), "passage is -1; .* from 0"),
        (lambda: parse(ObstacleField(3, (1, 2), 9, 0.5, passage=0.1), 3), r"0\.1; .* be 0 in 3-D"),
        (lambda: replace(WALLS, layout="tarp"), "WallField.layout .* mean 'trap'"),
        (lambda: replace(WALLS, layout=3), "is 3; .* of 'trap', 'corridor', 'rooms'"),
        (lambda: replace(WALLS, opening=(0, 3)), r"opening is \(0, 3\); .* 1e-05 <= low"),
        (lambda: replace(WALLS, thickness=0), r"WallField\.thickness is 0"),
        (lambda: replace(WALLS, keep_out=math.nan), "keep_out is nan; it must be"),
        (lambda: replace(WALLS, layout="rooms", size=(3, 5)), r"\(3.0, 5.0\); .* at least 4.5 m"),
        (lambda: parse(WALLS, 3), "obstacles is WallField.*an ObstacleField in 3-D"),
        (lambda: parse([WALLS], 2), "must be given alone, not in a list"),
        (lambda: parse({"layout": "trap", "size": [3, 5]}, 2), "a walls needs opening"),
        (lambda: g.path("a"), "weight_range is 'a'"),
        *[
            (lambda weight=weight: g.path(weight), r"weight_range is .* finite.* 1e-09 <= low <=")
            for weight in ((0.0, 1.0), (2.0, 1.0), (-1.0, 1.0), (0.5, np.inf), -1.0)
        ],
        *[
            (lambda p=p: g.erdos_renyi(p), rf"probability is {p!r}; it must be in \(0, 1\]")
            for p in (0.0, -0.1, 1.1, math.nan, "x")
        ],
        (lambda: g.from_edges([(0, 0)], 3), r"edge \(0, 0\) must join two different robots"),
        (lambda: g.from_edges([(0, 1), (1, 0)], 3), r"edge \(1, 0\) must join .* once"),
        (lambda: g.from_edges([(0, 5)], 3), r"edge \(0, 5\) must join two .* of 0\.\.2"),
        (lambda: g.from_edges([(0, 1, 0.0)], 3), r"edge \(0, 1\) has weight 0\.0; .*positive"),
        (lambda: g.from_edges([(0, HUGE)]), "n_nodes is an integer of about 401"),
        (lambda: g.Graph("edges"), "n_nodes is None"),
        (lambda: g.Graph("path", edges=((0, 1, 1.0),)), "a path has neither edges"),
        *[
            (
                lambda kind=kind: g.parse({"kind": kind, "probability": 0.3}),
                rf"graph: probability is 0\.3; only kind 'erdos_renyi' has one, not '{kind}'",
            )
            for kind in ("complete", "random_tree", "directed_cycle", "proximity")
        ],
        (lambda: g.directed([(0, 1), (0, 1)]), r"edge \(0, 1\) must join .* once"),
        (lambda: g.directed(np.eye(2)), r"a\[0, 0\] = 1\.0 must be 0"),
        (lambda: g.switching([]), r"graphs is \(\); it must be a list of at least one"),
        (lambda: g.switching("path"), "graphs is 'path'; it must be a list of graphs"),
        (lambda: g.switching(["path", "proximity"]), r"graphs\[1\] is 'proximity'; switch"),
        (lambda: g.switching([g.random_tree()]), r"graphs\[0\] is 'random_tree'"),
        (lambda: g.switching(["path"], 0.0), "dwell is 0.0; it must be a positive"),
        (lambda: g.switching(["path"], order="back"), "order is 'back'; .*'cyclic', 'random'"),
        (lambda: g.Graph("switching", 2.0, graphs=["path"]), "has only the weights of its list"),
        (lambda: g.parse({"kind": "switching", "weight_range": 1}), "no key 'weight_range'"),
        (lambda: g.switching([{"kind": "switching"}]), "is itself a switching graph"),
        (lambda: g.parse({"kind": "proximity", "dwell": 1.0}), "graph has no key 'dwell'"),
        (lambda: g.from_matrix([[0, 1], [2, 0]]), "graphs.directed takes others"),
    ],
)  # fmt: skip
def test_invalid_obstacles_and_graphs_are_explained(make, message):
    said = refusal(make)
    assert re.search(message, said), said


@pytest.mark.parametrize(
    ("name", "value", "make"),
    [
        ("passage", 1.0, lambda passage: ObstacleField(3, (1, 2), 9, 1 / 3, passage=passage)),
        ("error", 9.0, lambda error: rv.Sensing(error=error)),
        ("size", 0.1, lambda size: checks.number("size", size, least=2 / 3)),
        ("size", 9.0, lambda size: checks.number("size", size, most=math.pi / 2)),
    ],
)
def test_limit_in_message_is_accepted(name, value, make):
    said = refusal(lambda: make(value))
    limits = [float(number) for number in re.findall(r"[-+.e\d]*\d", said.split("must be")[1])]
    make(min(limits, key=lambda limit: abs(limit - value)))
    assert name in said


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
    reward=rv.RewardWeights(clearance_penalty=0.1),
    costs=("contact", "rise"),
)


DRAWN = [Scenario(obstacles=one) for one in (ObstacleField(2, (7.0, 8.0), 20.0, 0.5), WALLS)]


@pytest.mark.parametrize("expected", [EVERY_FIELD, *DRAWN], ids=["every field", "discs", "walls"])
def test_numpy_scalars_become_python(expected, tmp_path):
    given = in_numpy(expected.to_plain())
    made = Scenario(**given | {"require_connected": np.bool_(True)})
    assert made == expected and hash(made) == hash(expected)
    made.to_toml(tmp_path / "all.toml")
    assert Scenario.from_toml(tmp_path / "all.toml") == expected
    parts = (made, made.reward, made.sensing, made.obstacles if expected in DRAWN else made)
    kept = [value for part in parts for value in vars(part).values()]
    assert not any(isinstance(value, np.generic) for value in kept)
    assert made.require_connected is True
    assert type(Scenario(merge_radius=np.float32(0.5)).merge_radius) is float


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("n_robots = " + "9" * 400, "n_robots is an integer of about 40[01] digits"),
        ("n_robots = " + "9" * 5000, "mine.toml: not a TOML file"),
        ("graph = " + "[" * 5000 + "]" * 5000, "mine.toml: its tables and lists are nested too"),
        ("graph = " + "[" * 60 + "]" * 60, "graph"),
        ("reward = 5", "reward is 5; it must be a .* table"),
        ("time_limit = 1979-05-27", "time_limit is datetime.date"),
        ("time_step = 1e-300\nallow_long_step = true", "time_step is 1e-300"),
        ("name = '\\ud800'\nx", "not a TOML file"),
    ],
)
def test_toml_of_wrong_type_is_rejected(text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    said = refusal(Scenario.from_toml, path)
    assert re.search(message, said) and str(path) in said
    path.write_bytes(b"name = '\xff\xfe'")
    assert "mine.toml: not a TOML file" in refusal(Scenario.from_toml, path)
    assert "plain data is 5; it must be a mapping" in refusal(Scenario.from_plain, 5)
    assert "scenario has no field 5; known are name" in refusal(Scenario.from_plain, {5: 5})


def test_impossible_names_and_paths_are_rejected(tmp_path):
    long, nul = str(tmp_path / ("x" * 300 + ".toml")), str(tmp_path / "a\0b.toml")
    for call in (Scenario.from_toml, Scenario().to_toml, rv.parallel_env, scenarios.resolve):
        assert "it is too long for a path" in refusal(call, long)
        assert "it is not a valid path" in refusal(call, nul)
    assert list(tmp_path.iterdir()) == []
    for name in ("x" * 300, "a\0b", "", "fig33"):
        assert re.search(r"scenario '.*' is unknown; .*known are", refusal(scenarios.get, name))
    for name in (5, None, ["fig3"], b"fig3", {}):
        assert "is unknown; known are fig3" in refusal(scenarios.get, name)
    for name in (5, None, ["fig3"], b"fig3"):  # {} is plain data
        assert "it must be a Scenario, its plain data, the name of one, or the path" in refusal(
            rv.make_vec, name
        )
    for path in (5, None, ["a.toml"]):
        assert "path is" in refusal(Scenario.from_toml, path)
    with pytest.raises(FileNotFoundError):
        Scenario().to_toml(tmp_path / "absent" / "x.toml")


def test_failed_write_keeps_old_file(tmp_path):
    """Causes: a full disk; a folder of the same name."""
    (tmp_path / "taken.toml").mkdir()
    Scenario(n_robots=2).to_toml(tmp_path / "x.toml")
    free = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, free[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            Scenario().to_toml(tmp_path / "x.toml")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, free)
    with pytest.raises(OSError, match="taken"):
        Scenario().to_toml(tmp_path / "taken.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken.toml", "x.toml"]
    assert Scenario.from_toml(tmp_path / "x.toml").n_robots == 2


def test_simulators_and_certificates_accept_names_and_files(tmp_path):
    PAIR.to_toml(tmp_path / "pair.toml")
    for one in (PAIR, tmp_path / "pair.toml"):
        assert rv.Simulator(one).scenario == PAIR
        assert rv.certificate(one) == rv.certificate(PAIR)
    assert rv.Simulator("duo").scenario == scenarios.get("duo")
    for call in (rv.Simulator, rv.certificate):
        assert "did you mean 'ring-12'" in refusal(call, "ring12")
        assert "it must be a Scenario, its plain data, the name of one, or the path" in refusal(
            call, 5
        )


def test_named_limit_is_accepted():
    """A limit rounded up to six digits was itself rejected."""

    def named(message: str) -> float:
        found = re.search(r"(?:certified step|half the merge_radius,|r/τ =) ([\d.]+)", message)
        return float(found[1])

    with pytest.warns(rv.TimeStepWarning) as caught:
        Scenario(n_robots=4, time_step=0.034)
    certified = Scenario(n_robots=4, time_step=named(str(caught[0].message)))
    assert rv.certificate(certified).guaranteed
    body = named(refusal(Scenario, merge_radius=1 / 3, body_radius=0.2))
    assert Scenario(merge_radius=1 / 3, body_radius=body).body_radius == 1 / 6
    step = PAIR.replace(time_step=0.03)
    gain = named(refusal(rv.certificate, step, by="gains", min_gain=99.0))
    assert rv.certificate(step, by="gains", min_gain=gain, max_gain=gain).hull_bound < math.inf
