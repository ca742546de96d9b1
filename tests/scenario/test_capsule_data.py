"""Capsules as data: what is accepted and refused, files, tables, options."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator, Sphere
from rendezvous_env.obstacles.obstacle_set import (
    balls,
    check_outside,
    outlines,
    pack,
    table_of,
    world_of,
)
from rendezvous_env.obstacles.parsing import parse, row_width, to_plain

LOG = Capsule(((-1.0, 0.0), (1.0, 2.0)), 0.5)
TRUNK = Capsule(((-1.0, 0.0, 1.0), (1.0, 2.0, 3.0)), 0.5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Capsule(((0, 0), (1, 0)), 0), "radius 0 of a Capsule must be"),
        (lambda: Capsule(((0, 0), (1, 0)), math.inf), "radius inf of a Capsule must be"),
        (lambda: Capsule(((0, 0),), 1), "ends .* of a Capsule"),
        (lambda: Capsule(((0, 0), (1, 0, 0)), 1), "ends"),
        (lambda: Capsule(((0, 0), (1, math.nan)), 1), "ends"),
        (lambda: Capsule(7, 1), "ends 7 of a Capsule"),
        (lambda: parse([LOG], 3), r"obstacles\[0\]: .* is 2-D; in 3-D use Sphere or Capsule"),
        (lambda: parse([TRUNK], 2), r"obstacles\[0\]: .* is 3-D; in 2-D use Disc, Polygon or"),
        (lambda: parse([{"kind": "capsule", "radius": 1}], 2), "a capsule needs ends"),
        (
            lambda: parse([{"ends": [[0, 0], [1, 0]], "radus": 1}], 2),
            "unknown key 'radus'",
        ),
    ],
)
def test_refusals_name_the_field(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("capsule", [LOG, TRUNK])
def test_plain_data_and_files_give_an_equal_one(capsule, tmp_path):
    scenario = Scenario(n_robots=2, dim=capsule.dim, obstacles=[capsule], spawn_size=20.0)
    assert scenario.obstacles == (capsule,)
    assert parse(to_plain((capsule,)), capsule.dim) == (capsule,)
    plain = to_plain((capsule,))[0]
    del plain["kind"]  # the keys tell it
    assert parse(plain, capsule.dim) == (capsule,)
    scenario.to_toml(tmp_path / "log.toml")
    assert Scenario.from_toml(tmp_path / "log.toml") == scenario
    assert hash(Scenario.from_toml(tmp_path / "log.toml")) == hash(scenario)


def test_tables():
    table = pack((LOG, Disc((3.0, 0.0), 1.0)), 3)
    assert row_width((LOG,)) == table.shape[1] == 10
    bound = math.sqrt(2.0) + 0.5
    assert table[0].tolist() == pytest.approx([3, 0, bound, 0, 1, 0, 1, 1, 0, 0.5])
    assert table[:, 0].tolist() == [3, 1, 0]
    np.testing.assert_array_equal(table_of(world_of(table)), table)
    check_outside("positions", np.array([[0.0, 2.0]]), (LOG,))
    with pytest.raises(ValueError, match=r"robot_0 at \[0.5, 1.5\] is 0.5 m inside"):
        check_outside("positions", np.array([[0.5, 1.5]]), (LOG,))


def test_outlines_are_those_of_the_capsule():
    (outline,) = outlines(pack((LOG,), 1))
    away = [distance(corner, LOG) for corner in outline.vertices]
    np.testing.assert_allclose(away, 0.5)
    edges = np.roll(outline.vertices, -1, axis=0) - outline.vertices
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    assert (turns > -1e-12).all()  # convex, counter-clockwise
    beads = list(balls(pack((TRUNK,), 1)))
    np.testing.assert_allclose([distance(bead.centre, TRUNK) for bead in beads], 0, atol=1e-12)
    np.testing.assert_allclose(beads[0].centre, TRUNK.ends[0])
    np.testing.assert_allclose(beads[-1].centre, TRUNK.ends[1])
    assert np.linalg.norm(beads[1].centre - beads[0].centre) <= 0.5


def distance(point, capsule: Capsule) -> float:
    first, second = np.array(capsule.ends)
    along = second - first
    share = np.clip((point - first) @ along / (along @ along), 0, 1)
    return float(np.linalg.norm(point - first - share * along))


def test_given_at_a_reset():
    scenario = Scenario(n_robots=2, obstacles=[LOG], obstacle_slots=2, spawn_size=20.0)
    sim = Simulator(scenario)
    moved = Capsule(((5.0, 5.0), (6.0, 5.0)), 0.25)
    sim.reset(0, {"obstacles": [moved, Disc((0.0, 0.0), 1.0)]})
    np.testing.assert_array_equal(sim.obstacles[0], pack((moved, Disc((0.0, 0.0), 1.0)), 2, 10))
    with pytest.raises(ValueError, match="inside"):
        sim.reset(0, {"obstacles": [moved], "positions": [[5.5, 5.1], [0.0, 0.0]]})
    square = Polygon(((0, 0), (1, 0), (1, 1), (0, 1)))
    flat = Simulator(Scenario(n_robots=2, obstacles=[Disc((0.0, 0.0), 1.0)], spawn_size=20.0))
    with pytest.raises(ValueError, match="a capsule where the scenario has none"):
        flat.reset(0, {"obstacles": [moved]})
    tight = Simulator(Scenario(n_robots=2, obstacles=[square], spawn_size=20.0))
    tight.reset(0, {"obstacles": [square]})
    round_ones = Simulator(Scenario(n_robots=2, dim=3, obstacles=[Sphere((0.0,) * 3, 1.0)]))
    with pytest.raises(ValueError, match="capsule"):
        round_ones.reset(0, {"obstacles": [TRUNK]})
