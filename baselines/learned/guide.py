"""From a choice to a heading: the joined rule, as if f pointed a chosen angle to the side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.experiment.scenario import Scenario

from ..obstacle_avoidance import tangent_joined_heading

ANGLES = np.array([0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0, 1.4, -1.4])
"""What can be chosen where headings are certified, rad counter-clockwise from f; the first choice
is the rule itself."""
ALL_ROUND = np.array([*ANGLES, 1.9, -1.9, 2.5, -2.5, np.pi])
"""What can be chosen where a tank pays for going away from f, rad; begins as ANGLES."""
CHOICES = len(ANGLES)


class Guide:
    """Turns choices into raw vectors: which way round, and how much aside.

        raw = joined rule(R(φ) f),   φ the angle chosen

    Choice 0 is the rule of ``tangent-joined-tuned``. Edges are passed with a clearance, and the
    side that a robot has chosen before counts (``persistence``).

    Args:
        scenario: whose robots are guided.
        clearance: rad.
        persistence: λ of ``baselines.joined_plane.joined_headings_2d``.
        angles: φ of every choice, rad.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        clearance: float,
        persistence: float,
        angles: NDArray[np.float64] = ANGLES,
    ) -> None:
        self.angles = angles
        self.directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        self._layout = scenario.observation_layout
        self._clearance, self._persistence = clearance, persistence

    def aim(
        self,
        observations: NDArray[np.float32],
        choices: NDArray[np.int64],
        carried: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Raw vectors (B, n, 2) in the robots' own frames.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            choices: (B, n), indices of ``angles``.
            carried: headings of the step before, (B, n, 2), zero where there is none.
        """
        return self.aim_aside(observations, self.directions[choices], carried)

    def aim_aside(
        self,
        observations: NDArray[np.float32],
        directions: NDArray[np.float64],
        carried: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """As ``aim``, for any directions (cos φ, sin φ), (B, n, 2)."""
        f = self._layout.net_bearing(observations).astype(np.float64)
        c, s = directions[..., 0], directions[..., 1]
        aside = np.stack((c * f[..., 0] - s * f[..., 1], s * f[..., 0] + c * f[..., 1]), axis=-1)
        return tangent_joined_heading(
            aside,
            self._layout.split(observations).obstacles,
            clearance=self._clearance,
            carried=carried,
            persistence=self._persistence,
        )
