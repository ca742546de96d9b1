"""Trajectories as data sets of Minari, from which offline learners read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .trajectory_tables import library

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from minari import MinariDataset

    from .experiment.scenario import Scenario

_NEEDED = ("observations", "actions")


def dataset(trajectory: Mapping[str, Any], name: str, **about: Any) -> MinariDataset:
    """Write an episode for each team, as one agent in ``gymnasium_env.RendezvousEnv`` lives it.

    Observations (T_b + 1, n, rows, d), actions (T_b, n, a), rewards of the team (T_b,). Terminated:
    all robots have met; truncated: the time limit. The steps of a team end with its episode. Infos:
    "active" (T_b + 1, n), which robots still existed on their own. ``recover_environment()`` of
    the data set makes an environment of the same scenario.

    Args:
        trajectory: the fields of a Trajectory that kept observations and actions.
        name: of the data set, as Minari writes names: "rendezvous/ring-12-v0".
        about: further arguments of ``minari.create_dataset_from_buffers``, like ``author`` and
            ``algorithm_name``; Minari warns of those that it misses.

    Returns:
        The data set, on disk where Minari keeps its own.

    Raises:
        ImportError: if Minari is not installed, saying how to get it.
        ValueError: naming what was not recorded, or a name that is malformed or taken; nothing
            is written then.
    """
    minari = library("minari", "to_minari")
    library("h5py", "to_minari")
    recorded = trajectory["recorded"]
    if missing := [part for part in _NEEDED if part not in recorded]:
        raise ValueError(
            f"to_minari() needs {' and '.join(missing)}, which were not kept; ask for them: "
            'rollout(…, record="all")'
        )
    _check_name(minari, name)
    scenario = trajectory["scenario"]
    spec = environment_spec(scenario)
    about = {
        "description": f"Teams of scenario {scenario.name!r}: bearings seen, actions taken",
        "env": spec,
        "eval_env": spec,
        **about,
    }
    episodes = [_episode(trajectory, team) for team in range(len(trajectory["success"]))]
    made: MinariDataset = minari.create_dataset_from_buffers(name, episodes, **about)
    return made


def environment_spec(scenario: Scenario) -> EnvSpec:
    """What Gymnasium needs to make one team of a scenario, in plain data."""
    from gymnasium.envs.registration import EnvSpec

    return EnvSpec(
        id="rendezvous/Rendezvous-v0",
        entry_point="rendezvous_env.gymnasium_env:env_from_plain",
        kwargs={"scenario": scenario.to_plain()},
    )


def _episode(trajectory: Mapping[str, Any], team: int) -> Any:
    from minari.data_collector import EpisodeBuffer

    active, recorded = trajectory["active"][:, team], trajectory["recorded"]
    steps = int((active[:-1].sum(axis=-1) > 1).sum())
    last = np.arange(steps) == steps - 1
    success = bool(trajectory["success"][team])
    return EpisodeBuffer(
        id=team,
        observations=recorded["observations"][: steps + 1, team],
        actions=recorded["actions"][:steps, team],
        rewards=trajectory["rewards"][:steps, team],
        terminations=last & success,
        truncations=last & (not success),
        infos={"active": active[: steps + 1]},
    )


def _check_name(minari: Any, name: str) -> None:
    """Refuse a name before Minari makes a folder of it."""
    from minari.dataset.minari_dataset import parse_dataset_id

    try:
        parse_dataset_id(name)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'name is {name!r}; it must be like "rendezvous/ring-12-v0": {error}'
        ) from error
    if name in minari.list_local_datasets():
        raise ValueError(f"name is {name!r}; it must be new: there is such a data set already")
