"""Robots with cameras: detections, rejected detections, and rendezvous."""

import re
from importlib import util
from itertools import groupby

import numpy as np
import pytest
from conftest import ROOT, run_python

if util.find_spec("mujoco") is None:
    pytest.skip("needs MuJoCo", allow_module_level=True)
try:
    from train.pixels import eyes as drawing  # chooses how MuJoCo draws before it is imported
    from train.pixels import pixels
    from train.pixels.detector import Detector, stretches

    drawing.mujoco.GLContext(64, 64).free()
except Exception as error:
    pytest.skip(f"no EGL to draw with (libegl1, libgl1-mesa-dri): {error}", allow_module_level=True)

import rendezvous_env as rv
from train import results

DETECTOR = Detector(np.array(drawing.LAMPS[:4]), drawing.HEIGHT, 2.0)


def sight(positions, discs=()):
    """Detections of each robot of a team at given positions, in the global frame."""
    far_away = rv.Disc(centre=(200.0, 0.0), radius=1.0)  # one kind of team, compiled once
    scenario = pixels.SCENARIO.replace(
        n_robots=len(positions), start_positions=positions, obstacles=(*discs, far_away)
    )
    simulator = rv.Simulator(scenario)
    simulator.reset(0)
    eyes = drawing.Eyes(simulator)
    eyes.place()
    found = [DETECTOR.find(mine) for mine in eyes.look()]
    eyes.close()
    return [
        (
            dict(zip(one.colours, turned(one.bearings + eyes.yaw(i)), strict=True)),
            turned(one.edges + eyes.yaw(i)),
        )
        for i, one in enumerate(found)
    ]


def turned(angles):
    """Equivalent angle in degrees, from −180 to 180."""
    return (np.degrees(angles) + 180.0) % 360.0 - 180.0


def test_detector_finds_lamps_in_all_directions():
    """Lamps near and far, across image seams, for any orientation of the cameras."""
    places = ((0.0, 0.0), (2.0, 2.0), (-0.7, 0.0), (1.0, -6.0))
    (seen, edges), *_ = sight(places)
    expected = {1: 45.0, 2: 180.0, 3: np.degrees(np.arctan2(-6.0, 1.0))}
    assert sorted(seen) == [1, 2, 3] and len(edges) == 0
    for lamp, angle in expected.items():
        assert abs(turned(np.radians(seen[lamp] - angle))) < 1.0, lamp


def test_detector_reports_near_disc_and_ignores_far_one():
    near = rv.Disc(centre=(2.0, 0.0), radius=1.0)
    far = rv.Disc(centre=(-4.0, 0.0), radius=1.0)
    (seen, edges), (other, theirs) = sight(((0.0, 0.0), (0.0, 5.0)), (near, far))
    assert edges == pytest.approx(np.array([[30.0, -30.0]]), abs=2.0)
    assert len(theirs) == 0 and list(seen) == [1] and list(other) == [0]
    # a disc in front of a farther one ends where it ends
    discs = (rv.Disc(centre=(1.2, 0.0), radius=0.5), rv.Disc(centre=(4.0, 1.5), radius=1.2))
    (_, edges), _ = sight(((0.0, 0.0), (0.0, -5.0)), discs)
    half = np.degrees(np.arcsin(0.5 / 1.2))
    assert edges == pytest.approx(np.array([[half, -half]]), abs=2.0)


@pytest.mark.parametrize(("reach", "found"), [(0.0, False), (0.3, True)])
def test_detector_rejects_truncated_lamp(reach, found):
    """The edge of a disc passes through the centre of a lamp, or beside it."""
    disc = rv.Disc(centre=(1.0, 0.5 + reach), radius=0.5)
    (seen, _), _ = sight(((0.0, 0.0), (2.0, 0.0)), (disc,))
    assert (1 in seen) == found


def test_stretches_wrap_around_ring():
    there = np.array([True, False, True, True, False, True])
    assert [list(run) for run in stretches(there)] == [[2, 3], [5, 0]]
    assert [list(run) for run in stretches(np.ones(3, bool))] == [[0, 1, 2]]
    assert stretches(np.zeros(3, bool)) == []


def test_last_seen_holds_bearing_then_searches():
    scenario = pixels.SCENARIO.replace(obstacles=(), obstacle_slots=None)
    seen = np.zeros((1, *(4, *scenario.observation_layout.shape)), np.float32)
    seen[0, 0, 0] = 0.0, 1.0
    policy = pixels.make("bearing-only", scenario)
    first = policy(seen, 0.0)[0]
    nobody = np.zeros_like(seen)
    assert policy(nobody, 0.05)[0, 0] == pytest.approx(first[0])
    assert first[1] == pytest.approx([1.0, 0.0])  # never saw anybody: it seeks at once
    ways = [tuple(policy(nobody, 0.1)[0, 0].round(3).tolist()) for _ in range(1000)]
    lasted = [len(list(same)) * scenario.tau for _, same in groupby(ways)]
    assert ways[0] == (0.0, 1.0) and len(set(ways)) == len(lasted)
    assert lasted[:5] == pytest.approx([5.95, 3.0, 5.0, 7.0, 9.0], abs=0.051)
    policy.reset()
    assert policy(nobody, 0.0)[0, 0] == pytest.approx([1.0, 0.0])


def test_eyes_reject_more_robots_than_lamps():
    simulator = rv.Simulator(pixels.SCENARIO.replace(n_robots=7, time_step=0.02))
    simulator.reset(0)
    with pytest.raises(ValueError, match="n_robots is 7; lamps have 6 colours"):
        drawing.Eyes(simulator)


@pytest.mark.slow
def test_policies_meet_from_pixels(tmp_path):
    film = tmp_path / "film.gif"
    words = ["--policy", "tangent-merged-tuned", "--episodes", "4", "--film", str(film)]
    said = run_python(ROOT, "examples/12_pixels.py", *words).stdout
    assert said.startswith("4 of 4 episodes met without a contact\n")
    found = {name: float(value) for name, value in re.findall(r"^(\w+): (\S+)$", said, re.M)}
    assert found["median"] < 0.5 < found["worst"] and 0.05 < found["missed"] < 0.8
    assert found["missed_in_sight"] < 0.1 and found["found_though_hidden"] < 0.1
    assert film.read_bytes()[:6] == b"GIF89a"


@pytest.mark.slow
def test_reproduce_pixels_compares_with_camera_preset(tmp_path):
    words = ["pixels", "--policy", "tangent-merged-tuned", "--episodes", "2", "--seed", "3"]
    said = run_python(ROOT, "-m", "train.cli", "reproduce", *words, "--out", tmp_path).stdout
    assert "100.0% by Sensing.camera()" in said
    (row,) = results.read_csv(tmp_path / "pixels.csv")
    assert [row[name] for name in ("collision_free", "predicted", "exact")] == ["1.0"] * 3
    assert float(row["steps_per_core_second"]) > 10
