"""Robustness test of closed unions of obstacles: penetrations and unreported stops.

    python research/union_presses.py --presses 1000000

Each union is closed, but its shapes barely meet: they share edges, touch, or overlap by up to a
micrometre, with random orientation and position. Robots inside and outside move in random
directions at 10⁻³ to 10⁶ m/s. A surface within the union (its spine) determines the side of each
robot.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import Obstacle

Array = NDArray[np.float64]
ROBOTS, STEPS, TIME_STEP = 8, 25, 0.05
SLOTS = 64
MODELS = {
    2: ("single_integrator", "unicycle", "double_integrator"),
    3: ("single_integrator", "nonholonomic_3d", "double_integrator"),
}
TEAMS = {"single_integrator": 256, "unicycle": 128, "nonholonomic_3d": 64, "double_integrator": 24}
"""Number of environments for each robot model; curved paths are slower."""
SLOWEST, FASTEST = 1e-3, 1e6
_ON_THE_SPOT = 1e-12  # m


class Union(NamedTuple):
    """Closed union of obstacles, its centre, and the initial distance of the robots outside."""

    obstacles: list[Obstacle]
    is_inside: Callable[[Array], NDArray[np.bool_]]
    centre: Array
    size: float


class Count(NamedTuple):
    """Numbers of steps with contact, crossings of the spine, and stops without a contact."""

    presses: int = 0
    crossings: int = 0
    unreported: int = 0


def overlap(random: np.random.Generator) -> float:
    """Random overlap: 0, or 1 nm to 1 µm, m."""
    return float(random.choice([0.0, 10.0 ** random.uniform(-9.0, -6.0)]))


def _turned(points: Any, turn: float, shift: Array) -> Any:
    c, s = math.cos(turn), math.sin(turn)
    return np.asarray(points, float) @ np.array([[c, s], [-s, c]]) + shift


def _in_the_plane(
    random: np.random.Generator, polygons: list[Array], more: list[tuple[Any, float]], spine: Array
) -> Union:
    """Polygons, and points or segments with a radius, rotated and translated."""
    turn, shift = random.uniform(0.0, 2.0 * math.pi), random.uniform(-5.0, 5.0, 2)
    shapes: list[Obstacle] = [
        rv.Polygon(tuple(map(tuple, _turned(points, turn, shift)))) for points in polygons
    ]
    for points, radius in more:
        places = _turned(points, turn, shift)
        flat = tuple(map(tuple, np.atleast_2d(places)))
        shapes.append(rv.Disc(flat[0], radius) if len(flat) == 1 else rv.Capsule(flat, radius))
    loop = shapely.Polygon(_turned(spine, turn, shift))
    shapely.prepare(loop)
    size = float(np.linalg.norm(spine, axis=1).max())
    return Union(shapes, lambda places: shapely.contains_xy(loop, places), shift, size)


def _box(x0: float, x1: float, y0: float, y1: float) -> Array:
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def room(random: np.random.Generator) -> Union:
    """Room of four rectangles."""
    o, size = overlap(random), 10.0 ** random.uniform(-1.0, 1.0)
    boxes = [
        _box(-2, 2, -2, -1), _box(-2, 2, 1, 2), _box(-2, -1, -1 - o / size, 1 + o / size),
        _box(1, 2, -1 - o / size, 1 + o / size),
    ]  # fmt: skip
    return _in_the_plane(
        random, [size * box for box in boxes], [], size * _box(-1.5, 1.5, -1.5, 1.5)
    )


def tiles(random: np.random.Generator) -> Union:
    """Room with walls of tiles."""
    o, side, count = overlap(random), 10.0 ** random.uniform(-2.0, 0.0), int(random.integers(4, 14))
    places = range(count)
    boxes = [
        side * _box(i, i + 1 + o / side, j, j + 1 + o / side) - 0.5 * side * count
        for i in places
        for j in places
        if min(i, j) == 0 or max(i, j) == count - 1
    ]
    half = 0.5 * side * (count - 1)
    return _in_the_plane(random, boxes, [], _box(-half, half, -half, half))


def fan(random: np.random.Generator) -> Union:
    """Ring of triangles with common edges."""
    count = int(random.integers(6, 20))
    angles = np.sort(random.uniform(0.0, 1.0, count)) / 2.0 + np.arange(count)
    angles *= 2.0 * math.pi / count
    inner = np.c_[np.cos(angles), np.sin(angles)]
    outer = 1.6 * random.uniform(1.0, 1.5) / math.cos(math.pi / count) * np.c_[
        np.cos(angles + math.pi / count), np.sin(angles + math.pi / count)
    ]  # fmt: skip
    after = np.roll(inner, -1, axis=0), np.roll(outer, -1, axis=0)
    triangles = [np.array(t) for t in zip(inner, outer, after[0], strict=True)]
    triangles += [np.array(t) for t in zip(outer, after[1], after[0], strict=True)]
    spine = np.stack([0.5 * (inner + outer), 0.5 * (outer + after[0])], axis=1).reshape(-1, 2)
    return _in_the_plane(random, triangles, [], spine)


def _corners(random: np.random.Generator) -> Array:
    count = int(random.integers(3, 14))
    angles = 2.0 * math.pi * np.arange(count) / count
    return 10.0 ** random.uniform(-1.0, 1.0) * np.c_[np.cos(angles), np.sin(angles)]


def discs(random: np.random.Generator) -> Union:
    """Ring of touching discs."""
    spine = _corners(random)
    apart = float(np.linalg.norm(spine[1] - spine[0]))
    share = random.uniform(0.35, 0.65)
    radii = [share * apart, (1.0 - share) * apart + overlap(random)]
    if len(spine) % 2:
        radii = [0.5 * (apart + overlap(random))] * 2
    return _in_the_plane(
        random, [], [(place, radii[k % 2]) for k, place in enumerate(spine)], spine
    )


def capsules(random: np.random.Generator) -> Union:
    """Ring of capsules, end to end."""
    spine = _corners(random)
    after = np.roll(spine, -1, axis=0)
    side = float(np.linalg.norm(after[0] - spine[0]))
    radius = random.uniform(0.05, 0.2) * side
    back = (radius - 0.5 * overlap(random)) / math.cos(math.pi / len(spine)) / side
    ends = [
        ((1 - back) * a + back * b, back * a + (1 - back) * b)
        for a, b in zip(spine, after, strict=True)
    ]
    loop = np.array(ends).reshape(-1, 2)
    return _in_the_plane(random, [], [(pair, radius) for pair in ends], loop)


def diamonds(random: np.random.Generator) -> Union:
    """Ring of squares that touch at their corners."""
    spine = _corners(random)
    after, o = np.roll(spine, -1, axis=0), 0.5 * overlap(random)
    shapes = []
    for a, b in zip(spine, after, strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        aside = random.uniform(0.05, 0.2) * np.array([(a - b)[1], (b - a)[0]])
        middle = 0.5 * (a + b)
        shapes.append(np.array([a - o * along, middle - aside, b + o * along, middle + aside]))
    return _in_the_plane(random, shapes, [], spine)


def _in_space(
    random: np.random.Generator, shapes: list[tuple[Array, float]], sides: Array, offsets: Array
) -> Union:
    """Points or segments with a radius; inside is where sides·x < offsets."""
    turn, shift = Rotation.random(random_state=random).as_matrix(), random.uniform(-5.0, 5.0, 3)
    made: list[Obstacle] = []
    for points, radius in shapes:
        flat = tuple(map(tuple, np.atleast_2d(points) @ turn.T + shift))
        made.append(rv.Sphere(flat[0], radius) if len(flat) == 1 else rv.Capsule(flat, radius))
    normals = sides @ turn.T
    size = max(float(np.abs(points).max()) for points, _ in shapes) * math.sqrt(3.0)
    return Union(
        made,
        lambda places: ((places - shift) @ normals.T < offsets).all(axis=-1),
        shift,
        size,
    )


def spheres(random: np.random.Generator) -> Union:
    """Shell of spheres without gaps between three of them."""
    if random.random() < 0.5:
        points = np.concatenate([np.eye(3), -np.eye(3)])
    else:
        golden = 0.5 * (1.0 + math.sqrt(5.0))
        three = [(0, a, b * golden) for a in (1, -1) for b in (1, -1)]
        points = np.array([np.roll(p, k) for p in three for k in range(3)], float)
        points /= np.linalg.norm(points[0])
    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    cover = np.linalg.norm((a + b + c) / 3.0 - a, axis=1).max()
    size = 10.0 ** random.uniform(-1.0, 1.0)
    shapes = [(size * p, size * cover + overlap(random)) for p in points]
    return _in_space(random, shapes, hull.equations[:, :3], -size * hull.equations[:, 3])


def logs(random: np.random.Generator) -> Union:
    """Box with sides of parallel capsules."""
    count, o = int(random.integers(3, 7)), overlap(random)
    radius = 1.0 / (count - 1)
    step, reach = 2.0 * radius - o / 2.0, 1.0 + 2.0 * radius
    shapes = []
    for axis in range(3):
        for side in (1.0, -1.0):
            for k in range(-count, count + 1):
                if abs(k * step) <= reach:
                    ends = np.zeros((2, 3))
                    ends[:, axis], ends[:, axis - 1] = side, k * step
                    ends[:, axis - 2] = -reach, reach
                    shapes.append((ends, radius))
    return _in_space(random, shapes, np.concatenate([np.eye(3), -np.eye(3)]), np.ones(6))


UNIONS = {2: (room, tiles, fan, discs, capsules, diamonds), 3: (spheres, logs)}


def pressed(union: Union, dim: int, model: str, mode: str, random: np.random.Generator) -> Count:
    """Simulate teams pressed against a union for some steps."""
    places = _starts(union, (TEAMS[model], ROBOTS), dim, random)
    simulator = rv.Simulator(
        rv.Scenario(
            n_robots=ROBOTS,
            dim=dim,
            robot_model=model,
            local_frames="global",
            obstacles=union.obstacles,
            obstacle_slots=max(SLOTS, len(union.obstacles)),
            obstacle_contact=mode,
            obstacle_range=1e-3,
            merge_radius=1e-9,
            time_step=TIME_STEP,
            allow_long_step=True,
            max_speed=FASTEST,
            max_acceleration=1e9,
            max_turn_rate=20.0,
            time_limit=1e6,
        ),
        TEAMS[model],
        num_threads=1,
    )
    simulator.reset(int(random.integers(2**31)), {"positions": places})
    inside = union.is_inside(places.reshape(-1, dim)).reshape(places.shape[:2])
    count = Count()
    for actions, longest in _actions(model, simulator, random):
        before = simulator.positions
        alone = simulator.active
        outcome = simulator.step(actions)
        merged = (alone != outcome.active).any(axis=1)
        contact, alone = outcome.contact, alone & outcome.active
        after = simulator.positions
        now = union.is_inside(after.reshape(-1, dim)).reshape(inside.shape)
        moved = np.linalg.norm(after - before, axis=-1)
        held = moved < np.maximum(0.49 * longest, _ON_THE_SPOT * (longest > 0.0))
        # far away, where a float64 cannot tell such a step from none, nothing is in the way
        held &= longest > 1e-9 * (1.0 + np.abs(before).max(axis=-1))
        held &= alone & ~merged[:, None]  # who merges rests
        count = Count(
            count.presses + int((contact | held).sum()),
            count.crossings + int((now != inside).sum()),
            count.unreported + int((held & ~contact).sum()),
        )
        inside = now
    return count


def _starts(union: Union, shape: tuple[int, int], dim: int, random: np.random.Generator) -> Array:
    """Initial positions, half near the centre, half outside, (*shape, dim), m."""
    rays = random.normal(size=(*shape, dim))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    reach = np.full((*shape, 1), 0.05 * union.size)
    reach[:, ROBOTS // 2 :] = 4.0 * union.size + 1.0
    return union.centre + reach * random.uniform(0.5, 1.0, reach.shape) * rays


def _actions(
    model: str, simulator: Any, random: np.random.Generator
) -> Iterator[tuple[Array, Array]]:
    """Actions, and the lengths of the commanded displacements, m; 0 where not known."""
    shape = TEAMS[model], ROBOTS
    wide = simulator.scenario.action_size
    speed = rays = np.zeros(())
    for step in range(STEPS):
        if step % 5 == 0:  # they press on in one direction for five steps
            low, high = math.log10(SLOWEST), math.log10(FASTEST)
            speed = 10.0 ** random.uniform(low, high, (*shape, 1))
            rays = random.normal(size=(*shape, simulator.scenario.dim))
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        if model == "single_integrator":
            yield speed * rays, TIME_STEP * speed[..., 0]
        elif model == "double_integrator":
            yield 10.0 * speed * rays, np.zeros(shape)
        else:
            actions = np.concatenate([speed, random.normal(0.0, 3.0, (*shape, wide - 1))], axis=-1)
            actions[::2, :, 1:] = 0.0
            lengths = TIME_STEP * speed[..., 0]
            lengths[1::2] = 0.0
            yield actions, lengths


def main() -> None:
    """Print a line for each kind of union, robot model and mode, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random = np.random.default_rng(arguments.seed)
    found: dict[tuple[str, str, str], Count] = {}
    total, rounds = Count(), 0
    while total.presses < arguments.presses:
        for dim, unions in UNIONS.items():
            for model in MODELS[dim]:
                for make in unions:
                    mode = ("slide", "stop")[(rounds + len(found)) % 2]
                    count = pressed(make(random), dim, model, mode, random)
                    key = make.__name__, model, mode
                    so_far = found.get(key, Count())
                    found[key] = Count(*map(sum, zip(so_far, count, strict=True)))
                    total = Count(*map(sum, zip(total, count, strict=True)))
        rounds += 1
        print(f"round {rounds}: {total}", flush=True)
    for key, count in sorted(found.items()):
        print(f"{' '.join(key):45s} {count.presses:9,d} {count.crossings:6d} {count.unreported:6d}")
    print(f"{total.presses:,} presses, {total.crossings} crossings, "
          f"{total.unreported} unreported stops")  # fmt: skip


if __name__ == "__main__":
    main()
