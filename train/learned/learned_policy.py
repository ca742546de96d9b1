"""A trained network as a policy: observations in, actions out, like the scripted ones."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.policy import within_limits
from rendezvous_env.experiment.scenario import Scenario

from . import checkpoints
from .checkpoints import CheckpointError
from .perception import check_readable
from .policy_settings import PolicySettings

if TYPE_CHECKING:
    from .networks import HeadingNetwork

__all__ = ["LearnedPolicy", "PolicySettings", "load", "ship"]

NAME = "learned"
PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""The policy called ``learned``, once it is there."""
_AT_ONCE = 1024
"""Robots whose actions are computed together; the rows of more do not fit the processor's cache."""


class LearnedPolicy:
    """A network's likeliest choice, made safe: theorem C, or D, holds whatever the weights.

    It chooses every ``decision_time``; guide and certified heading, or tank, follow what is seen in
    each step. Teams of any size and any number of obstacles; single integrators in the plane. The
    memory has the leading axes of the observations; other leading axes are other teams, and start
    anew.

    Args:
        scenario: whose robots it steers.
        network: for ``settings``.
        settings: of the network and of the guarantee.

    Raises:
        ValueError: for robots that it cannot steer.
    """

    def __init__(
        self, scenario: Scenario, network: HeadingNetwork, settings: PolicySettings
    ) -> None:
        check_readable(scenario)
        self.scenario, self.settings = scenario, settings
        self.min_alignment = settings.promised_margin
        self.decision_period = settings.decision_period(scenario)
        rows = scenario.observation_layout
        self._network = _for_slots(network, rows.neighbour_slots, rows.obstacle_slots, settings)
        self._leading: tuple[int, ...] | None = None

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, 2); see ``baselines.Policy``.

        Raises:
            ValueError: for observations of another shape than the scenario's.
        """
        n, rows = self.scenario.n_robots, self.scenario.observation_layout.shape
        seen = np.ascontiguousarray(observations, dtype=np.float32)
        if seen.shape[-3:] != (n, *rows):
            raise ValueError(
                f"observations have shape {seen.shape}; scenario {self.scenario.name!r} needs "
                f"(..., {n}, {rows[0]}, {rows[1]})"
            )
        if seen.shape[:-3] != self._leading:
            self._begin(seen.shape[:-3])
        teams = seen.reshape(-1, n, *rows)
        due = self._wait == 0
        if due.any():
            self._decide(teams, due)
        self._wait = np.where(due, self.decision_period, self._wait) - 1
        actions = within_limits(self._guided.act(teams).astype(np.float64), self.scenario)
        return actions.reshape(*seen.shape[:-2], 2)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the teams where ``mask`` is true, all if it is None."""
        if mask is None:
            self._leading = None
        elif self._leading is not None:
            which = np.broadcast_to(np.asarray(mask, dtype=bool), self._leading).reshape(-1)
            self._guided.forget(which)
            self._wait[which] = 0

    def _begin(self, leading: tuple[int, ...]) -> None:
        teams = math.prod(leading)
        self._guided = self.settings.make_teams(self.scenario, teams)
        self._wait = np.zeros(teams, dtype=np.int64)
        self._leading = leading

    def _decide(self, observations: NDArray[np.float32], due: NDArray[np.bool_]) -> None:
        """New choices for the teams that are due."""
        shown = self._guided.show(observations, due)
        choices, alive = self._guided.choices.copy(), shown.any(axis=-1)
        choices[due] = 0
        choices[alive] = self._choose(shown[alive])
        self._guided.choose(choices)

    def _choose(self, shown: NDArray[np.float32]) -> NDArray[np.int64]:
        """The likeliest choices (N,) for what N robots are shown."""
        import torch

        choices = np.empty(len(shown), dtype=np.int64)
        with torch.inference_mode():
            for first in range(0, len(shown), _AT_ONCE):
                some = torch.from_numpy(shown[first : first + _AT_ONCE])
                likeliest = self._network.get_distribution(some).mode()
                choices[first : first + _AT_ONCE] = likeliest.cpu().numpy()
        return choices


def _for_slots(
    network: HeadingNetwork, neighbours: int, obstacles: int, settings: PolicySettings
) -> HeadingNetwork:
    """The same weights in a network for other numbers of slots."""
    own = settings.make_network(settings.layout(neighbours, obstacles))
    own.load_state_dict(network.state_dict())
    own.set_training_mode(False)
    return own


def load(path: Path, scenario: Scenario) -> LearnedPolicy:
    """The policy of a checkpoint, of the newest one of a run, or of the pretrained folder.

    Raises:
        CheckpointError: if it cannot be read or does not belong to this version, naming the file.
        ValueError: for robots that it cannot steer, or if torch is missing.
    """
    check_readable(scenario)
    require_torch()
    import torch

    place = checkpoints.find(path)
    about, tables = checkpoints.read(place, ["network"])
    try:
        settings = PolicySettings.from_plain(about.get("policy"))
        network = settings.make_network(settings.layout(1, 1))
        weights = {name: torch.from_numpy(value) for name, value in tables["network"].items()}
        network.load_state_dict(weights)
    except (TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{place}: is no policy of this version: {error}") from error
    return LearnedPolicy(scenario, network, settings)


def ship(run: Path, folder: Path) -> None:
    """Write what others need of a run: weights, settings, and the tables that tell how it went.

    Args:
        run: folder of the run, or of one of its checkpoints.
        folder: where it goes; what stands there is replaced.

    Raises:
        CheckpointError: if the run cannot be read.
    """
    place = checkpoints.find(run)
    about, tables = checkpoints.read(place, ["network"])
    checkpoints.write_folder(folder, about, tables)
    for name in ("metrics.csv", "evaluation.csv"):
        shutil.copyfile(place.parent.parent / name, folder / name)


def require_torch() -> None:
    """Refuse to go on without the ``train`` extra.

    Raises:
        ValueError: saying how to install it.
    """
    if reason := missing_extra():
        raise ValueError(f"{reason}; pip install 'rendezvous-env[train]'")


def missing_extra() -> str | None:
    """Which package of the ``train`` extra is not installed, in words; None if all are."""
    from importlib.util import find_spec

    for package in ("torch", "stable_baselines3", "safetensors"):
        if find_spec(package) is None:
            return f"learned policies need {package}"
    return None
