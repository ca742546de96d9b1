"""Values for fuzzing: valid, nearly valid, and invalid ones."""

import datetime
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from rendezvous_env.limits import LARGEST, SMALLEST

HUGE, UNWRITABLE = 10**400, 10**5000
DEEP: list = []
for _ in range(5000):
    DEEP = [DEEP]

ABSURD: list[Any] = [
    None, True, False, "", "abc", "1", "a\0b", "x" * 300, "\ud800", b"ab", 0, -1, 5, 0.5, -0.0,
    1e300, -1e308, 1e160, 1e-300, 5e-324, math.nan, math.inf, -math.inf, 10**10, 2**63, -(2**63),
    HUGE, UNWRITABLE, [], [1], [[1]], [1, "a"], [[1], [2, 3]], (), (1, 2), {}, {"a": 1}, {5: 5},
    set(), object(), 1j, np.array(5), np.array(5.0), np.array([1.0, 2.0]), np.array("a"),
    np.array([None]), np.array([np.nan, np.inf]), np.zeros(0), np.zeros((3, 3, 3)), np.float32(2),
    np.int8(3), np.bool_(True), np.array([True]), DEEP, {"a": DEEP}, len, range(3), b"",
    datetime.date(1979, 5, 27), np.datetime64("NaT"), np.longdouble("1e4000"), slice(None), ...,
]  # fmt: skip
EDGES = [0.0, 1.0, -1.0, SMALLEST, SMALLEST / 2, LARGEST, 2 * LARGEST, -LARGEST, 1e160, -1e300,
         5e-324, math.nan, math.inf, 3.5e38, 0.3]  # fmt: skip

absurd = st.integers(0, len(ABSURD) - 1).map(lambda k: ABSURD[k])  # repr of them all would fail
edges = st.sampled_from(EDGES) | st.floats()
lengths = st.sampled_from([SMALLEST, 1e-3, 0.2, 1.0, 1e3, LARGEST])


def refusal(call: Callable, *args: Any, kind: type[Exception] = ValueError, **kwargs: Any) -> str:
    """Message of a rejection."""
    with pytest.raises(kind) as caught:
        call(*args, **kwargs)
    assert len(str(caught.value)) < 1200
    return str(caught.value)


def mostly(right: st.SearchStrategy, *others: st.SearchStrategy) -> st.SearchStrategy:
    """The first in eleven of twelve cases; Hypothesis itself samples branches uniformly."""
    return st.integers(0, 11).flatmap(lambda k: right if k < 11 else st.one_of(*others))


def nearly(right: st.SearchStrategy, *wrong: Any) -> st.SearchStrategy:
    """Mostly valid values, otherwise a wrong one, a limit, or an absurd one."""
    near = [st.sampled_from(wrong)] if wrong else []
    return mostly(right, *near, edges, absurd)


def table(*shape: int) -> st.SearchStrategy:
    """Tables of the given shape with usual numbers, and one or two extreme entries."""

    def build(seed: int, size: float, spoilt: list[tuple[int, float]]) -> np.ndarray:
        values = size * np.random.default_rng(seed).uniform(-1, 1, shape)
        for place, value in spoilt:
            values.flat[place % values.size] = value
        return values

    spoilt = st.lists(st.tuples(st.integers(0, 100), edges), max_size=2)
    sizes = st.sampled_from([1.0, 1.0, 5.0, 5.0, 1e-9, LARGEST])
    return st.builds(build, st.integers(0, 99), sizes, mostly(st.just([]), spoilt))


def any_table(*shape: int) -> st.SearchStrategy:
    """``table`` as an array, as lists, of another type or another shape."""
    right = table(*shape)
    return mostly(
        right,
        right.map(np.ndarray.tolist),
        right.map(lambda a: a.astype(np.longdouble)),
        right.map(lambda a: a.astype(object)),
        right.map(lambda a: a.astype(str)),
        right.map(lambda a: a[None]),
        right.map(lambda a: a[..., :-1]),
        absurd,
    )


def in_numpy(value: Any, depth: int = 9) -> Any:
    """Numbers and flags of a value as NumPy scalars, where these are exact.

    Lists that are too deep or recursive are unchanged.
    """
    if isinstance(value, dict) and depth:
        return {key: in_numpy(entry, depth - 1) for key, entry in value.items()}
    if isinstance(value, list) and depth:
        return [in_numpy(entry, depth - 1) for entry in value]
    if type(value) is bool:
        return np.bool_(value)
    if type(value) is int and abs(value) < 2**63:
        return np.int64(value)
    return np.float64(value) if type(value) is float else value


MODELS = [("single_integrator", 2), ("single_integrator", 3), ("unicycle", 2),
          ("nonholonomic_3d", 3)]  # fmt: skip
coordinates = st.sampled_from([0.0, 1.5, -2.0, 4.0, LARGEST, -LARGEST, 1e7])
radii = st.sampled_from([1e-5, 0.5, 1.0, 1e4, LARGEST])
centres = {d: st.lists(coordinates, min_size=d, max_size=d) for d in (2, 3)}
boxes = st.builds(
    lambda x, y, w, h: {"vertices": [[x, y], [x + w, y], [x + w, y + h], [x, y + h]]},
    coordinates, coordinates, st.sampled_from([1e-3, 1.0, 1e8]), st.sampled_from([1e-3, 1.0, 1e8]),
)  # fmt: skip


def obstacles(dim: int) -> st.SearchStrategy:
    """Plain data of a few obstacles of dimension d, or of a random obstacle field."""
    ball = st.fixed_dictionaries(
        {"centre": nearly(centres[dim], [0.0]), "radius": nearly(radii, 1e-6)}
    )
    fair = st.fixed_dictionaries({"centre": centres[dim], "radius": radii})
    field = st.fixed_dictionaries(
        {
            "count": nearly(st.sampled_from([0, 2, [1, 3]]), -1, [3, 1]),
            "radius": nearly(st.sampled_from([[0.1, 0.2], [1e-5, LARGEST], 0.5]), [2, 1]),
            "region": nearly(st.sampled_from([0.0, 5.0, LARGEST])),
            "keep_out": nearly(st.sampled_from([0.0, 0.5, LARGEST])),
        },
        optional={"overlap": nearly(st.booleans())},
    )
    some = st.lists(fair | (boxes if dim == 2 else fair), max_size=3)
    return mostly(some | field, st.lists(ball), absurd)


weight_ranges = st.sampled_from([1.0, [0.5, 2.0], [SMALLEST, LARGEST], SMALLEST, LARGEST])


def graphs(n: int) -> st.SearchStrategy:
    """Plain data of graphs, and matrices."""
    kinds = ["complete", "path", "cycle", "star", "random_tree", "erdos_renyi"]
    named = st.fixed_dictionaries(
        {"kind": st.sampled_from(kinds), "weight_range": nearly(weight_ranges, [2, 1])},
        optional={"probability": nearly(st.just(0.5), 0, 2)},
    )
    links = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1), nearly(lengths))
    listed = st.fixed_dictionaries({"edges": st.lists(links.map(list), max_size=4)})
    ones = np.ones((n, n)) - np.eye(n)
    matrix = st.sampled_from([SMALLEST, 1.0, LARGEST, 1e-300]).map(lambda w: w * ones)
    fair = st.sampled_from(kinds)
    return mostly(fair | named | matrix, listed, any_table(n, n), absurd)


@st.composite
def scenario_fields(draw: st.DrawFn) -> dict[Any, Any]:
    """Fields of a small scenario: mostly valid ones, of any size."""
    model, dim = draw(st.sampled_from(MODELS))
    n = draw(st.integers(2, 4))
    fields: dict[Any, Any] = {"n_robots": n, "dim": dim, "robot_model": model}
    positions = any_table(n, dim)
    choices: dict[Any, st.SearchStrategy] = {
        "n_robots": nearly(st.integers(2, 4), 10**9, 10_001, 1),
        "dim": nearly(st.just(dim), 1, 4),
        "robot_model": nearly(st.just(model), "car", ["unicycle"]),
        "name": nearly(st.text(min_size=1, max_size=255).filter(str.isprintable), 5),
        "graph": graphs(n),
        "require_connected": nearly(st.booleans(), 1),
        "merge_radius": nearly(lengths),
        "body_radius": nearly(lengths | st.none()),
        "meeting": nearly(st.sampled_from(["merge", "pack"]), "park"),
        "time_step": nearly(lengths | st.none()),
        "allow_long_step": nearly(st.booleans(), "yes"),
        "time_limit": nearly(lengths),
        "max_speed": nearly(lengths | st.none()),
        "max_turn_rate": nearly(lengths | st.none()),
        "obstacles": obstacles(dim),
        "obstacle_range": nearly(lengths),
        "obstacle_slots": nearly(st.sampled_from([None, 3]), True, 10**9, -1),
        "obstacle_contact": nearly(st.sampled_from(["slide", "stop", "ignore"]), "bounce"),
        "merge_through_obstacles": nearly(st.booleans(), "no"),
        "neighbour_slots": nearly(st.sampled_from([None, n - 1]), True, 10**9, 0),
        "spawn_size": nearly(lengths),
        "start_positions": positions,
        "start_headings": any_table(n, dim - 1),
        "local_frames": nearly(st.sampled_from(["random", "global"]), "own"),
        "on_merge": nearly(st.sampled_from(["remove", "follow"]), "stay"),
        "activation": nearly(
            st.sampled_from(["random", {"kind": "bounded", "max_wait": 3}, {"kind": "periodic"}]),
            "never",
            {"kind": "periodic", "period": [1, 2]},
        ),
        "events": nearly(
            st.sampled_from([{"slip": 0.5}, {"n_crashed": 1}, {"sensor_failures": [[0, 1, 2]]}]),
            {"slip": 2},
            {"crashes": [[9, 1.0]]},
        ),
        "hold": nearly(st.sampled_from(["command", "stop"]), "wait"),
        "reward": st.dictionaries(
            st.sampled_from(["progress", "collision_penalty", "rendezvous_bonus", "bonus"]),
            nearly(st.floats(-5, 5)),
            max_size=2,
        ),
    }  # fmt: skip
    for name in draw(st.lists(st.sampled_from(sorted(choices)), max_size=5)):
        right = choices[name]
        fields[name] = draw(mostly(right, right.map(in_numpy)))
    return draw(mostly(st.just(fields), st.just(fields | {"merge_radios": 1.0})))


SCRAPS = [
    "nan", "inf", "-inf", "1e400", "9" * 400, "9" * 5000, "true", "'abc'", '"\\u0000"', "''", "[]",
    "1979-05-27", "{}", "{kind = 'disc'}", "[[]]", "[" * 200 + "]" * 200, "[" * 3000 + "]" * 3000,
    "5", "-1", "0", "1e-300", "0x10", "{a.b.c = 1}", "[1, 'a']", "[[0, 1], [1, 0]]", "'''", "[{}]",
    "{kind = 'field', count = 1e9}", "[{centre = [0, 0], radius = 1e300}]", "", "=", "\0",
]  # fmt: skip


@st.composite
def toml_texts(draw: st.DrawFn, keys: list[str]) -> bytes:
    """TOML of a few fields with random values; or any text, or any bytes."""
    lines = draw(
        st.lists(
            st.builds(
                lambda key, value: f"{key} = {value}",
                st.sampled_from([*keys, "n_robot", "reward.progress", "graph.kind", "'\\'", "[a]"]),
                st.sampled_from(SCRAPS),
            ),
            max_size=3,
        )
    )
    whole = "\n".join(lines).encode()
    text = st.text(max_size=40).map(lambda found: found.encode("utf-8", "surrogatepass"))
    return draw(st.sampled_from([whole] * 4) | text | st.binary())
