"""Capsules in every picture: frames, path figures, the report page."""

from __future__ import annotations

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import balls, pack
from rendezvous_env.render.palette import OBSTACLE

LOG = rv.Capsule(((-2.0, -1.0), (2.0, 1.0)), 0.5)
BEAM = rv.Capsule(((-2.0, -1.0, 0.0), (2.0, 1.0, 1.0)), 0.5)
STARTS = {
    2: [[0.0, 3.0], [0.5, -3.0]],
    3: [[0.0, 3.0, 0.0], [0.5, -3.0, 0.0]],
}


def team(obstacle) -> rv.Scenario:
    return rv.Scenario(n_robots=2, dim=obstacle.dim, obstacles=(obstacle,), time_limit=20.0)


def orange(frame: np.ndarray) -> np.ndarray:
    """Pixels that nearly have the colour of obstacles."""
    return np.abs(frame.astype(int) - OBSTACLE[:3]).max(axis=-1) < 40


def test_a_frame_of_the_plane_has_its_area():
    env = rv.parallel_env(team(LOG), render_mode="rgb_array")
    env.reset(seed=0, options={"positions": STARTS[2]})
    found = orange(env.render())
    rows, columns = np.nonzero(found)
    # metres per pixel from the height of the shape, which is 3 m; its area is 4.472 · 1 + π/4
    scale = 3.0 / (np.ptp(rows) + 1)
    assert found.sum() * scale**2 == pytest.approx(2 * np.hypot(2, 1) + np.pi / 4, rel=0.05)
    assert (np.ptp(columns) + 1) * scale == pytest.approx(5.0, rel=0.05)


def test_a_frame_of_space_shows_it():
    env = rv.parallel_env(team(BEAM), render_mode="rgb_array")
    env.reset(seed=0, options={"positions": STARTS[3]})
    assert orange(env.render()).sum() > 500


def test_a_very_thin_one_is_drawn_with_few_balls():
    wire = rv.Capsule(((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)), 0.001)
    beads = list(balls(pack((wire,), 1)))
    assert len(beads) == 99 and beads[-1].centre.tolist() == [9.0, 0.0, 0.0]


@pytest.mark.parametrize("obstacle", [LOG, BEAM], ids=["plane", "space"])
def test_paths_are_drawn_and_the_page_has_its_shape(obstacle):
    from train.figures import path_figures, reproduce
    from train.report.build import _obstacles

    scenario = team(obstacle)
    start = {"positions": STARTS[obstacle.dim]}
    found = rv.rollout(scenario, baselines.make("tangent-joined", scenario), options=start)
    recording = reproduce.one_team(found)
    figure = path_figures.team_figure(scenario, recording, "tangent-joined")
    figure.canvas.draw()
    shapes = list(_obstacles(recording["obstacles"], scenario))
    if obstacle.dim == 2:
        (shape,) = shapes
        assert len(shape["vertices"]) == 34 and shape["centre"] == [0.0, 0.0]
        assert max(np.hypot(x, y) for x, y in shape["vertices"]) == pytest.approx(
            np.hypot(2, 1) + 0.5
        )
    else:
        assert len(shapes) > 10 and {shape["radius"] for shape in shapes} == {0.5}
