"""Read-only view of the simulator state."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .engine.memory import RENDEZVOUS, TIME_OUT
from .engine.state import BatchState
from .outcome import ELAPSED, StepOutput
from .physics.hull_perimeter import size
from .scenario.scenario import Scenario

STANDING = ("success", "time", "contacts", "path_length", "lyapunov")
"""Keys of ``StateView.episode_statistics``."""


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Copy of an array that rejects writes, since they would have no effect."""
    array.flags.writeable = False
    return array


def _statistic(name: str, doc: str, kind: Any = np.float64) -> Any:
    def read(view: Any) -> NDArray[Any]:
        return read_only(view._state.statistic(name).astype(kind, copy=False))

    return property(read, doc=doc)


class StateView:
    """Global state of B environments and their episode statistics, as copies.

    The copies are read-only; ``reset(options=…)`` and ``set_state`` change the state.
    """

    scenario: Scenario
    _state: BatchState

    status = _statistic(
        "status",
        "(B,), RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET of engine.memory.",
        np.int64,
    )
    steps = _statistic("steps", "(B,), steps done in this episode.", np.int64)
    contacts = _statistic(
        "contacts", "(B,), contacts in this episode, one for each robot and step.", np.int64
    )
    path_length = _statistic("path_length", "(B,), path length of all robots in this episode, m.")
    initial_lyapunov = _statistic("initial_lyapunov", "(B,), V at the start of the episode, m²/s.")
    min_clearance = _statistic(
        "min_clearance",
        "(B,), minimum distance to an obstacle in this episode, m; inf without obstacles.",
    )

    @property
    def positions(self) -> NDArray[np.float64]:
        """Positions p_i, (B, n, d), m; a merged robot has its survivor's position."""
        places, into = self._state.of_teams("positions"), self._state.merged_into
        return read_only(np.take_along_axis(places, into[..., None], axis=1))

    @property
    def headings(self) -> NDArray[np.float64]:
        """Yaw, or yaw and pitch, (B, n, 1 or 2), rad; (B, n, 0) for robots without a heading."""
        return read_only(self._state.of_teams("memory")[..., : self.scenario.model.n_angles].copy())

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities of robots with inertia in the global frame, (B, n, d), m/s.

        (B, n, 0) for models without a velocity state.
        """
        model, kept = self.scenario.model, self._state.of_teams("memory")
        return read_only(
            kept[..., model.n_angles if model.keeps_velocity else kept.shape[-1] :].copy()
        )

    @property
    def frames(self) -> NDArray[np.float64]:
        """Rotations R_i from local to global frame, (B, n, d, d)."""
        d, frames = self.scenario.dim, self._state.of_teams("frames")
        return read_only(frames.reshape(*frames.shape[:2], d, d).copy())

    @property
    def weights(self) -> NDArray[np.float64]:
        """Current weights a_ij of robot i for its neighbour j, after merges, (B, n, n), m/s."""
        return read_only(self._state.weights())

    @property
    def obstacles(self) -> NDArray[np.float64]:
        """Obstacles as tables, (B, M, width), see ``obstacles.obstacle_set``."""
        return read_only(self._state.obstacle_table().copy())

    @property
    def obstacle_offsets(self) -> NDArray[np.float64]:
        """Displacements of obstacles from their initial positions, (B, M, d), m.

        M is 0 if no obstacle moves. ``obstacles`` are at their current positions.
        """
        return read_only(self._state.traffic[..., : self.scenario.dim].copy())

    @property
    def merged_into(self) -> NDArray[np.int64]:
        """Index of the robot that each one has merged into, its own while active, (B, n)."""
        return read_only(self._state.merged_into.copy())

    def copy_of_merged(self) -> NDArray[np.int64]:
        """Writable copy of ``merged_into``."""
        return self._state.merged_into.copy()

    @property
    def active(self) -> NDArray[np.bool_]:
        """Active (not merged) robots, (B, n)."""
        return read_only(self._state.merged_into == np.arange(self.scenario.n_robots))

    @property
    def conditions(self) -> dict[str, NDArray[np.bool_]]:
        """Condition of each robot in the last step by infos key, (B, n) each.

        "activated" with ``Scenario.activation``: active robots that took a new command. With
        ``Scenario.events``: "crashed", "adversarial", and "blind" for the last observation. Empty
        for other scenarios, and False for merged robots.
        """
        return self._state.conditions()

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Robots that have crashed, are adversarial or blind in the last step, (B, n)."""
        found = np.zeros(self._state.merged_into.shape, np.bool_)
        for name, array in self._state.conditions().items():
            found |= array if name != "activated" else False
        return found

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Environments whose episode has ended, (B,)."""
        status = self._state.statistic("status")
        return read_only((status == RENDEZVOUS) | (status == TIME_OUT))

    @property
    def time(self) -> NDArray[np.float64]:
        """Time since the start of the episode, (B,), s."""
        return read_only(self._state.statistic("steps") * self.scenario.tau)

    @property
    def seeds(self) -> NDArray[np.uint64]:
        """Seed of each environment, (B,)."""
        return read_only(self._state.seed.copy())

    def lyapunov(self) -> NDArray[np.float64]:
        """V = Σ_i Σ_j a_ij ‖p_i − p_j‖, (B,), m²/s, of the current graph."""
        return self._state.statistic("lyapunov")

    def episode_statistics(self, outcome: StepOutput | None = None) -> dict[str, NDArray[Any]]:
        """Episode statistics, (B,) each, with the keys of STANDING.

        Rendezvous, time in s, contacts, path length in m, and V in m²/s. It is fastest with the
        ``outcome`` of the last step, if nothing has changed since.
        """
        if outcome is None:
            status, contacts = self.status, self.contacts.copy()
            so_far = self.time.copy(), self.path_length.copy(), self.lyapunov()
        else:
            status, contacts = outcome.status, outcome.contacts
            scores = outcome.scores  # indexing is faster than unpacking an array
            so_far = scores[ELAPSED], scores[ELAPSED + 1], scores[ELAPSED + 2]
        return _standing(status == RENDEZVOUS, contacts, *so_far)

    def first_episode_statistics(self, outcome: StepOutput) -> dict[str, Any]:
        """``episode_statistics`` of environment 0, as Python numbers; faster for one."""
        met, contacts = outcome.status.item(0) == RENDEZVOUS, outcome.contacts.item(0)
        return _standing(met, contacts, *outcome.scores[ELAPSED:, 0].tolist())

    def size(self) -> NDArray[np.float64]:
        """Hull perimeter L of the active robots, (B,), m; in 3-D 2π × mean width."""
        teams = zip(self._state.of_teams("positions"), self.active, strict=True)
        return np.array([size(places[active]) for places, active in teams])


def _standing(
    success: Any, contacts: Any, time: Any, path_length: Any, lyapunov: Any
) -> dict[str, Any]:
    """Dict with the keys of STANDING; written out, which takes a third of the time of pairing."""
    return {
        "success": success,
        "time": time,
        "contacts": contacts,
        "path_length": path_length,
        "lyapunov": lyapunov,
    }
