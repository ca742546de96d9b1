"""Open-loop replay: logged bearings through a policy, and its motion against ground truth.

V = Σᵢ Σⱼ ‖pᵢ − pⱼ‖ over ordered pairs of all robots of the log has V̇ = −2 Σᵢ fᵢᵀvᵢ. Here fᵢ is the
sum of the true unit vectors to the others and vᵢ the commanded velocity.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines import HeadingPolicy, RobotPolicy, TankPolicy

from rendezvous_env.calibration import SensorLog
from rendezvous_env.calibration.frames import find_frames
from rendezvous_env.scenario.scenario import Scenario

from .. import policies
from ..checks import user_error

POLICIES = ("bearing-only", "headings", "tank")
"""Law (1), and random choices under the filters of headings and of tanks."""
_FILTERED = {"headings": HeadingPolicy, "tank": TankPolicy}
_HOLD = 1.0  # s, after which a robot without a new frame stops
_RESTS = 1e-9  # m/s
_SPEEDS = {
    "single_integrator": {"max_speed": 0.075},
    "unicycle": {"max_speed": 0.075, "max_turn_rate": 0.4},
}

Floats = NDArray[np.float64]


class Replayed(NamedTuple):
    """Commands of one policy at F frames of a log, by observer and time."""

    policy: str
    observer: NDArray[np.int64]  # (F,)
    time: Floats  # (F,), s
    seen: NDArray[np.int64]  # (F,), number of robots in the frame
    hold: Floats  # (F,), s, for which the command is held; 0 for the last
    velocity: Floats  # (F, 2), m/s, in the frame of the poses
    net_bearing: Floats  # (F, 2), fᵢ, true
    rate: Floats  # (F,), of V by this robot's motion, m/s per unit of gain
    margin: Floats  # (F,), cosine between fᵢ and vᵢ; NaN at rest
    team_rate: Floats  # (F,), of V by the motion of all robots at this time

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(F,), frames with a command to move."""
        return np.linalg.norm(self.velocity, axis=-1) > _RESTS


def scenario_of(log: SensorLog, robot_model: str) -> Scenario:
    """Scenario of the robots of a log, in free space."""
    limits: dict[str, Any] = _SPEEDS[robot_model]
    return Scenario(
        name="replay", n_robots=log.n_robots, robot_model=robot_model, merge_radius=0.35,
        time_step=_HOLD, allow_long_step=True, **limits,
    )  # fmt: skip


def replay(log: SensorLog, policy: str, robot_model: str = "single_integrator") -> Replayed:
    """Commands of a policy to the bearings of a log.

    Raises:
        UserError: for an unknown policy, or one that robots cannot run.
    """
    log, frames = find_frames(log)
    scenario = scenario_of(log, robot_model)
    with user_error(f"--policy {policy}: ", ValueError, TypeError):
        robot = _robot(policy, scenario)
    everyone = np.arange(log.n_robots)
    poses = [log.tracks[i].at(frames.time) for i in everyone]
    place = np.stack([one[0][:, :2] for one in poses], axis=1)
    known = np.stack([one[2] for one in poses], axis=1).all(axis=1)
    own = np.arange(len(frames.time)), frames.observer
    yaw = np.stack([one[1] for one in poses], axis=1)[own]
    net = _net_bearings(place)
    gap = frames.interval()
    after = np.append(gap[1:], np.inf)
    hold = np.where(np.isfinite(after), np.minimum(after, _HOLD), 0.0)  # none after the last frame
    rows = _rows_of_frames(log, frames.row, len(frames.time))
    velocity, seen = np.zeros((len(gap), 2)), np.zeros(len(gap), np.int64)
    for k, (elapsed, heading) in enumerate(zip(gap.tolist(), yaw.tolist(), strict=True)):
        if elapsed > _HOLD:
            robot.reset()
        angles = rows[k]
        seen[k] = len(angles)
        velocity[k] = _command(robot, angles, heading, elapsed, robot_model)
    rate = -2.0 * (net[own] * velocity).sum(axis=-1)
    team = _team_rates(frames.observer, frames.time, velocity, net)
    size = np.linalg.norm(net[own], axis=-1) * np.linalg.norm(velocity, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        margin = np.where(size > _RESTS, -0.5 * rate / size, np.nan)
    told: list[Any] = [
        frames.observer, frames.time, seen, hold, velocity, net[own], rate, margin, team,
    ]  # fmt: skip
    return Replayed(policy, *(one[known] for one in told))


def _robot(name: str, scenario: Scenario) -> RobotPolicy:
    """Policy of one robot; ``headings`` and ``tank`` choose at random, uniformly."""
    if name not in _FILTERED:
        policies.check_names([name])
        return RobotPolicy(scenario, name)
    random, size = np.random.default_rng(0), scenario.action_size
    if name == "headings" and scenario.model.nonholonomic:
        size = scenario.dim - 1  # turn rates

    def choose(observations: NDArray[np.float32]) -> Floats:
        return random.uniform(-1.0, 1.0, (*observations.shape[:-2], size))

    return RobotPolicy(scenario, _FILTERED[name](scenario, choose))


def _rows_of_frames(log: SensorLog, row: NDArray[np.int64], count: int) -> list[Floats]:
    """Bearings of robots in each frame, one for each."""
    use = np.flatnonzero(log.robot_rows())
    _, first = np.unique(np.stack([row[use], log.target[use]]), axis=1, return_index=True)
    use = use[np.sort(first)]
    use = use[np.argsort(row[use], kind="stable")]
    ends = np.searchsorted(row[use], np.arange(count + 1))
    return [log.bearing[use[a:b]] for a, b in pairwise(ends)]


def _command(
    robot: RobotPolicy, angles: Floats, heading: float, elapsed: float, robot_model: str
) -> Floats:
    """Velocity, (2,), m/s, in the frame of the poses."""
    turns = robot_model == "unicycle"
    angles = angles if turns else angles + heading
    bearings = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(-1, 2)
    action = robot.act(bearings, dt=min(max(elapsed, 1e-3), _HOLD))
    if turns:
        return action[0] * np.array([np.cos(heading), np.sin(heading)])
    return action


def _net_bearings(place: Floats) -> Floats:
    """Sums of unit vectors to the others, (F, n, 2), of positions (F, n, 2)."""
    offset = place[:, None] - place[:, :, None]
    length = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.divide(offset, length, out=np.zeros_like(offset), where=length > 0.0).sum(axis=2)


def _team_rates(observer: NDArray[np.int64], time: Floats, velocity: Floats, net: Floats) -> Floats:
    """Rate of V at each frame (F,) by all robots, each with its last command for up to the hold."""
    rates = np.zeros(len(time))
    for robot in np.unique(observer):
        own = np.flatnonzero(observer == robot)
        last = np.searchsorted(time[own], time, side="right") - 1
        held = own[np.maximum(last, 0)]
        fresh = (last >= 0) & (time - time[held] <= _HOLD)
        rates += np.where(fresh, -2.0 * (net[:, robot] * velocity[held]).sum(axis=-1), 0.0)
    return rates


def summary(found: Replayed) -> dict[str, Any]:
    """Shares of time, and margins.

    ``decreases``, ``increases`` and ``rests`` are shares of the time of all robots between their
    first and last frames; ``decreases_when_moving`` of the time with a command; margins are
    quantiles of the cosine between command and net bearing; the team has all robots at a frame.
    """
    moves = found.moves
    total = sum(
        float(np.ptp(found.time[found.observer == robot])) for robot in np.unique(found.observer)
    )
    down, up = moves & (found.rate < 0.0), moves & (found.rate > 0.0)
    falls, rises = float(found.hold[down].sum()), float(found.hold[up].sum())
    margins = found.margin[np.isfinite(found.margin)]
    quantiles = np.quantile(margins, (0.05, 0.5, 0.95)) if len(margins) else [np.nan] * 3
    going = found.team_rate != 0.0
    return {
        "policy": found.policy,
        "frames": len(found.time),
        "decreases": falls / total,
        "increases": rises / total,
        "rests": max(0.0, 1.0 - (falls + rises) / total),
        "decreases_when_moving": falls / max(falls + rises, 1e-12),
        "margin_quantiles": [float(one) for one in quantiles],
        "team_decreases": float((found.team_rate < 0.0).mean()),
        "team_decreases_when_moving": float((found.team_rate[going] < 0.0).mean())
        if going.any()
        else 0.0,
    }
