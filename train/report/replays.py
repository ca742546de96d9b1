"""Replays as the scripts of a page read them, whoever recorded them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rendezvous_env.scenario.scenario import Scenario

from ..figures.figures import ROBOT_COLOURS

PLAYER = ("world", "sight", "plots", "pane")
"""Scripts that draw; "replay" begins, once the tables are there."""


class Replay(NamedTuple):
    """An episode that can be shown."""

    scenario: str
    policy: str
    start: int
    shown: Mapping[str, Any]
    """Fields of ``encoding.Encoded``."""
    outcome: Mapping[str, str]
    """Cells of episodes.csv; the page needs success, clean, time and contacts."""


def elements(replays: Sequence[Replay]) -> str:
    """The recordings, in the order of ``player_data``."""
    return "\n".join(
        f'<script id="recording-{number}" type="application/gzip">{replay.shown["text"]}</script>'
        for number, replay in enumerate(replays)
    )


def player_data(replays: Sequence[Replay], scenarios: Mapping[str, Scenario]) -> dict[str, Any]:
    """What the player reads besides the recordings themselves; obstacles of a start once."""
    worlds = {(one.scenario, one.start): one.shown["obstacles"] for one in replays}
    places = {world: number for number, world in enumerate(worlds)}
    return {
        "scenarios": {name: _scenario(scenario) for name, scenario in scenarios.items()},
        "obstacles": list(worlds.values()),
        "recordings": [
            {key: one.shown[key] for key in ("fields", "stride", "extent")}
            | {"scenario": one.scenario, "policy": one.policy, "start": one.start}
            | {"obstacles": places[one.scenario, one.start], "outcome": one.outcome}
            for one in replays
        ],
        "robot_colours": ROBOT_COLOURS,
    }


def _scenario(scenario: Scenario) -> dict[str, Any]:
    layout = scenario.observation_layout
    return {
        "limit": scenario.max_steps * scenario.tau,
        "nonholonomic": scenario.model.nonholonomic,
        "exact": scenario.sensing.exact,
        "own_row": "gravity" if scenario.model.nonholonomic else "own velocity",
        "neighbour_slots": layout.neighbour_slots,
        "obstacle_slots": layout.obstacle_slots,
        "silhouette_points": layout.silhouette_points,
    }
