"""The price of a robot's first touch of an obstacle, whatever the team's autoreset mode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..infos import Info


class FirstTouches:
    """Which robots have touched an obstacle in the running episode.

    Args:
        num_envs: B.
        n_robots: n.
    """

    def __init__(self, num_envs: int, n_robots: int) -> None:
        self.touched = np.zeros((num_envs, n_robots), dtype=np.bool_)

    def note(self, infos: Info, over: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whose first touch of the episode the last step was, (B, n).

        Args:
            infos: of the step; where a team has begun anew in it, ``final_info`` tells how its last
                episode ended.
            over: (B,), teams whose episode has ended.
        """
        contact = infos["contact"]
        if "final_info" in infos:
            contact = np.where(over[:, None], infos["final_info"]["contact"], contact)
        first: NDArray[np.bool_] = contact & ~self.touched
        self.touched |= contact
        if over.any():
            self.forget(over)
        return first

    def forget(self, which: NDArray[np.bool_] | None = None) -> None:
        """All teams, or those of a mask (B,), begin anew."""
        self.touched[slice(None) if which is None else which] = False
