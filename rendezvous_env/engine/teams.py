"""What the kernels work on: state, results and constants as tuples of arrays."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .lanes import LANES

RUNNING, RENDEZVOUS, TIME_OUT, FRESH = range(4)
"""Status of a team. FRESH: reset in this very step, in which it does not move."""

BOOK = (
    "status",  # RUNNING, RENDEZVOUS, TIME_OUT or FRESH
    "steps",  # done in this episode
    "active",  # robots that exist on their own
    "contacts",  # in this episode, one for each robot and step
    "path_length",  # way of all robots together in this episode, m
    "initial_lyapunov",  # V at the start of the episode, m²/s
    "lyapunov",  # V now, m²/s; follows from positions and weights
    "min_clearance",  # least distance to an obstacle in this episode, m
    "square_closest",  # least square distance of two neighbours as of the last observation, m²
)
"""One team's book-keeping, in the order in which it stands in ``Teams.book``."""
(
    STATUS,
    STEPS,
    ACTIVE,
    CONTACTS,
    PATH_LENGTH,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    MIN_CLEARANCE,
    SQUARE_CLOSEST,
) = range(len(BOOK))

SCORES = 5
REWARD, LYAPUNOV_BEFORE_MERGE, LYAPUNOV_AFTER_MERGE, MERGE_RISE, MERGE_EXCESS = range(SCORES)
"""Rows of ``Results.scores``: the team reward; V just before the first and after the last merge
of the step (V at its end if there was none); the largest rise of V at a merge, and above the bound
of theory 5."""


class Teams(NamedTuple):
    """State of B teams.

    Positions, frames, weights and the book stand in lane blocks (see ``lanes.py``): team b is lane
    b % LANES of block b // LANES, and the last block is filled up with lanes that belong to no
    team.
    """

    positions: NDArray[np.float64]
    """(blocks, n, d·LANES), m; a merged-away robot's entry stays where it merged."""
    frames: NDArray[np.float64]
    """(blocks, n, d·d·LANES), local → global; follows from the angles where there are any."""
    weights: NDArray[np.float64]
    """(blocks, n(n − 1)/2, LANES), a_ij of the pairs i < j, m/s."""
    angles: NDArray[np.float64]
    """(B, n, k), rad: none, yaw, or yaw and pitch."""
    obstacles: NDArray[np.float64]
    """(B, M, width), packed as obstacles.py says."""
    merged_into: NDArray[np.int64]
    """(B, n), the robot that each one is now part of; itself while it is active."""
    book: NDArray[np.float64]
    """(blocks, entries·LANES), the entries of BOOK; whole numbers are exact in it."""


class Results(NamedTuple):
    """Where a step writes what it gives out."""

    observations: NDArray[np.float32]
    """(B, n·rows·d)."""
    scores: NDArray[np.float64]
    """(5, B), rows REWARD … MERGE_EXCESS."""
    contact: NDArray[np.bool_]
    """(B, n), whether the robot touched an obstacle in this step."""
    clearance: NDArray[np.float64]
    """(B, n), distance to the nearest obstacle, m; inf without obstacles."""
    active: NDArray[np.bool_]
    """(B, n), whether the robot still exists on its own."""
    status: NDArray[np.int64]
    """(B,), RUNNING, RENDEZVOUS or TIME_OUT."""
    robot_rewards: NDArray[np.float64]
    """(B, n), the team reward of robots that take part in the step, else 0."""


class Physics(NamedTuple):
    """The scenario's constants, as the kernels want them."""

    n_angles: int
    duration: float
    merge_radius: float
    speed_limit: float
    yaw_rate_limit: float
    pitch_rate_limit: float
    max_steps: int
    contact_mode: int
    obstacle_range: float
    neighbour_slots: int
    rows: int
    reward_weights: tuple[float, float, float, float]
    all_earn: bool
    """Whether merged-away robots earn the team reward, too."""


@kernel
def read_positions(block, lane, teams, out):
    """Positions of one team, to ``out`` (n, d), m."""
    n, d = out.shape
    for i in range(n):
        for k in range(d):
            out[i, k] = teams.positions[block, i, k * LANES + lane]


@kernel
def write_positions(block, lane, teams, positions):
    """Put positions (n, d) in m into one team."""
    n, d = positions.shape
    for i in range(n):
        for k in range(d):
            teams.positions[block, i, k * LANES + lane] = positions[i, k]


@kernel
def read_weights(block, lane, teams, out):
    """Weights of one team, to ``out`` (n, n), m/s."""
    n = out.shape[0]
    pair = 0
    for i in range(n):
        out[i, i] = 0.0
        for j in range(i + 1, n):
            out[i, j] = teams.weights[block, pair, lane]
            out[j, i] = out[i, j]
            pair += 1


@kernel
def write_weights(block, lane, teams, weights):
    """Put weights (n, n) in m/s into one team."""
    n = weights.shape[0]
    pair = 0
    for i in range(n):
        for j in range(i + 1, n):
            teams.weights[block, pair, lane] = weights[i, j]
            pair += 1


@kernel
def read_frame(block, lane, i, teams, out):
    """The frame of robot i of one team, to ``out`` (d, d)."""
    d = out.shape[0]
    for row in range(d):
        for k in range(d):
            out[row, k] = teams.frames[block, i, (row * d + k) * LANES + lane]


@kernel
def write_frame(block, lane, i, teams, frame):
    """Put the frame (d, d) of robot i into one team."""
    d = frame.shape[0]
    for row in range(d):
        for k in range(d):
            teams.frames[block, i, (row * d + k) * LANES + lane] = frame[row, k]


def from_lanes(blocks: NDArray[np.float64], batch: int) -> NDArray[np.float64]:
    """Numbers of each team from lane blocks: (blocks, m, c·LANES) → (B, m, c)."""
    count, m, width = blocks.shape
    lanes_last = blocks.reshape(count, m, width // LANES, LANES)
    return np.moveaxis(lanes_last, -1, 1).reshape(count * LANES, m, -1)[:batch]


def to_lanes(values: NDArray[np.float64], blocks: NDArray[np.float64]) -> None:
    """Write (B, m, c) into lane blocks (blocks, m, c·LANES); other lanes keep what they hold."""
    batch, m, c = values.shape
    lanes_last = blocks.reshape(len(blocks), m, c, LANES)
    team = np.arange(batch)
    lanes_last[team // LANES, :, :, team % LANES] = values


def from_book(book: NDArray[np.float64], entry: int, batch: int) -> NDArray[np.float64]:
    """One entry of every team's book, (B,), as a copy."""
    return book.reshape(len(book), -1, LANES)[:, entry].flatten()[:batch]


def to_book(values: NDArray[Any], entry: int, book: NDArray[np.float64]) -> None:
    """Write one entry of the first teams' books, (B,)."""
    to_lanes(values[:, None, None], book[:, None, entry * LANES : (entry + 1) * LANES])
