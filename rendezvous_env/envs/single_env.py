"""What environments of one team have in common, and those that are vector environments of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..render.renderer import Renderer
from ..scenario.scenario import Scenario
from ..simulator import Simulator


class Drawn:
    """An environment of one team that a renderer draws."""

    renderer: Renderer

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, (600, 600, 3) uint8, in "rgb_array" mode; in "human" mode it is shown.

        Raises:
            RuntimeError: before the first reset, or where no window can be opened.
            ImportError: without the extra ``render``.
        """
        return self.renderer.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


class OneOfTeams(Drawn):
    """A vector environment with B = 1, wrapped or not, as an environment of one team."""

    teams: Any
    metadata: dict[str, Any]

    def _take_up(self, teams: Any) -> None:
        self.teams, base = teams, teams.unwrapped
        self.simulator: Simulator = base.simulator
        """The global state, B = 1, for analysis."""
        self.scenario: Scenario = base.scenario
        self.renderer, self.render_mode = base.renderer, base.render_mode
        told = {key: value for key, value in teams.metadata.items() if key != "autoreset_mode"}
        self.metadata = self.metadata | told

    def state(self) -> NDArray[np.float32]:
        """The privileged global state, one float32 vector, as ``rendezvous_v0`` gives it."""
        state: NDArray[np.float32] = self.teams.state()[0]
        return state

    def get_state(self) -> dict[str, Any]:
        """The running episode and all memory, as copies; ``set_state`` puts it back."""
        state: dict[str, Any] = self.teams.get_state()
        return state

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``Simulator.set_state``."""
        self.teams.set_state(state)
