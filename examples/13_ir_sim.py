"""Four differential drives with lidars in ir-sim, among random obstacles.

A robot uses its lidar and the rotation of its body only. A round object of robot size is a robot,
everything else an obstacle. Needs ir-sim: pip install ir-sim
"""

import argparse
import contextlib
import io
import math
import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # suppress messages about displays
    import irsim

import rendezvous_env as rv
from baselines import RobotPolicy
from rendezvous_env.robots.differential_drive import DifferentialDrive, Machine, keep_apart
from train.pixels.last_seen import make, unit

RADIUS, LEAD, BEAMS, SIGHT = 0.2, 0.1, 720, 12.0  # m: body, lidar ahead of the axle; of the lidar
ROOM = RADIUS + LEAD + 0.05  # m: minimum distance of the lidar from obstacles
SCENARIO = rv.Scenario(
    name="ir-sim",
    n_robots=4,
    merge_radius=0.7,  # m: 0.3 m from body to body
    max_speed=0.5,
    time_step=0.1,
    time_limit=90.0,
    obstacle_slots=64,
)
MACHINE = Machine(
    wheel_radius=0.05, base_length=0.3, lead=LEAD, wheel_speed=10.0, wheel_acceleration=40.0
)
WORLD = f"""
world: {{height: 12, width: 12, step_time: 0.1, sample_time: 0.1, offset: [-6, -6],
         collision_mode: 'stop'}}
robot:
  - number: 4
    distribution: {{name: 'random', range_low: [-5, -5, -3.14], range_high: [5, 5, 3.14]}}
    kinematics: {{name: 'diff'}}
    shape: {{name: 'circle', radius: {RADIUS}}}
    vel_min: [-0.6, -6]
    vel_max: [0.6, 6]
    sensors:
      - {{type: 'lidar2d', range_min: 0, range_max: {SIGHT}, angle_range: 6.283185307179586,
         number: {BEAMS}, offset: [{LEAD}, 0, 0]}}
obstacle:
  - number: 5
    distribution: {{name: 'random', range_low: [-4, -4, -3.14], range_high: [4, 4, 3.14]}}
    shape: {{name: 'circle', radius: 0.5}}
  - number: 3
    distribution: {{name: 'random', range_low: [-4, -4, -3.14], range_high: [4, 4, 3.14]}}
    shape: {{name: 'rectangle', length: 1.6, width: 0.8}}
"""


def clusters(ranges):
    """Indices of consecutive beams on one object; a scan is periodic."""
    hit = ranges < SIGHT - 1e-6
    jump = np.abs(ranges - np.roll(ranges, 1)) > 0.2 + 0.02 * ranges
    begins = np.flatnonzero(hit & (jump | ~np.roll(hit, 1)))
    if not len(begins):
        return [np.arange(len(ranges))] if hit.all() else []
    rolled = (np.arange(len(ranges)) + begins[0]) % len(ranges)
    parts = np.split(rolled, begins[1:] - begins[0])
    return [part[hit[part]] for part in parts]


def middle_of_robot(points):
    """Centre of the robot whose surface contains the points (k, 2); None for no robot."""
    if len(points) < 4:
        return None
    # |p|² = 2 c·p + (R² − |c|²)
    table = np.column_stack([2 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(table, (points**2).sum(axis=1), rcond=None)[0]
    radius = math.sqrt(max(rest + x * x + y * y, 0.0))
    off = np.abs(np.hypot(*(points - (x, y)).T) - radius).max()
    return (x, y) if abs(radius - RADIUS) < 0.05 and off < 0.01 else None


def look(scan):
    """Detections of one scan, all in rad, and a speed limit.

    Returns bearings of robots (k,), edges (m, 2) of obstacles with room for the body, beams (l,)
    towards nearby surfaces, and the maximum speed of the lidar along those, m/s.
    """
    ranges, angles = scan["ranges"], np.linspace(-math.pi, math.pi, BEAMS)
    bearings, edges, fronts = [], [], [np.zeros(0, int)]
    for part in clusters(np.asarray(ranges)):
        hits = ranges[part]
        middle = middle_of_robot(hits[:, np.newaxis] * unit(angles[part]))
        if middle is not None:
            bearings.append(math.atan2(middle[1], middle[0]))
        elif hits.min() - ROOM < SCENARIO.obstacle_range:
            around, room = np.unwrap(angles[part]), np.arcsin(np.minimum(ROOM / hits, 1.0))
            left, right = (around + room).max(), (around - room).min()
            half, ahead = min((left - right) / 2, 0.49 * math.pi), (left + right) / 2
            edges.append((ahead + half, ahead - half))
            fronts.append(part)
    rooms = (ranges - ROOM) / SCENARIO.time_step
    front = np.concatenate(fronts)
    front = front[rooms[front] < SCENARIO.max_speed]
    return np.array(bearings), np.array(edges).reshape(-1, 2), angles[front], rooms[front]


def close(robots):
    """First pair of robots within the merge radius, or None."""
    for one, other in combinations(robots, 2):
        if np.hypot(*(one.state[:2, 0] - other.state[:2, 0])) < SCENARIO.merge_radius:
            return one, other
    return None


def start_of(seed, folder):
    """World of a seed with all robots in free space initially."""
    path = Path(folder) / "world.yaml"
    path.write_text(WORLD, encoding="utf-8")
    for again in range(1000):
        env = irsim.make(str(path), headless=True, seed=1000 * seed + again, log_level="ERROR")
        bodies = [robot.geometry.buffer(0.3) for robot in env.robot_list]
        things = [thing.geometry for thing in env.obstacle_list]
        if not any(body.intersects(thing) for body in bodies for thing in things):
            return env
    raise RuntimeError(f"no start of seed {seed} has room for the robots")


def play(policy, seed, folder):
    """Run one episode; returns rendezvous, contact, and time in s."""
    env = start_of(seed, folder)
    robots = list(env.robot_list)
    minds = {r.id: RobotPolicy(SCENARIO, make(policy, SCENARIO)) for r in robots}
    drives = {robot.id: DifferentialDrive(MACHINE) for robot in robots}
    touched = False
    while env.time < SCENARIO.time_limit:
        while (pair := close(robots)) is not None:  # the second follows the first
            robots.remove(pair[1])
            env.delete_object(pair[1].id)
        if len(robots) == 1:
            break
        actions = []
        for robot in robots:
            yaw = float(robot.state[2, 0])
            bearings, edges, front, rooms = look(robot.get_lidar_scan())
            bearings = bearings[: SCENARIO.n_robots - 1]
            velocity = minds[robot.id].act(unit(bearings + yaw), unit(edges + yaw))
            # without a free direction, laws push against the surface
            velocity = keep_apart(velocity.tolist(), unit(front + yaw), rooms)
            actions.append(np.c_[drives[robot.id].command(velocity, yaw, SCENARIO.time_step)])
        env.step(actions)
        touched |= any(robot.collision for robot in robots)
    met, seconds = len(robots) == 1, env.time
    env.end(0)
    return met, touched, seconds


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--policy", default="tangent-merged-tuned")
parser.add_argument("--episodes", type=int, default=10)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()

found = []
with tempfile.TemporaryDirectory() as folder:
    for seed in range(given.seed, given.seed + given.episodes):
        met, touched, seconds = play(given.policy, seed, folder)
        found.append(met and not touched)
        print(f"{seed}: met {met}, touched {touched}, {seconds:.1f} s", flush=True)
print(f"{given.policy}: {sum(found)} of {len(found)} episodes met without a contact")
