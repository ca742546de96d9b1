"""A trained network as a policy: observations in, actions out, like the scripted ones."""

import os
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from ..filtered_policies import DecidingPolicy
from ..policy import AT_PATH, Float32, Mask, register_reader, within_limits
from ..steering import check_steerable
from . import checkpoints
from .guide import GuidedTeams
from .numpy_actor import Network, NumpyActor
from .onnx_network import SUFFIX, OnnxNetwork
from .policy_settings import PolicySettings

__all__ = ["LearnedPolicy", "PolicySettings", "load"]


class GuidedPolicy(DecidingPolicy):
    """Guided teams that something chooses for."""

    _guided: GuidedTeams

    def __init__(self, scenario: Scenario, settings: PolicySettings) -> None:
        super().__init__(scenario, settings.decision_period(scenario))
        self.settings = settings

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``: certified headings or a tank, whatever is chosen."""
        settings, margin = self.settings, {"min_alignment": self.settings.min_alignment}
        if settings.guarantee == "heading":
            return {"by": "heading", "max_turn_rate": settings.max_turn_rate} | margin
        budget = settings.budget_of(self.scenario)
        return {"by": "tank", "budget": budget, "observes_merges": False} | margin

    @abstractmethod
    def _choose(self, shown: Float32, due: Mask) -> None:
        """Choose for the teams that are due, (B,), by what they are shown, (B, n, size)."""

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``RealTimePolicy.after``."""
        return self._after(elapsed, observations)

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._guided = GuidedTeams(self.settings, self.scenario, teams)

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._guided.forget(which)

    def _settle(self, share: float) -> None:
        self._guided.settle(share)

    def _decide(self, teams: Float32, due: Mask) -> None:
        steps = np.where(np.isinf(self._steps), self.decision_period, self._steps)
        shown = np.zeros((*teams.shape[:2], self._guided.perception.layout.size), np.float32)
        self._choose(self._guided.show(shown, teams, due, steps * self.scenario.tau), due)

    def _act(self, teams: Float32, elapsed: float) -> Float32:
        return within_limits(
            self._guided.apply(teams, elapsed=elapsed).astype(np.float64), self.scenario
        )


class LearnedPolicy(GuidedPolicy):
    """A network's greedy choice, made safe: theorem C, or D, holds whatever the weights; of
    robots that turn theorem T, or that V + ΣA does not rise.

    It chooses every ``decision_time``, for teams of any size, any number of obstacles, and any
    robots but double integrators. ``weights`` are the network's by name, as a checkpoint has them,
    or a network; a ValueError names robots that it cannot steer, or weights that do not fit.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        weights: Mapping[str, NDArray[Any]] | Network,
        settings: PolicySettings,
    ) -> None:
        scenario = resolve(scenario)
        check_steerable(scenario)
        super().__init__(scenario, settings)
        turns = scenario.model.nonholonomic  # its body may stand across f when it starts
        self.min_alignment = None if turns else settings.promised_margin
        if isinstance(weights, Network):
            self._chooser = weights
        else:
            self._chooser = NumpyActor(weights, settings, settings.layout_of(scenario))

    @property
    def levels(self) -> NDArray[np.float64] | None:
        """Of the tanks, (..., n), m²/s; None without tanks or before the first action."""
        if self._leading is None or self._guided.tank is None:
            return None
        return self._as_given(self._guided.tank.levels)

    def _start(self, teams: int) -> None:
        super()._start(teams)
        remembered = (teams, self.scenario.n_robots, self.settings.units)
        self._hidden = np.zeros(remembered, dtype=np.float32)

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._hidden[which] = 0.0

    def _choose(self, shown: Float32, due: Mask) -> None:
        choices, alive = self._guided.choices.copy(), shown.any(axis=-1)
        choices[due] = 0
        hidden = self._hidden[alive]
        choices[alive] = self._chooser.choose(shown[alive], hidden)
        self._hidden[due] = 0.0  # a robot that is shown nothing remembers nothing
        self._hidden[alive] = hidden
        self._guided.choose(choices)


def load(path: str | os.PathLike[str], scenario: ScenarioLike) -> LearnedPolicy:
    """The policy of a checkpoint, of the newest one of a run, of a shipped folder, or of an ONNX
    file that ``rendezvous export`` wrote. A CheckpointError names the file that cannot be read or
    does not belong to this version, a ValueError robots that it cannot steer.
    """
    path, scenario = checkpoints.as_path(path), resolve(scenario)
    check_steerable(scenario)
    if path.suffix.lower() == SUFFIX:
        network = OnnxNetwork(path)
        network.layout = network.settings.layout_of(scenario)
        return LearnedPolicy(scenario, network, network.settings)
    place = checkpoints.find(path)
    about, tables = checkpoints.read(place, ["network"])
    with checkpoints.refusing(place, "is no policy of this version"):
        settings = PolicySettings.from_plain(about.get("policy"))
        return LearnedPolicy(scenario, tables["network"], settings)


register_reader(AT_PATH, load)
