"""An HTML page with replays of the environments of one rollout."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Trajectory
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import run

from ..compare.evaluation import alignments
from ..encoding import encode_all
from ..recording import EpisodeRecorder, Recording, state_of
from ..results import write_text
from .skeleton import PLAYER, Replay, assemble, elements, part, player_data, terms

_REMEDY = 'record its actions: rollout(…, record="actions")'


def write(trajectory: Trajectory, path: Path, envs: int = 8) -> Path:
    """Write the page of the first environments of a rollout; errors as ``Trajectory.to_report``."""
    write_text(path, page(trajectory, envs))
    return path


def page(trajectory: Trajectory, envs: int = 8) -> str:
    """The page as HTML."""
    scenario, policy = trajectory.scenario, trajectory.policy or "policy"
    rows = trajectory.summary().rows[:envs]
    encoded = encode_all(recordings_of(trajectory, len(rows)))
    shown = [
        Replay(scenario.name, policy, row["env"], vars(one), _outcome(row))
        for row, one in zip(rows, encoded, strict=True)
    ]
    name, count = escape(scenario.name), trajectory.num_envs
    lines = {
        "Scenario": f"{scenario.name}: {scenario.n_robots} robots, {scenario.model.name}",
        "Policy": policy,
        "Environments": f"{len(rows)} of {count}; robots and rows as recorded when the rollout "
        "was simulated again, with equal positions",
    }
    sections = (
        f'<section id="replay" aria-labelledby="replay-title"><h2 id="replay-title">{name} under '
        f"{escape(policy)}</h2>{part('replay.html')}</section>"
        f'<section id="results" aria-labelledby="results-title"><h2 id="results-title">Results</h2>'
        f'<div class="scroll">{trajectory.summary().to_html()}</div></section>'
        f'<section id="run" aria-labelledby="run-title"><h2 id="run-title">About this run</h2>'
        f"{terms(lines)}</section>"
    )
    result = {"scenario": scenario.name, "policy": policy, "episodes": str(count)}
    share = {"success": str(float(trajectory.success.mean())), "collision_free_success": ""}
    data = player_data(shown, {scenario.name: scenario}) | {
        "run": {},
        "rankings": [],
        "leaders": [],
        "results": [result | share],
    }
    scripts = ("data", "choice", "save", *PLAYER, "tables", "replay")
    title, links = f"Rendezvous: {scenario.name}", ("Replay", "Results", "About")
    return assemble(title, links, sections, data, scripts, recordings=elements(shown))


def _outcome(row: dict[str, Any]) -> dict[str, str]:
    met = row["outcome"] == "met"
    return {
        "success": str(int(met)),
        "collision_free": str(int(met and row["collision_free"])),
        "time": str(row["time"]),
        "path_length": str(row["path_length"]),
        "contacts": str(row["contacts"]),
        "clearance": "",
        "min_alignment": "",
    }


def recordings_of(trajectory: Trajectory, envs: int) -> list[Recording]:
    """Recordings of the first environments of a rollout, which is simulated again.

    A ValueError if the result differs.
    """
    if not trajectory.start:
        raise ValueError(
            f"this trajectory has no initial condition to simulate it again; {_REMEDY}"
        )
    simulator = Simulator(trajectory.scenario, trajectory.num_envs)
    simulator.set_state(trajectory.start)
    seen = simulator.observe()
    recorders = [EpisodeRecorder(simulator, env, seen, exact=False) for env in range(envs)]
    for number, step in enumerate(run(simulator, _policy_of(trajectory), seen), start=1):
        same = number < len(trajectory.times) and np.array_equal(
            simulator.positions, trajectory.positions[number]
        )
        if not same:
            raise ValueError(
                f"policy {trajectory.policy!r} chose other actions in step {number} when the "
                f"rollout was simulated again; {_REMEDY}"
            )
        aligned, after = alignments(trajectory.scenario, step), state_of(simulator)
        for recorder in recorders:
            recorder.see(step, aligned, after)
    return [recorder.finish() for recorder in recorders]


def _policy_of(trajectory: Trajectory) -> Any:
    """The policy of a rollout, or one that repeats its recorded actions."""
    if "actions" in trajectory.recorded:
        chosen = iter(trajectory.actions)

        def repeat(observations: NDArray[Any], time: NDArray[np.float64]) -> NDArray[Any]:
            return next(chosen)

        return repeat
    if trajectory.played_by is None:
        raise ValueError(f"the policy of this trajectory is not available; {_REMEDY}")
    return trajectory.played_by
