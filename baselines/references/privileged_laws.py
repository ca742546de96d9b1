"""Oracle baselines: laws from the literature that require relative positions."""

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import bools, check_shape, raise_invalid
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from ..laws.literature_laws import chosen_rows, unit_mean_law
from ..policy import Float32, Mask, TeamPolicy, is_single_integrator, register, within_limits
from ..steering import Steering
from .enclosing_ball import smallest_enclosing_ball

Array = NDArray[np.float64]
_ASIDE = 1e-3  # tangent of the angle to its path within which a nonholonomic robot drives


class PrivilegedPolicy(TeamPolicy):
    """Base class of oracles, which read positions; nonholonomic robots turn on the spot."""

    name: str  # name in the registry

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._steering = Steering(scenario)
        self._simulator: Simulator | None = None
        self._fresh: Mask = np.zeros(0, np.bool_)
        self._steps: NDArray[np.int64] = np.zeros(0, np.int64)

    def watch(self, simulator: Simulator) -> None:
        """Set the simulator, just reset, whose map and positions are read.

        A ValueError for another object, or other robots.
        """
        n, d, model = self.scenario.n_robots, self.scenario.dim, self.scenario.model.name
        wanted = f"a Simulator of {n} {model.replace('_', ' ')}s in {d}-D"
        if not isinstance(simulator, Simulator):
            raise_invalid("simulator", simulator, wanted)
        given = simulator.scenario
        if (given.model.name, given.n_robots, given.dim) != (model, n, d):
            raise_invalid("simulator", given, wanted)
        self._simulator, self._steps = simulator, simulator.steps
        self.reset()

    def reset(self, mask: Mask | None = None) -> None:
        """As ``Policy.reset``, for the watched simulator."""
        if self._simulator is None:
            return
        batch = self._simulator.num_envs
        if mask is None:
            self._fresh = np.ones(batch, bool)
        else:
            self._fresh = self._fresh | bools("mask", mask, (batch,), "environments")

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``Policy``, for the watched simulator.

        Raises:
            RuntimeError: without a watched simulator.
            ValueError: if the observations belong to another simulator.
        """
        seen = self.scenario.observation_layout.checked(observations)
        if (simulator := self._simulator) is None:
            raise RuntimeError(
                f"{self.name} reads positions: call its watch(simulator) before an episode, as "
                "rollout and compare do"
            )
        teams = (simulator.num_envs, self.scenario.n_robots)
        watched = [(*axes, *seen.shape[-2:]) for axes in (teams, teams[teams[0] == 1 :])]
        check_shape(f"observations of the environments that {self.name} watches", seen, *watched)
        steps, active = simulator.steps, simulator.active
        begun = self._fresh | (steps < self._steps)
        self._fresh, self._steps = np.zeros_like(begun), steps
        wanted = self._velocities(simulator, active, begun)
        wanted = np.where(active[..., np.newaxis], wanted, 0.0)
        # frames map local to global vectors, their transpose the reverse
        own = np.sum(simulator.frames * wanted[..., np.newaxis], axis=-2)
        actions = self._steering.actions(own, seen.reshape(*own.shape[:-1], *seen.shape[-2:]))
        if self._steering.turns:
            aside = np.linalg.norm(own[..., 1:], axis=-1) > _ASIDE * own[..., 0]
            actions[..., 0] = np.where(aside, 0.0, actions[..., 0])
        limited = within_limits(actions, self.scenario)
        return limited.reshape(*seen.shape[:-2], self.scenario.action_size)

    @abstractmethod
    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        """Velocities (B, n, d), m/s, in the global frame, of the active robots, (B, n).

        ``begun``, (B,), marks environments that have just been reset.
        """


def without_overshoot(rest: Array, scenario: Scenario) -> Array:
    """Velocities (..., d), m/s, along ``rest``, m, at the speed limit without overshoot."""
    distance = np.linalg.norm(rest, axis=-1, keepdims=True)
    speed = scenario.speed_limit / np.where(distance > 0.0, distance, 1.0)
    return rest * np.minimum(speed, 1.0 / scenario.tau)


def circumcentres(positions: Array, linked: Mask) -> Array:
    """Centres, (n, d), m, of the smallest balls around robots and those ``linked``, (n, n)."""
    company, which = np.unique(
        linked | np.eye(len(positions), dtype=bool), axis=0, return_inverse=True
    )
    centres = [smallest_enclosing_ball(positions[members])[0] for members in company]
    return np.array(centres)[which.reshape(-1)]


def farthest_steps(towards: Array, ways: Array, linked: Mask, sight: float) -> Array:
    """Maximum step lengths that keep all neighbours within range, (n,), m.

        lᵢⱼ = (dⱼ/2) cos θⱼ + √((R/2)² − ((dⱼ/2) sin θⱼ)²),   minⱼ lᵢⱼ       (Ando et al., 1999)

    Two neighbours stay in the ball of radius R/2 around their midpoint. Inputs are directions, unit
    vectors (n, d); p_j − p_i, (n, n, d), m, with lengths d_j and angles θ_j to the directions; a
    mask of neighbours, (n, n); and R, m. inf for a robot without neighbours.
    """
    along = 0.5 * np.sum(ways * towards[:, np.newaxis], axis=-1)
    aside = np.maximum(0.25 * np.sum(ways**2, axis=-1) - along**2, 0.0)
    limits = along + np.sqrt(np.maximum(0.25 * sight**2 - aside, 0.0))
    return np.asarray(np.min(np.maximum(limits, 0.0), axis=-1, where=linked, initial=np.inf))


def _ways_and_gains(simulator: Simulator) -> tuple[Array, Array]:
    """Offsets p_j − p_i, (B, n, n, d), m, and a_ij, (B, n, n), m/s, of robots within range."""
    positions, scenario = simulator.positions, simulator.scenario
    sight = scenario.sensing.each("range", scenario.n_robots)[:, np.newaxis]
    ways, gains = positions[:, np.newaxis] - positions[:, :, np.newaxis], simulator.weights
    if np.isfinite(sight).any():
        gains = np.where(np.linalg.norm(ways, axis=-1) <= sight, gains, 0.0)
    return ways, gains


@register("privileged-consensus", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedConsensus(PrivilegedPolicy):
    """Linear consensus protocol.

        ṗᵢ = Σⱼ aᵢⱼ (pⱼ − pᵢ),   aᵢⱼ here in 1/s           (Olfati-Saber & Murray, 2004)

    Scaled down where a step would overshoot the neighbours' mean.
    """

    name = "privileged-consensus"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        held = self.scenario.tau * gains.sum(axis=-1, keepdims=True)
        return np.sum(gains[..., np.newaxis] * ways, axis=-2) / np.maximum(held, 1.0)


@register("privileged-circumcentre", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedCircumcentre(PrivilegedPolicy):
    """Towards the circumcentre of visible robots, with steps that keep all links (Ando et al.)."""

    name = "privileged-circumcentre"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        linked, sight = gains > 0.0, self.scenario.sensing.smallest("range")
        positions = simulator.positions
        rest = np.zeros_like(positions)
        for team in np.flatnonzero(active.sum(axis=1) > 1):
            here = np.flatnonzero(active[team])
            among = linked[team][np.ix_(here, here)]
            goals = circumcentres(positions[team, here], among) - positions[team, here]
            if np.isfinite(sight):
                length = np.linalg.norm(goals, axis=-1, keepdims=True)
                towards = goals / np.where(length > 0.0, length, 1.0)
                nearby = ways[team][np.ix_(here, here)]
                most = farthest_steps(towards, nearby, among, sight)[:, np.newaxis]
                goals = towards * np.minimum(length, most)
            rest[team, here] = goals
        return without_overshoot(rest, self.scenario)


@register("privileged-enclosing-ball", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedEnclosingBall(PrivilegedPolicy):
    """Straight to the centre of the smallest ball around the initial positions.

    The fastest possible policy without obstacles, which it ignores.
    """

    name = "privileged-enclosing-ball"

    def watch(self, simulator: Simulator) -> None:
        """As ``PrivilegedPolicy.watch``."""
        super().watch(simulator)
        self._centres = np.zeros((simulator.num_envs, self.scenario.dim))

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        positions = simulator.positions
        for team in np.flatnonzero(begun):
            self._centres[team], _ = smallest_enclosing_ball(positions[team, active[team]])
        return without_overshoot(self._centres[:, np.newaxis] - positions, self.scenario)


@register("privileged-nearest-pursuit", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedNearestPursuit(PrivilegedPolicy):
    """Towards the nearest visible robot, which bearings do not determine."""

    name = "privileged-nearest-pursuit"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        linked = gains > 0.0
        distances = np.where(linked, np.linalg.norm(ways, axis=-1), np.inf)
        way = chosen_rows(ways, np.argmin(distances, axis=-1))
        way = np.where(linked.any(axis=-1, keepdims=True), way, 0.0)
        return unit_mean_law(way, speed=self.scenario.speed_limit)
