"""A tank for policies that choose headings: how fast to go along them, and the budget they keep."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.engine.state_checks import check_numbers
from rendezvous_env.safety.heading import step_scale
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.scenario.scenario import Scenario

_WITHIN = 1.0 - 1e-6
"""Share of the speed limit that is used: after rounding to float32 no action is above the limit,
and what is sent is what the budget has booked."""


class HeadingTankFilter(EnergyTank):
    """Robots want to go along their headings as fast as law (1) goes along f (theorem D).

        Δ = τ min(v_max, s ‖f‖) h,   s = min(1, r/(2 D τ))

    The budget is that of a robot which knows of no contact and no merge: every step books as it was
    commanded. So it is the same in training and in use, where nobody tells.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        arguments: of ``EnergyTank``: budget, min_alignment, num_threads.
    """

    keeps_ledger = False

    def __init__(self, scenario: Scenario, num_envs: int, **arguments: Any) -> None:
        super().__init__(scenario, num_envs, frame="local", **arguments)
        self._headings = np.zeros((num_envs, scenario.n_robots, scenario.dim))
        self._velocities = np.zeros_like(self._headings)
        self._booked = np.zeros(self._headings.shape[:2])

    @property
    def headings(self) -> NDArray[np.float64]:
        """h_i last wanted, (B, n, d), in the robots' own frames; zero where there is none yet."""
        return self._headings.copy()

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Actions last given, (B, n, d), m/s."""
        return self._velocities.copy()

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"headings": self._headings, "velocities": self._velocities, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._headings[which] = self._velocities[which] = 0.0
        self._booked[which] = 0.0

    def hold(self, raw: ArrayLike) -> None:
        """Take headings (B, n, d), unit vectors in the robots' own frames."""
        self._headings[...] = check_numbers("headings", raw, self._headings.shape, "(B, n, d)")

    def settle(self, share: float) -> None:
        """Correct what the last step booked: it lasted only a share of τ.

        G is concave in time and 0 at first: in a share σ ≤ 1 of a step a robot has earned at least
        σ G, which is what stays booked. A longer step is none that was meant; it books G.

        Args:
            share: σ, of the step before.
        """
        corrected = self._levels + (min(share, 1.0) - 1.0) * self._booked
        self._levels[...] = np.maximum(corrected, 0.0)
        self._booked[...] = 0.0

    def act(
        self, observations: NDArray[np.float32], elapsed: float | None = None
    ) -> NDArray[np.float32]:
        """As ``EnergyTank.act``; the step is booked at once, as one that lasts τ. How much time
        has elapsed is of no concern to headings that turn as they like.
        """
        scenario, layout = self.scenario, self.scenario.observation_layout
        strength = np.linalg.norm(layout.net_bearing(observations), axis=-1)
        degree = layout.degree(observations)
        law_speed = step_scale(degree, scenario.merge_radius, scenario.tau) * strength
        share = _WITHIN * np.minimum(law_speed / scenario.speed_limit, 1.0)
        super().hold(share[..., np.newaxis] * self._headings)
        actions = super().act(observations)
        self._booked[...] = self._deposits
        self.book()
        self._velocities[...] = actions
        return actions
