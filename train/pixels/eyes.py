"""Images of four cameras on every robot, rendered by MuJoCo.

The simulator moves the robots and MuJoCo renders their positions; this module returns images only.
A robot is a lamp of radius r/2 on a thin pole; obstacles are dark and higher than lamps.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.simulator import Simulator

os.environ.setdefault("MUJOCO_GL", "egl")  # draws without a screen
os.environ.setdefault("LP_NUM_THREADS", "1")  # pictures are too small to be shared out

import mujoco

SIZE, CAMERAS = 64, 4
"""Image width and height, pixels, and number of cameras, a quarter turn each."""
HEIGHT = 0.5
"""Height of the cameras and the lamp centres above the floor, m."""
LAMPS = ((230, 20, 20), (20, 200, 20), (30, 60, 240), (230, 200, 0), (210, 30, 210), (0, 200, 210))
"""Colours of the robots; their number limits the number of robots."""
_FILM = 320
"""Width and height of the overview image, pixels."""
_GONE = (0.0, 0.0, -50.0)
_COLUMNS = slice(2, 5)  # of the simulator's table of discs: radius and centre
_WORLD = f"""
<mujoco>
  <statistic extent="1" center="0 0 0"/>
  <visual>
    <global offwidth="{_FILM}" offheight="{_FILM}"/>
    <quality offsamples="0" shadowsize="0" numslices="24" numstacks="12"/>
    <map znear="0.01" zfar="200"/>
    <headlight ambient="0.7 0.7 0.7" diffuse="0.2 0.2 0.2" specular="0 0 0"/>
  </visual>
  <asset>
    {{lamps}}
    <material name="pole" rgba="0.85 0.85 0.85 1"/>
    <material name="disc" rgba="0.22 0.22 0.26 1"/>
    <material name="wall" rgba="1 1 1 1"/>
    <material name="floor" rgba="0.8 0.8 0.78 1"/>
  </asset>
  <worldbody>
    <geom type="box" size="{{half}} {{half}} 0.1" pos="0 0 -0.1" material="floor"/>
    <camera name="overhead" pos="0 0 {{above}}" fovy="53"/>
    {{bodies}}
  </worldbody>
</mujoco>"""


class Eyes:
    """Cameras of environment 0 of a simulator and an overview camera.

    The scenario has planar single integrators and discs.

    Raises:
        ValueError: if there are more robots than lamp colours.
    """

    def __init__(self, simulator: Simulator) -> None:
        scenario = simulator.scenario
        if scenario.n_robots > len(LAMPS):
            raise ValueError(f"n_robots is {scenario.n_robots}; lamps have {len(LAMPS)} colours")
        self._simulator = simulator
        self._model = mujoco.MjModel.from_xml_string(_world(scenario, simulator.obstacles.shape[1]))
        self._data = mujoco.MjData(self._model)
        self._near, self._above = (
            mujoco.Renderer(self._model, edge, edge, max_geom=100) for edge in (SIZE, _FILM)
        )
        for costly in ("SHADOW", "REFLECTION", "SKYBOX", "HAZE"):
            flag = getattr(mujoco.mjtRndFlag, f"mjRND_{costly}")
            self._near.scene.flags[flag] = self._above.scene.flags[flag] = 0

    def place(self) -> None:
        """Update the rendered poses from the simulator."""
        simulator, model, data = self._simulator, self._model, self._data
        for m, (radius, x, y) in enumerate(simulator.obstacles[0, :, _COLUMNS]):
            model.geom(f"disc{m}").size[0] = max(radius, 1e-3)
            model.geom(f"disc{m}").pos[:2] = (x, y) if radius > 0.0 else _GONE[:2]
        for i, (x, y) in enumerate(simulator.positions[0]):
            turn = 0.5 * self.yaw(i)
            data.mocap_pos[i] = (x, y, 0.0) if simulator.active[0, i] else _GONE
            data.mocap_quat[i] = (math.cos(turn), 0.0, 0.0, math.sin(turn))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._near.update_scene(data, "overhead")  # the light comes from there

    def yaw(self, robot: int) -> float:
        """Yaw of a robot's frame in the global frame, rad."""
        x, y = self._simulator.frames[0, robot][:, 0]  # its x axis
        return math.atan2(y, x)

    def look(self) -> NDArray[np.uint8]:
        """Images of all robots after ``place``, (n, cameras, rows, columns, 3).

        Camera k faces k π/2 in the robot's frame. Images of merged robots are black.
        """
        out = np.zeros((self._model.nmocap, CAMERAS, SIZE, SIZE, 3), np.uint8)
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        for i in np.flatnonzero(self._simulator.active[0]):
            for k in range(CAMERAS):
                camera.fixedcamid = self._model.camera(f"eye{i}_{k}").id
                mujoco.mjv_updateCamera(self._model, self._data, camera, self._near.scene)
                self._near.render(out=out[i, k])
        return out

    def from_above(self) -> NDArray[np.uint8]:
        """Overview image after ``place``, (size, size, 3)."""
        self._above.update_scene(self._data, "overhead")
        picture: NDArray[np.uint8] = self._above.render()
        return picture

    def close(self) -> None:
        """Release the renderers."""
        self._near.close()
        self._above.close()


def _world(scenario: Any, discs: int) -> str:
    """MuJoCo model: robots as mocap bodies, their cameras, obstacles and a floor."""
    half = max(scenario.spawn_edges)  # beyond the reach of robots
    lamps = "".join(
        f'<material name="lamp{i}" emission="1" rgba="{r / 255} {g / 255} {b / 255} 1"/>'
        for i, (r, g, b) in enumerate(LAMPS)
    )
    walls = "".join(
        f'<geom type="box" size="{half if y else 0.1} {half if x else 0.1} {half}"'
        f' pos="{x * half} {y * half} {half}" material="wall"/>'
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    )
    robots = "".join(_robot(i, 0.5 * scenario.merge_radius) for i in range(scenario.n_robots))
    obstacles = "".join(
        f'<geom name="disc{m}" type="cylinder" size="1 0.6" pos="0 0 0.6" material="disc"/>'
        for m in range(discs)
    )
    bodies = walls + robots + obstacles
    return _WORLD.format(half=half, above=1.3 * half, lamps=lamps, bodies=bodies)


def _robot(number: int, radius: float) -> str:
    """A lamp of the given radius, m, on a pole, with cameras numbered counter-clockwise."""
    pole = 0.5 * (HEIGHT - radius)
    cameras = "".join(
        f'<camera name="eye{number}_{k}" pos="0 0 {HEIGHT}" fovy="90" xyaxes="{s} {-c} 0 0 0 1"/>'
        for k, (c, s) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1)))
    )
    return (
        f'<body name="robot{number}" mocap="true">'
        f'<geom type="sphere" size="{radius}" pos="0 0 {HEIGHT}" material="lamp{number}"/>'
        f'<geom type="cylinder" size="0.02 {pole}" pos="0 0 {pole}" material="pole"/>'
        f"{cameras}</body>"
    )
