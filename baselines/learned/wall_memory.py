"""What a robot with a tank remembers of the wall that it is at, and is shown of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WALL_COLUMNS = 12
"""Whether at a wall; log(1 + A/(r D̄)) when it was met; time at it, and how fresh it is; by how much
f and the heading have turned since, half turns; cos and sin of the angle last chosen; velocity and
direction of f, averaged over a long time, along and across f each."""
_LEFT = 2.0
"""Time without a wall before f after which it is left behind, s."""
_LONG = 20.0
"""Over which velocity and direction of f are averaged, s."""
_FRESH, _SLOW = 8.0, 30.0
"""Units of the time at a wall, s."""


class WallMemory:
    """The walls of B teams of n robots; all memory is in ``arrays``, (B, n, ...) each."""

    def __init__(self, num_envs: int, n_robots: int) -> None:
        since, clear, level, turned, wound, angle = np.zeros((6, num_envs, n_robots))
        self.arrays: dict[str, Array] = {
            "since": since,  # s at the wall; 0 at none
            "clear": clear,  # s for which nothing was before f
            "level": level,  # log(1 + A/(r D̄)) when it was met
            "turned": turned,  # by how much f has turned since, rad
            "wound": wound,  # and the heading
            "angle": angle,  # last chosen, rad
            "towards": np.zeros((num_envs, n_robots, 2)),  # f/‖f‖; zero before the first decision
            "heading": np.zeros((num_envs, n_robots, 2)),
            "averages": np.zeros((num_envs, n_robots, 2, 2)),  # of velocity and direction of f
        }

    def see(
        self,
        alive: NDArray[np.bool_],
        elapsed: Array,
        blocked: NDArray[np.bool_],
        level: Array,
        net_bearing: Array,
        headings: Array,
        velocities: Array,
    ) -> list[Array]:
        """Bring the memory of the robots that are ``alive`` up to date.

        Args:
            alive: (B, n), who is shown anything.
            elapsed: (B,), s since the decision before.
            blocked: (B, n), whether silhouettes are before f.
            level: log(1 + A/(r D̄)), (B, n).
            net_bearing: f, (B, n, 2), m/s.
            headings: (B, n, 2).
            velocities: (B, n, 2), m/s.

        Returns:
            WALL_COLUMNS columns (B, n), vectors with x along f.
        """
        old, time = self.arrays, elapsed[:, np.newaxis]
        strength = np.linalg.norm(net_bearing, axis=-1, keepdims=True)
        seen = strength > 0.0
        towards = np.where(seen, net_bearing / np.where(seen, strength, 1.0), 0.0)
        clear = np.where(blocked, 0.0, old["clear"] + time)
        stays = (old["since"] > 0.0) & (clear <= _LEFT)
        meets = blocked & ~stays
        known = np.asarray(old["towards"].any(axis=-1))[..., np.newaxis, np.newaxis]
        begun = np.where(known, old["averages"], np.stack([0.0 * towards, towards], axis=-2))
        kept = np.exp(-elapsed / _LONG)[:, np.newaxis, np.newaxis, np.newaxis]
        turned = old["turned"] + _turn(old["towards"], towards)
        wound = old["wound"] + _turn(old["heading"], headings)
        new = {
            "since": np.where(stays, old["since"] + time, np.where(meets, time, 0.0)),
            "clear": clear,
            "level": np.where(stays, old["level"], np.where(meets, level, 0.0)),
            "turned": np.where(stays, turned, 0.0),
            "wound": np.where(stays, wound, 0.0),
            "towards": towards,
            "heading": headings,
            "averages": kept * begun + (1.0 - kept) * np.stack([velocities, towards], axis=-2),
        }
        for name, values in new.items():
            old[name][alive] = values[alive]
        return self._columns(towards)

    def _columns(self, towards: Array) -> list[Array]:
        mine = self.arrays
        at = mine["since"] > 0.0
        across = np.stack([-towards[..., 1], towards[..., 0]], axis=-1)
        return [
            at.astype(np.float64),
            mine["level"],
            mine["since"] / _SLOW,
            np.where(at, np.exp(-mine["since"] / _FRESH), 0.0),
            mine["turned"] / np.pi,
            mine["wound"] / np.pi,
            np.cos(mine["angle"]),
            np.sin(mine["angle"]),
            *(
                np.sum(mine["averages"][..., k, :] * axis, -1)
                for k in (0, 1)
                for axis in (towards, across)
            ),
        ]


def _turn(before: Array, now: Array) -> Array:
    """From one vector to another, rad counter-clockwise in (−π, π]; 0 where one is zero."""
    across = before[..., 0] * now[..., 1] - before[..., 1] * now[..., 0]
    turn: Array = np.arctan2(across, np.sum(before * now, axis=-1))
    return turn
