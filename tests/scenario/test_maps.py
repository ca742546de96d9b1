"""Obstacles from maps: formats, conservative outlines, seams, and regions of starts."""

import json
import math
import sys

import numpy as np
import pytest
import shapely
from conftest import ROOT, run_python, started
from PIL import Image

import rendezvous_env as rv
from rendezvous_env import Scenario
from rendezvous_env.obstacles import from_map
from rendezvous_env.obstacles.maps.convex import convex_pieces, simplified
from rendezvous_env.obstacles.maps.obstacle_map import GROWTH
from rendezvous_env.obstacles.obstacle_set import pack, world_of
from train import cli

SETTINGS = {"resolution": 0.5, "origin": "[-1.0, 2.0, 0.0]", "negate": 0}
MAPS = ROOT / "examples" / "maps"


def ros_map(folder, pixels, image="map.pgm", **changes):
    """A ROS map of an array of pixels, the top row first."""
    if image:
        Image.fromarray(np.asarray(pixels, np.uint8)).save(folder / image)
    settings = {"image": image or "none.pgm", **SETTINGS, **changes}
    lines = [f"{key}: {value}" for key, value in settings.items() if value is not None]
    (folder / "map.yaml").write_text("\n".join(lines))
    return folder / "map.yaml"


def union(shapes):
    return shapely.union_all([shapely.Polygon(one.vertices) for one in shapes])


def cells_at(found, centres):
    """Whether points are obstacles."""
    return shapely.contains_xy(union(found), *np.array(centres, float).T).tolist()


class TestRosMap:
    PIXELS = ((0, 255, 205), (255, 255, 0))
    CENTRES = ((-0.75, 2.75), (-0.25, 2.75), (0.25, 2.75), (-0.75, 2.25), (0.25, 2.25))

    @pytest.mark.parametrize(
        ("options", "changes", "wanted"),
        [
            ({}, {}, [1, 0, 1, 0, 1]),  # the pixel of 205 is unknown: p = 0.1961
            ({"unknown": "free"}, {}, [1, 0, 0, 0, 1]),
            ({"unknown": "free"}, {"negate": 1}, [0, 1, 1, 1, 0]),
            ({"unknown": "free"}, {"occupied_thresh": 0.19, "free_thresh": 0.1}, [1, 0, 1, 0, 1]),
            ({}, {"free_thresh": 0.25}, [1, 0, 0, 0, 1]),
        ],
    )
    def test_trinary_mode_applies_thresholds(self, tmp_path, options, changes, wanted):
        found = from_map(ros_map(tmp_path, self.PIXELS, **changes), **options)
        assert cells_at(found, self.CENTRES) == list(map(bool, wanted))
        assert found.bounds == (-1.0, 2.0, 0.5, 3.0)

    def test_scale_mode_interpolates_and_transparent_pixels_are_unknown(self, tmp_path):
        # p = 0.4: 100 (0.4 − 0.2)/(0.6 − 0.2) = 50 percent; p = 0.392: 48 percent
        row = [(153, 255), (155, 255), (0, 255), (255, 128)]
        pixels = [[(value, value, value, alpha) for value, alpha in row]]
        changes = {"mode": "scale", "occupied_thresh": 0.6, "free_thresh": 0.2}
        path = ros_map(tmp_path, pixels, "map.png", **changes)
        centres = [(-0.75 + 0.5 * k, 2.25) for k in range(4)]
        free = {"unknown": "free"}
        assert cells_at(from_map(path, **free), centres) == [True, False, True, False]
        assert cells_at(from_map(path), centres) == [True, False, True, True]
        softer = from_map(path, **free, min_occupancy=48)
        assert cells_at(softer, centres) == [True, True, True, False]
        path = ros_map(tmp_path, pixels, "map.png", **{**changes, "mode": "trinary"})
        assert cells_at(from_map(path, **free), centres) == [False, False, True, False]

    def test_raw_mode_takes_values_as_percent(self, tmp_path):
        path = ros_map(tmp_path, [[0, 49, 50, 100, 101]], mode="raw")
        centres = [(-0.75 + 0.5 * k, 2.25) for k in range(5)]
        found = cells_at(from_map(path, unknown="free"), centres)
        assert found == [False, False, True, True, False]
        assert cells_at(from_map(path), centres)[4]

    def test_yaw_turns_map_about_its_corner(self, tmp_path):
        origin = f"[1.0, 2.0, {math.pi / 2}]"
        found = from_map(ros_map(tmp_path, [[255, 255, 0]], origin=origin))
        assert cells_at(found, [(0.75, 3.25), (0.75, 2.25), (2.25, 2.25)]) == [True, False, False]
        np.testing.assert_allclose(found.bounds, (0.5, 2.0, 1.0, 3.5), atol=1e-12)

    def test_border_is_closed(self, tmp_path):
        found = from_map(ros_map(tmp_path, [[255, 255], [255, 255]]))
        assert len(found) == 4
        free = shapely.box(-9, -9, 9, 9).difference(union(found))
        inside, outside = sorted(shapely.get_parts(free), key=lambda part: part.area)
        assert inside.area == pytest.approx(1.0, rel=1e-3) and outside.area > 300

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"resolution": -0.05}, "map.yaml: resolution is -0.05; it must be a positive"),
            ({"resolution": None}, "map.yaml: resolution is missing"),
            ({"origin": "[0, 0]"}, r"map.yaml: origin is \[0, 0\]; it must be three numbers"),
            ({"origin": "[0, 0, .nan]"}, r"map.yaml: origin\[2\] is nan; it must be a finite"),
            ({"negate": 2}, "map.yaml: negate is 2; it must be 0 or 1"),
            ({"mode": "grey"}, "map.yaml: mode is 'grey'; it must be one of 'trinary'"),
            ({"occupied_thresh": 1.5}, "occupied_thresh is 1.5; it must be a finite number from 0"),
            ({"free_thresh": 0.7}, "free_thresh is 0.7; it must be at most occupied_thresh, 0.65"),
            ({"image": "no.png"}, "map.yaml: image is '.*no.png'; it does not exist"),
            ({"image": "map.yaml"}, "map.yaml: not an image"),
            ({"image": 5}, "map.yaml: image is 5; it must be the path of an image"),
            ({"mode": "["}, "map.yaml: not a YAML file"),
        ],
    )
    def test_invalid_file_error_names_field(self, tmp_path, changes, words):
        path = ros_map(tmp_path, self.PIXELS)
        lines = [f"{k}: {v}" for k, v in {"image": "map.pgm", **SETTINGS, **changes}.items() if v]
        path.write_text("\n".join(lines))
        with pytest.raises(ValueError, match=words):
            from_map(path)


class TestMovingAi:
    TEXT = "type octile\nheight 2\nwidth 4\nmap\n@T.S\nW.GO\n"
    CENTRES = tuple((x - 1.5, 0.5 - y) for y in range(2) for x in range(4))

    def read(self, folder, text, **options):
        (folder / "arena.map").write_text(text)
        return from_map(folder / "arena.map", **options)

    def test_terrain_becomes_obstacles(self, tmp_path):
        found = self.read(tmp_path, self.TEXT)
        assert cells_at(found, self.CENTRES) == [1, 1, 0, 0, 1, 0, 0, 1]
        found = self.read(tmp_path, self.TEXT, cell_size=0.5, passable=".GW")
        assert cells_at(found, np.array(self.CENTRES) / 2) == [1, 1, 0, 1, 0, 0, 0, 1]
        assert found.bounds == (-1.0, -0.5, 1.0, 0.5)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("octile", "hexes", "line 1: is 'type hexes'; it must be 'type octile'|octile"),
            ("height 2", "height two", "arena.map, line 2: is 'height two'; it must be 'height N'"),
            ("height 2", "height 3", "arena.map: has 2 rows of cells; height says 3"),
            ("W.GO", "W.G", "arena.map, line 6: has 3 cells; width says 4"),
            ("W.GO", "W.GX", "arena.map, line 6: 'X' is no terrain; known are '.GS@OTW'"),
            ("width 4", "width 99999999", "arena.map, line 3: is 'width 99999999'"),
            ("type", "", "arena.map, line 1: is 'octile'; it must be 'type octile'"),
        ],
    )
    def test_invalid_file_error_names_line(self, tmp_path, old, new, words):
        text = self.TEXT.replace(old, new)
        if new == "hexes":
            assert len(self.read(tmp_path, text)) == len(self.read(tmp_path, self.TEXT))
            return
        with pytest.raises(ValueError, match=words):
            self.read(tmp_path, text)

    def test_unknown_passable_terrain_is_rejected(self, tmp_path):
        with pytest.raises(ValueError, match="passable is 'x'; it must be characters of"):
            self.read(tmp_path, self.TEXT, passable=".x")


HOLED = "POLYGON ((0 0, 0 4, 4 4, 4 0, 0 0), (1 1, 1 2, 2 2, 2 1, 1 1))"
TWO = "MULTIPOLYGON (((0 0, 1 0, 1 1, 0 0)), ((3 3, 3 5, 5 5, 5 3, 3 3)))"


class TestPolygonFiles:
    @pytest.mark.parametrize("text", [HOLED, TWO], ids=["hole", "several"])
    @pytest.mark.parametrize("ending", ["wkt", "geojson"])
    @pytest.mark.parametrize("reverse", [False, True])
    def test_any_orientation_and_holes_are_read(self, tmp_path, text, ending, reverse):
        given = shapely.from_wkt(text)
        given = shapely.reverse(given) if reverse else given
        written = given.wkt if ending == "wkt" else shapely.to_geojson(given)
        (tmp_path / f"map.{ending}").write_text(written)
        found = from_map(tmp_path / f"map.{ending}")
        assert union(found).symmetric_difference(given).area < 1e-2
        assert union(found).covers(given)
        assert found.bounds == given.bounds

    def test_feature_collection_is_read(self, tmp_path):
        features = [
            {"type": "Feature", "properties": None, "geometry": shapely.geometry.mapping(one)}
            for one in shapely.from_wkt(TWO).geoms
        ]
        text = json.dumps({"type": "FeatureCollection", "features": features})
        (tmp_path / "map.json").write_text(text)
        assert len(from_map(tmp_path / "map.json")) == 2

    @pytest.mark.parametrize(
        ("ending", "text", "words"),
        [
            ("wkt", "POLYGON ((0 0, 1", "map.wkt: not WKT"),
            ("wkt", "LINESTRING (0 0, 1 1)", "geometry is a LineString; it must be a Polygon"),
            ("wkt", "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))", "not valid: Self-intersection"),
            ("wkt", "POLYGON EMPTY", "map.wkt: has no polygon"),
            ("wkt", "POLYGON ((0 0, 1e300 1, 1 0, 0 0))", "a coordinate is not finite, or beyond"),
            ("json", "[", "map.json: not JSON"),
            ("json", "[]", "map.json: not GeoJSON; it must be an object with a type"),
            ("json", '{"type": "FeatureCollection"}', "features are None; they must be a list"),
            ("json", '{"type": "Polygon", "coordinates": 5}', "it must be a GeoJSON polygon"),
            (
                "json",
                '{"type": "FeatureCollection", "features": [{"type": "Feature"}]}',
                "map.json: feature 0 is None; it must be a geometry",
            ),
        ],
    )
    def test_invalid_file_error_names_place(self, tmp_path, ending, text, words):
        (tmp_path / f"map.{ending}").write_text(text)
        with pytest.raises(ValueError, match=words):
            from_map(tmp_path / f"map.{ending}")


def random_area(random, kind):
    if kind == "cells":
        rows, columns = random.integers(3, 14, 2)
        y, x = np.nonzero(random.random((rows, columns)) < random.uniform(0.2, 0.8))
        return shapely.union_all(shapely.box(x, y, x + 1, y + 1))
    discs = shapely.points(random.uniform(0, 6, (6, 2)))
    return shapely.union_all(shapely.buffer(discs, random.uniform(0.3, 2, 6), quad_segs=3))


class TestOutlines:
    @pytest.mark.parametrize("kind", ["cells", "discs"])
    def test_simplified_outline_never_frees_and_stays_within_tolerance(self, kind):
        random = np.random.default_rng(3)
        fewer = 0
        for _ in range(60):
            area = random_area(random, kind)
            tolerance = random.uniform(0.01, 1.5)
            simple = simplified(area, tolerance)
            assert simple.is_valid
            # up to rounding, which the growth of shapes exceeds
            assert simple.buffer(1e-12).covers(area)
            assert simple.difference(area.buffer(tolerance * 1.001, quad_segs=32)).area < 1e-9
            fewer += shapely.get_num_coordinates(simple) < shapely.get_num_coordinates(area)
        assert fewer > 30

    @pytest.mark.parametrize("kind", ["cells", "discs"])
    def test_pieces_are_convex_and_fill_area(self, kind):
        random = np.random.default_rng(4)
        for _ in range(30):
            area = random_area(random, kind)
            pieces = [shapely.Polygon(piece) for piece in convex_pieces(area)]
            assert sum(one.area for one in pieces) == pytest.approx(area.area, rel=1e-9)
            assert shapely.union_all(pieces).symmetric_difference(area).area < 1e-9
            for one in pieces:
                assert one.convex_hull.area == pytest.approx(one.area, rel=1e-9)

    @pytest.mark.kernels
    def test_shapes_of_random_grids_have_no_seams(self, tmp_path):
        random = np.random.default_rng(5)
        for k in range(12):
            pixels = np.where(random.random((9, 9)) < 0.5, 0, 255)
            origin = f"[{random.uniform(-5, 5)}, 1.0, {random.uniform(-3, 3) * (k % 2)}]"
            found = from_map(ros_map(tmp_path, pixels, origin=origin))
            world = world_of(pack(found, len(found)), dim=2)
            assert not world.skins.any()
            merged = union(found)
            # every shape overlaps its neighbours by more than contact depth
            parts = shapely.get_parts(shapely.buffer(merged, -0.4 * GROWTH))
            assert len(parts) == len(shapely.get_parts(merged))

    def test_too_many_shapes_error_names_count_and_remedy(self, tmp_path):
        pixels = np.where(np.indices((20, 20)).sum(axis=0) % 2, 0, 255)
        path = ros_map(tmp_path, pixels)
        with pytest.raises(ValueError, match=r"has 204 shapes, more than max_shapes = 100; make"):
            from_map(path, max_shapes=100)
        assert len(from_map(path, tolerance=1.0, max_shapes=100)) < 100

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"tolerance": -1}, "tolerance is -1; it must be a finite number from 0"),
            ({"max_shapes": 0}, "max_shapes is 0; it must be an integer, 1 or more"),
            ({"unknown": "wall"}, "unknown is 'wall'; it must be one of 'occupied', 'free'"),
            ({"cell_size": 0}, "cell_size is 0; it must be a positive"),
            ({"min_occupancy": 0}, "min_occupancy is 0; it must be a finite number from"),
        ],
    )
    def test_invalid_option_is_rejected(self, options, words):
        with pytest.raises(ValueError, match=words):
            from_map(MAPS / "rooms.yaml", **options)

    def test_unknown_format_is_rejected(self):
        with pytest.raises(ValueError, match="give the YAML file of the image"):
            from_map(MAPS / "rooms.png")
        with pytest.raises(ValueError, match=r"known endings are \.yaml"):
            from_map("map.dwg")
        with pytest.raises(ValueError, match="path is 5; it must be the path of a map"):
            from_map(5)
        with pytest.raises(FileNotFoundError):
            from_map("no.yaml")


TOLERANCES = {"rooms": 0.0, "office": 0.0, "cave": 0.1}


class TestCommittedMaps:
    @pytest.mark.parametrize("name", TOLERANCES)
    def test_map_becomes_few_shapes(self, name):
        found = from_map(MAPS / f"{name}.yaml", tolerance=TOLERANCES[name])
        occupied = ~np.asarray(Image.open(MAPS / f"{name}.png"))[::-1]
        assert occupied.shape == (512, 512) and len(found) <= 2000
        merged = union(found)
        shapely.prepare(merged)
        y, x = np.indices(occupied.shape)
        centres = -12.8 + 0.05 * (x + 0.5), -12.8 + 0.05 * (y + 0.5)
        inside = shapely.contains_xy(merged, *centres)
        assert inside[occupied].all()
        assert not (inside & ~occupied).any() or TOLERANCES[name] > 0.0
        assert (inside & ~occupied).mean() < 0.1

    def test_generator_draws_committed_maps(self, tmp_path):
        run_python(ROOT, MAPS / "generate.py", str(tmp_path))
        for name in TOLERANCES:
            for ending in ("png", "yaml"):
                drawn, kept = tmp_path / f"{name}.{ending}", MAPS / f"{name}.{ending}"
                if ending == "png":
                    assert np.array_equal(Image.open(drawn), Image.open(kept))
                else:
                    assert drawn.read_text() == kept.read_text()


class TestStartRegion:
    def test_region_is_connected_and_keeps_clearance(self):
        found = from_map(MAPS / "cave.yaml", tolerance=0.1)
        region = union(found.free_region(0.4))
        assert len(shapely.get_parts(region.buffer(1e-6))) == 1
        assert region.distance(union(found)) >= 0.4
        smaller = union(found.free_region(0.4, near=region.representative_point().coords[0]))
        assert smaller.equals(region)

    def test_region_without_room_is_rejected(self, tmp_path):
        found = from_map(ros_map(tmp_path, np.full((8, 8), 255)))
        assert union(found.free_region(1.0)).area == pytest.approx(4.0, rel=1e-3)
        with pytest.raises(ValueError, match="no point is clearance = 3 m away from obstacles"):
            found.free_region(3.0)
        with pytest.raises(ValueError, match=r"near is .*; it must be a point at least 1 m from"):
            found.free_region(1.0, near=(-1.0, 2.0))
        with pytest.raises(ValueError, match="near is 'a'; it must be None or a point"):
            found.free_region(1.0, near="a")
        with pytest.raises(ValueError, match="clearance is 0; it must be a finite number from"):
            found.free_region(0)

    @pytest.mark.kernels
    def test_starts_are_uniform_in_region(self):
        square, triangle = ((0, 0), (2, 0), (2, 2), (0, 2)), ((-4, 0), (-2, 0), (-4, 2))
        scenario = Scenario(n_robots=2, merge_radius=1e-3, start_region=(square, triangle))
        places = started(scenario, 3000).positions.reshape(-1, 2)
        x, y = places.T
        right = x >= 0
        assert ((y >= 0) & (y <= 2) & (x <= 2)).all()
        assert (x[~right] + y[~right] <= -2).all() and (x >= -4).all()
        assert right.mean() == pytest.approx(2 / 3, abs=0.03)  # areas 4 and 2
        np.testing.assert_allclose(places[right].mean(axis=0), (1, 1), atol=0.05)
        np.testing.assert_allclose(places[~right].mean(axis=0), (-10 / 3, 2 / 3), atol=0.05)

    def test_batch_equals_singles(self):
        square = ((0, 0), (2, 0), (2, 2), (0, 2))
        scenario = Scenario(n_robots=4, start_region=[square])
        together = started(scenario, 7).positions
        for k in range(7):
            single = rv.Simulator(scenario)
            single.reset(seed=k)
            assert np.array_equal(single.positions[0], together[k])

    def test_region_round_trips_and_default_is_absent(self, tmp_path):
        scenario = Scenario(start_region=[[(0, 0), (0, 1), (1, 0)]])
        assert scenario.start_region[0].vertices == ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        scenario.to_toml(tmp_path / "s.toml")
        assert Scenario.from_toml(tmp_path / "s.toml") == scenario
        assert "start_region" not in Scenario().to_plain()
        assert Scenario(start_region=rv.Polygon(((0, 0), (1, 0), (0, 1)))) == scenario

    @pytest.mark.parametrize(
        ("fields", "words"),
        [
            ({"start_region": 5}, "start_region is 5; it must be 1 to 10000 convex polygons"),
            ({"start_region": []}, r"start_region is \[\]; it must be 1 to"),
            ({"start_region": [5]}, r"start_region\[0\] is 5; it must be a convex polygon"),
            (
                {"start_region": [[(0, 0), (1, 1)]]},
                r"start_region\[0\] is .*; it must be at least 3 points",
            ),
            (
                {"start_region": [[(0, 0), (9, 0), (0, 1)]]},
                "spawn_size is 10.0; it must be at least 18 m, to contain the start_region",
            ),
            (
                {"start_region": [[(0, 0), (1, 0), (0, 1)]], "dim": 3},
                "start_region: polygons are 2-D; it must be None where dim is 3",
            ),
        ],
    )
    def test_invalid_region_is_rejected(self, fields, words):
        with pytest.raises(ValueError, match=words):
            Scenario(**fields)

    def test_region_without_room_error_names_remedy(self):
        tiny = Scenario(n_robots=9, start_region=[[(0, 0), (0.5, 0), (0, 0.5)]])
        with pytest.raises(RuntimeError, match="in the start_region; enlarge it"):
            rv.Simulator(tiny).reset(seed=0)


class TestScenarioFile:
    def write(self, folder, **changes):
        table = {"kind": "'map'", "path": "'map.yaml'", "clearance": 0.3, **changes}
        lines = [f"{key} = {value}" for key, value in table.items() if value is not None]
        path = folder / "mine.toml"
        path.write_text("\n".join(["n_robots = 3", "merge_radius = 0.1", "[obstacles]", *lines]))
        return path

    def test_file_refers_to_map_beside_it(self, tmp_path):
        found = from_map(ros_map(tmp_path, np.full((9, 9), 255)))
        scenario = Scenario.from_toml(self.write(tmp_path))
        assert scenario.obstacles == found.shapes and scenario.name == "mine"
        assert scenario.start_region == found.free_region(0.3)
        assert scenario.spawn_size == found.spawn_size == 13.0
        assert Scenario.from_plain(scenario.to_plain()) == scenario
        without = Scenario.from_toml(self.write(tmp_path, clearance=None))
        assert without.start_region is None and without.spawn_size == 10.0

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"path": "'no.yaml'"}, "mine.toml: obstacles: path is 'no.yaml'; .* does not exist"),
            ({"path": None}, "mine.toml: obstacles: path is None; it must be the path of a map"),
            ({"tolerence": 1}, "obstacles: a map has no key 'tolerence'; did you mean 'tolerance'"),
            ({"clearance": -1}, "mine.toml: clearance is -1; it must be a finite number"),
            ({"tolerance": "'a'"}, "mine.toml: tolerance is 'a'; it must be a finite number"),
        ],
    )
    def test_invalid_reference_is_rejected(self, tmp_path, changes, words):
        ros_map(tmp_path, np.full((9, 9), 255))
        with pytest.raises(ValueError, match=words):
            Scenario.from_toml(self.write(tmp_path, **changes))


def test_map_acts_as_sequence_of_obstacles(tmp_path):
    found = from_map(ros_map(tmp_path, [[0, 255], [255, 255]]))
    scenario = Scenario(obstacles=found, merge_radius=0.01)
    assert scenario.obstacles == tuple(found) == found.shapes
    assert found[0] == found.shapes[0] and found[:2] == found.shapes[:2]
    assert repr(found).startswith("<ObstacleMap of ")
    assert "rendezvous_env.obstacles.maps" in sys.modules


class TestMapScenario:
    """A scenario file that refers to a map, in the interfaces and commands."""

    FILE = MAPS / "office.toml"

    def region(self):
        return union(Scenario.from_toml(self.FILE).start_region)

    def check(self, positions):
        inside = shapely.contains_xy(self.region().buffer(1e-9), *positions.reshape(-1, 2).T)
        assert inside.all()

    @pytest.mark.slow
    def test_pettingzoo_and_vector_environments_start_in_region(self):
        env = rv.parallel_env(self.FILE)
        observations, _ = env.reset(seed=4)
        assert observations["robot_0"].shape == (5 + 2 * 16, 2)
        self.check(env.unwrapped.simulator.positions)
        venv = rv.make_vec(self.FILE, num_envs=3)
        together, _ = venv.reset(seed=4)
        assert np.array_equal(together[0], np.array(list(observations.values())))
        for _ in range(3):
            actions = {name: env.action_space(name).sample() for name in env.agents}
            observations, *_ = env.step(actions)
            batch = np.zeros(venv.action_space.shape, np.float32)
            batch[0] = list(actions.values())
            together, *_ = venv.step(batch)
            assert np.array_equal(together[0], np.array(list(observations.values())))

    @pytest.mark.slow
    def test_stable_baselines3_environment_starts_in_region(self):
        sb3 = pytest.importorskip("rendezvous_env.adapters.sb3")
        robots = sb3.RobotVecEnv(rv.vector.training_env(self.FILE, 2))
        assert robots.reset().shape[0] == 12
        actions = np.array([robots.action_space.sample() for _ in range(12)])
        assert np.isfinite(robots.step(actions)[0]).all()

    @pytest.mark.slow
    def test_render_command_shows_map(self, tmp_path, capsys):
        picture = tmp_path / "office.png"
        words = f"render --scenario {self.FILE} --policy bearing-only --out {picture}"
        assert cli.main([*words.split(), "--set", "time_limit=0.3"]) == 0
        assert "office-time-limit-0.3, bearing-only" in capsys.readouterr().out
        pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
        orange = np.abs(pixels - np.array([0xE6, 0x9F, 0x00])).max(axis=-1) < 20
        assert orange.mean() > 0.005
