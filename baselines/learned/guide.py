"""From a choice to an action: the joined rule, as if f pointed a chosen angle to the side, kept to
its guarantee; the same in training and in use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, refuse
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.scenario.scenario import Scenario

from ..obstacle_rules.obstacle_avoidance import tangent_joined_heading
from .features import Features, TankFeatures
from .heading_tank_filter import HeadingTankFilter

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
        persistence: λ of ``baselines.obstacle_rules.merged_silhouettes_2d.joined_headings_2d``.
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


class GuidedTeams:
    """B teams whose robots are shown something, choose by it, and head where the guide says.

        show → (a network chooses) → choose, or head → act: guide, certified heading, law (4)

    What is shown moves the memory on, so it is asked for once in each decision; ``act`` follows
    what is seen in every step.

    Args:
        steering: of the teams, in the robots' local frames: certified headings, or a tank.
        guide: of their scenario.
        perception: of the teams.
    """

    def __init__(
        self, steering: HeadingFilter | HeadingTankFilter, guide: Guide, perception: Features
    ) -> None:
        self.steering, self.guide, self.perception = steering, guide, perception
        self.choices = np.zeros(steering.alignment.shape, dtype=np.int64)
        self._directions = guide.directions[self.choices]

    def settle(self, share: float) -> None:
        """Take note that the step before lasted so much of τ; who keeps no account need not."""

    def show(
        self,
        observations: NDArray[np.float32],
        which: NDArray[np.bool_] | None = None,
        elapsed: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """What the robots are shown before they choose; arguments as ``Features.see``."""
        return self.perception.see(observations, self.steering.headings, which, elapsed=elapsed)

    def choose(self, choices: ArrayLike) -> None:
        """Take choices (B, n), held until the next ones.

        Raises:
            ValueError: for another shape, or naming the robot whose choice there is not.
        """
        given, count = np.asarray(choices), len(self.guide.angles)
        if given.shape != self.choices.shape:
            raise ValueError(
                f"actions have shape {given.shape}; they must be (B, n) = {self.choices.shape}"
            )
        wrong = ~((given >= 0) & (given < count))
        for team, robot in np.argwhere(wrong):
            raise ValueError(
                f"action of robot_{robot} in team {team} is {given[team, robot]}; it must be a "
                f"whole number below {count}"
            )
        self.choices = given.astype(np.int64)
        self._directions = self.guide.directions[self.choices]

    def head(self, vectors: ArrayLike) -> None:
        """Take directions instead of choices: how f is to be turned, seen with x along f.

        Args:
            vectors: (B, n, 2); their length does not count, and none at all is straight ahead.

        Raises:
            ValueError: for another shape, or naming the robot whose vector is not finite.
        """
        given, wanted = floats("actions", vectors), (*self.choices.shape, 2)
        if given.shape != wanted:
            raise ValueError(f"actions have shape {given.shape}; they must be (B, n, 2) = {wanted}")
        for team, robot, _ in np.argwhere(~np.isfinite(given)):
            refuse(f"action of robot_{robot} in team {team}", given[team, robot].tolist(), "finite")
        length = np.linalg.norm(given, axis=-1, keepdims=True)
        ahead = self.guide.directions[0]
        unit = given / np.where(length > 0.0, length, 1.0)
        self._directions = np.where(length > 0.0, unit, ahead)

    def act(
        self, observations: NDArray[np.float32], elapsed: float | None = None
    ) -> NDArray[np.float32]:
        """Velocities of the robots.

        Args:
            observations: (B, n, rows, 2), in the local frames.
            elapsed: s since the velocities before, in which headings turned; None is τ.

        Returns:
            (B, n, 2), m/s.
        """
        headings = self.steering.headings
        self.steering.hold(self.guide.aim_aside(observations, self._directions, headings))
        return self.steering.act(observations, elapsed)

    def forget(self, which: NDArray[np.bool_] | None = None) -> None:
        """Forget headings and what was seen, of all teams or of those of a mask (B,)."""
        self.steering.forget(which)
        self.perception.forget(which)


class TankTeams(GuidedTeams):
    """The same with theorem D: headings all round, as far as the tanks pay for them.

    Args:
        steering: the tanks.
        guide: of the scenario.
        perception: which shows the level too.
    """

    steering: HeadingTankFilter
    perception: TankFeatures

    def settle(self, share: float) -> None:
        """As ``HeadingTankFilter.settle``."""
        self.steering.settle(share)

    def show(
        self,
        observations: NDArray[np.float32],
        which: NDArray[np.bool_] | None = None,
        elapsed: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """As ``GuidedTeams.show``."""
        tank = self.steering
        return self.perception.see_tank(
            observations,
            tank.headings,
            which,
            velocities=tank.velocities,
            levels=tank.normalised_levels,
            elapsed=elapsed,
        )

    def choose(self, choices: ArrayLike) -> None:
        """As ``GuidedTeams.choose``; the perception remembers them."""
        super().choose(choices)
        self.perception.note(self.guide.angles[self.choices])

    def head(self, vectors: ArrayLike) -> None:
        """As ``GuidedTeams.head``; the perception remembers the angles."""
        super().head(vectors)
        self.perception.note(np.arctan2(self._directions[..., 1], self._directions[..., 0]))
