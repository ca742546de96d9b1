"""Policies from trained networks, with the interface of scripted policies."""

import os
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from ..filtered_policies import DecidingPolicy
from ..policy import Float32, Mask, within_limits
from ..search.direct_control import check_searches
from ..steering import check_steerable
from . import checkpoints
from .base_controller import Controller, make_controller
from .numpy_actor import Network, NumpyActor
from .onnx_network import SUFFIX, OnnxNetwork
from .policy_settings import PolicySettings

__all__ = ["LearnedPolicy", "PolicySettings", "load"]


class ControllerPolicy(DecidingPolicy):
    """Base class of policies that choose for a base controller."""

    _controller: Controller

    def __init__(self, scenario: Scenario, settings: PolicySettings) -> None:
        super().__init__(scenario, settings.decision_period(scenario))
        self.settings = settings

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: certified headings or a tank, for any choice; else None."""
        settings, margin = self.settings, {"min_alignment": self.settings.min_alignment}
        if settings.guarantee == "none":
            return None
        if settings.guarantee == "heading":
            return {"by": "heading", "max_turn_rate": settings.max_turn_rate} | margin
        budget = settings.budget_of(self.scenario)
        return {"by": "tank", "budget": budget, "observes_merges": False} | margin

    @abstractmethod
    def _choose(self, shown: Float32, due: Mask) -> None:
        """Update choices of due environments, (B,), from features, (B, n, size)."""

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``RealTimePolicy.after``."""
        return self._after(elapsed, observations)

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._controller = make_controller(self.settings, self.scenario, teams)

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._controller.forget(which)

    def _settle(self, share: float) -> None:
        self._controller.settle(share)

    def _decide(self, teams: Float32, due: Mask) -> None:
        steps = np.where(np.isinf(self._steps), self.decision_period, self._steps)
        shown = np.zeros((*teams.shape[:2], self._controller.perception.layout.size), np.float32)
        self._choose(self._controller.show(shown, teams, due, steps * self.scenario.tau), due)

    def _act(self, teams: Float32, elapsed: float) -> Float32:
        return within_limits(
            self._controller.apply(teams, elapsed=elapsed).astype(np.float64), self.scenario
        )


class LearnedPolicy(ControllerPolicy):
    """Greedy choices of a network under a guarantee that holds for any weights.

    The guarantee is theorem C or D; for nonholonomic robots it is theorem T, or that V + ΣA does
    not increase. Without a filter there is none, and robots are unicycles. The policy chooses every
    ``decision_time``. It supports any number of robots and obstacles, and all robot models except
    double integrators. ``weights`` are the network's arrays by name, as in a checkpoint, or a
    network. A ValueError names an unsupported robot model or weights that do not fit.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        weights: Mapping[str, NDArray[Any]] | Network,
        settings: PolicySettings,
    ) -> None:
        scenario = resolve(scenario)
        check_steerable(scenario)
        if settings.guarantee == "none":
            check_searches(scenario)
        super().__init__(scenario, settings)
        turns = scenario.model.nonholonomic  # the body may be across f initially
        self.min_alignment = None if turns else settings.promised_margin
        if isinstance(weights, Network):
            self._chooser = weights
        else:
            self._chooser = NumpyActor(weights, settings, settings.layout_of(scenario))

    @property
    def levels(self) -> NDArray[np.float64] | None:
        """Stored energies, (..., n), m²/s; None without tanks or before the first action."""
        if self._leading is None or self._controller.tank is None:
            return None
        return self._as_given(self._controller.tank.levels)

    def _start(self, teams: int) -> None:
        super()._start(teams)
        remembered = (teams, self.scenario.n_robots, self.settings.units)
        self._hidden = np.zeros(remembered, dtype=np.float32)

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._hidden[which] = 0.0

    def _choose(self, shown: Float32, due: Mask) -> None:
        choices, alive = self._controller.choices.copy(), shown.any(axis=-1)
        choices[due] = 0
        hidden = self._hidden[alive]
        choices[alive] = self._chooser.choose(shown[alive], hidden)
        self._hidden[due] = 0.0  # inactive robots have no memory
        self._hidden[alive] = hidden
        self._controller.choose(choices)


def load(path: str | os.PathLike[str], scenario: ScenarioLike) -> LearnedPolicy:
    """Load a policy from a checkpoint, a run's newest one, a shipped folder or an ONNX file.

    The ONNX file is one written by ``rendezvous export``. A CheckpointError names the file that
    cannot be read or belongs to another version. A ValueError names an unsupported robot model.
    """
    path, scenario = checkpoints.as_path(path), resolve(scenario)
    check_steerable(scenario)
    if path.suffix.lower() == SUFFIX:
        network = OnnxNetwork(path)
        network.layout = network.settings.layout_of(scenario)
        return LearnedPolicy(scenario, network, network.settings)
    place = checkpoints.find(path)
    about, tables = checkpoints.read(place, ["network"])
    with checkpoints.refusing(place, "is not a policy of this version"):
        settings = PolicySettings.from_plain(about.get("policy"))
        return LearnedPolicy(scenario, tables["network"], settings)
