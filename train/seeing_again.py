"""What robots saw in a recorded episode: kept where a sensor errs, else found again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.simulator import Simulator

from .recording import LINKS, Recording


def whole(recording: Recording, scenario: Scenario) -> Recording:
    """A recording with its observations.

    Raises:
        ValueError: if no episode of the scenario can have been recorded so.
    """
    if "observations" in recording:
        return recording
    return recording | {"observations": observations(recording, scenario)}


def observations(recording: Recording, scenario: Scenario) -> NDArray[np.float32]:
    """What an exact sensor shows in each frame, (T, n, rows, d): bit for bit what the robots saw.

    Each frame is the state of a team of its own, which the simulator looks at.

    Args:
        recording: of an episode, without its observations.
        scenario: of the episode.

    Raises:
        ValueError: naming an entry that no episode can have.
    """
    into = recording["merged_into"]
    frames = len(into)
    simulator = Simulator(scenario, frames)
    state = simulator.get_state()
    merged = (into[1:] != into[:-1]).any(axis=-1)
    row = np.concatenate([[0], np.cumsum(merged)])
    tables = {name: recording.get(name, np.zeros((0, 0))) for name in LINKS if name in state}
    for name, table in tables.items():
        if len(table) != row[-1] + 1:
            raise ValueError(f"{name} has {len(table)} rows; it must have {row[-1] + 1}")
    state |= {name: table[row] for name, table in tables.items()}
    state |= {
        "positions": recording["positions"],
        "memory": np.concatenate([recording["headings"], recording["velocities"]], axis=-1),
        "merged_into": into.astype(np.int64),
        "obstacles": np.broadcast_to(recording["obstacles"], state["obstacles"].shape),
        "episode": np.zeros(frames, dtype=np.int64),
        "status": np.where((into == np.arange(into.shape[1])).sum(axis=1) > 1, RUNNING, RENDEZVOUS),
    }
    if "frames" in state:
        state["frames"] = recording["frames"].reshape(state["frames"].shape)
    simulator.set_state(state)
    return simulator.observe()
