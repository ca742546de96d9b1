"""A trained network as a policy: observations in, actions out, like the scripted ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import bools
from rendezvous_env.experiment.scenario import Scenario

from ..policy import of_whole_teams, within_limits
from . import checkpoints
from .checkpoints import CheckpointError
from .chooser import Chooser, Network
from .guided import TankTeams
from .onnx_network import SUFFIX, OnnxNetwork
from .policy_settings import PolicySettings
from .robots import check_readable

__all__ = ["LearnedPolicy", "PolicySettings", "load"]


class LearnedPolicy:
    """A network's likeliest choice, made safe: theorem C, or D, holds whatever the weights.

    It chooses every ``decision_time``; guide and certified heading, or tank, follow what is seen in
    each step. Teams of any size and any number of obstacles; single integrators in the plane. The
    memory has the leading axes of the observations; other leading axes are other teams, and start
    anew.

    Args:
        scenario: whose robots it steers.
        weights: of the network, by name, as a checkpoint has them; or a network.
        settings: of the network and of the guarantee.

    Raises:
        ValueError: for robots that it cannot steer, or weights that do not fit the settings.
    """

    def __init__(
        self,
        scenario: Scenario,
        weights: Mapping[str, NDArray[Any]] | Network,
        settings: PolicySettings,
    ) -> None:
        check_readable(scenario)
        self.scenario, self.settings = scenario, settings
        self.min_alignment = settings.promised_margin
        self.decision_period = settings.decision_period(scenario)
        if isinstance(weights, Network):
            self._chooser = weights
        else:
            self._chooser = Chooser(weights, settings, settings.layout_of(scenario))
        self._leading: tuple[int, ...] | None = None
        self._steps: NDArray[np.float64] = np.zeros(0)

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, 2); see ``baselines.Policy``.

        Raises:
            ValueError: for observations of another shape than the scenario's.
        """
        return self.after(self.scenario.tau, observations, time)

    def after(
        self, elapsed: float, observations: NDArray[Any], time: ArrayLike
    ) -> NDArray[np.float32]:
        """As a call, where the call before was so many seconds ago; see ``RealTimePolicy``."""
        seen = of_whole_teams(observations, self.scenario)
        if seen.shape[:-3] != self._leading:
            self._begin(seen.shape[:-3])
        teams = seen.reshape(-1, *seen.shape[-3:])
        share = elapsed / self.scenario.tau
        self._guided.settle(share)
        self._steps += share
        due = self._steps + 0.5 * share >= self.decision_period  # or sooner than the next call
        if due.any():
            self._decide(teams, due)
        velocities = self._guided.act(teams, elapsed).astype(np.float64)
        actions = within_limits(velocities, self.scenario)
        return actions.reshape(*seen.shape[:-2], 2)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the teams where ``mask`` is true, all if it is None."""
        if mask is None:
            self._leading = None
        elif self._leading is not None:
            which = bools("mask", mask, self._leading, "teams").reshape(-1)
            self._guided.forget(which)
            self._hidden[which] = 0.0
            self._steps[which] = np.inf

    @property
    def levels(self) -> NDArray[np.float64] | None:
        """Of the tanks, (..., n), m²/s; None without tanks or before the first action."""
        if self._leading is None or not isinstance(self._guided, TankTeams):
            return None
        return self._guided.steering.levels.reshape(*self._leading, -1)

    def _begin(self, leading: tuple[int, ...]) -> None:
        teams = math.prod(leading)
        self._guided = self.settings.make_teams(self.scenario, teams)
        self._steps = np.full(teams, np.inf)
        """Since the last choice, (B,), in units of τ; inf before the first."""
        remembered = (teams, self.scenario.n_robots, self.settings.units)
        self._hidden = np.zeros(remembered, dtype=np.float32)
        self._leading = leading

    def _decide(self, observations: NDArray[np.float32], due: NDArray[np.bool_]) -> None:
        """New choices for the teams that are due."""
        steps = np.where(np.isinf(self._steps), self.decision_period, self._steps)
        shown = self._guided.show(observations, due, steps * self.scenario.tau)
        self._steps[due] = 0.0
        choices, alive = self._guided.choices.copy(), shown.any(axis=-1)
        choices[due] = 0
        hidden = self._hidden[alive]
        choices[alive] = self._chooser.choose(shown[alive], hidden)
        self._hidden[due] = 0.0  # a robot that is shown nothing remembers nothing
        self._hidden[alive] = hidden
        self._guided.choose(choices)


def load(path: Path, scenario: Scenario) -> LearnedPolicy:
    """The policy of a checkpoint, of the newest one of a run, of a shipped folder, or of an ONNX
    file that ``rendezvous export`` wrote.

    Raises:
        CheckpointError: if it cannot be read or does not belong to this version, naming the file.
        ValueError: for robots that it cannot steer.
    """
    check_readable(scenario)
    if path.suffix == SUFFIX:
        network = OnnxNetwork(path)
        network.fit(network.settings.layout_of(scenario))
        return LearnedPolicy(scenario, network, network.settings)
    place = checkpoints.find(path)
    about, tables = checkpoints.read(place, ["network"])
    try:
        settings = PolicySettings.from_plain(about.get("policy"))
        return LearnedPolicy(scenario, tables["network"], settings)
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"{place}: is no policy of this version: {error}") from error
