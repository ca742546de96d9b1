"""A trained network as a policy: observations in, actions out, like the scripted ones."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.policy import within_limits
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.guarantee.steering import Steering

from ..checks import check_types
from . import checkpoints, perception_layout
from .checkpoints import CheckpointError
from .guide import Guide
from .guided import GuidedTeams
from .perception import check_readable
from .perception_layout import PerceptionLayout

if TYPE_CHECKING:
    from .networks import HeadingNetwork

NAME = "learned"
PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""The policy called ``learned``, once it is there."""
_AT_ONCE = 1024
"""Robots whose actions are computed together; the rows of more do not fit the processor's cache."""


@dataclass(frozen=True)
class PolicySettings:
    """All that a policy is, beside its weights."""

    set_width: int
    """Of the networks that read one row."""
    hidden: tuple[int, ...]
    """Widths of the layers behind them."""
    clearance: float
    """Of the guide, rad."""
    persistence: float
    """Of the guide."""
    min_alignment: float
    """ε, which the certified heading keeps."""
    max_turn_rate: float
    """Of the heading, rad/s."""
    decision_time: float
    """s between decisions."""

    def __post_init__(self) -> None:
        """Refuse what no network and no heading can have."""
        check_types(vars(self), get_type_hints(type(self)))
        ranges = {
            "set_width": (1, 2**12), "clearance": (0.0, math.pi), "persistence": (0.0, 1e9),
            "min_alignment": (1e-9, 1.0), "max_turn_rate": (1e-9, 1e9),
            "decision_time": (1e-9, 1e9),
        }  # fmt: skip
        for name, (least, most) in ranges.items():
            if not least <= getattr(self, name) <= most:
                raise ValueError(
                    f"{name} is {getattr(self, name)}; it must be in [{least}, {most}]"
                )
        if not all(1 <= width <= 2**12 for width in self.hidden):
            raise ValueError(f"hidden is {self.hidden}; each must be in [1, {2**12}]")

    def to_plain(self) -> dict[str, Any]:
        """As plain data, with the version of the perception that the weights belong to."""
        return asdict(self) | {"perception": perception_layout.VERSION}

    @classmethod
    def from_plain(cls, plain: Any) -> PolicySettings:
        """What ``to_plain`` gave.

        Raises:
            ValueError: for missing or unknown fields, or another perception.
        """
        if not isinstance(plain, Mapping) or plain.get("perception") != perception_layout.VERSION:
            version = plain.get("perception") if isinstance(plain, Mapping) else plain
            raise ValueError(
                f"perception is {version!r}; this version has {perception_layout.VERSION}"
            )
        given = {key: value for key, value in plain.items() if key != "perception"}
        if wrong := sorted(set(given) ^ set(cls.__dataclass_fields__)):
            raise ValueError(f"field {wrong[0]!r} is missing or unknown")
        check_types(given, {"hidden": list[int] | tuple[int, ...]})
        return cls(**given | {"hidden": tuple(given["hidden"])})

    def decision_period(self, scenario: Scenario) -> int:
        """Base steps between decisions in a scenario; 1 where a step is longer."""
        return max(1, round(self.decision_time / scenario.tau))

    def make_network(self, layout: PerceptionLayout) -> HeadingNetwork:
        """An untrained network for that many slots."""
        from .networks import make_network

        return make_network(layout, set_width=self.set_width, hidden=self.hidden)

    def make_guide(self, scenario: Scenario) -> Guide:
        """What turns its choices into headings."""
        return Guide(scenario, clearance=self.clearance, persistence=self.persistence)


class LearnedPolicy:
    """A network's likeliest choice, certified: theorem C holds whatever the weights.

    It chooses every ``decision_time``; guide and certified heading follow what is seen in each
    step. Teams of any size and
    any number of obstacles; single integrators in the plane. The memory has the leading axes of the
    observations; other leading axes are other teams, and start anew.

    Args:
        scenario: whose robots it steers.
        network: for ``settings``.
        settings: of the network and of the certified heading.

    Raises:
        ValueError: for robots that it cannot steer.
    """

    def __init__(
        self, scenario: Scenario, network: HeadingNetwork, settings: PolicySettings
    ) -> None:
        check_readable(scenario)
        self.scenario, self.settings = scenario, settings
        self.min_alignment = settings.min_alignment
        self.decision_period = settings.decision_period(scenario)
        rows = scenario.observation_layout
        self._network = _for_slots(network, rows.neighbour_slots, rows.obstacle_slots, settings)
        self._guide = settings.make_guide(scenario)
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
        settings, teams = self.settings, math.prod(leading)
        steering = Steering(
            self.scenario,
            teams,
            min_alignment=settings.min_alignment,
            max_turn_rate=settings.max_turn_rate,
            frame="local",
        )
        self._guided = GuidedTeams(steering, self._guide, decision_period=self.decision_period)
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
    own = settings.make_network(PerceptionLayout(neighbours, obstacles))
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
        network = settings.make_network(PerceptionLayout(1, 1))
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
