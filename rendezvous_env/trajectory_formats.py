"""Trajectories in the formats of other libraries: pandas, xarray, Minari."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from .checks import load

if TYPE_CHECKING:
    import pandas
    import xarray
    from minari import MinariDataset

DIMENSIONS = {
    "positions": (("time", "env", "robot", "axis"), "m"),
    "headings": (("time", "env", "robot", "angle"), "rad"),
    "active": (("time", "env", "robot"), ""),
    "lyapunov": (("time", "env"), "m²/s"),
    "lyapunov_before_merge": (("step", "env"), "m²/s"),
    "lyapunov_after_merge": (("step", "env"), "m²/s"),
    "rewards": (("step", "env"), ""),
    "contacts": (("step", "env", "robot"), ""),
    "success": (("env",), ""),
    "rendezvous_time": (("env",), "s"),
    "obstacles": (("env", "obstacle", "column"), ""),
    "observations": (("time", "env", "robot", "row", "axis"), ""),
    "actions": (("step", "env", "robot", "action"), ""),
}
"""Dimensions and unit of every array of a trajectory."""
_EXTRA = "analysis"  # which libraries of these formats come with
_AXES = ("x", "y", "z")
_ANGLES = ("yaw", "pitch", "roll", "angle_3")  # as many as a robot model may keep


def xarray_dataset(trajectory: Any) -> xarray.Dataset:
    """An xarray Dataset with the arrays under their own names, shaped as ``DIMENSIONS`` says.

    Coordinates ``time`` (T + 1,), s, ``step`` (T,), from 0, and ``step_end`` (T,), s, when each
    step ended. By the indices of ``time`` and ``step``, ``xarray.concat([one, other], "run",
    join="outer")`` joins rollouts of different lengths; what the shorter one lacks is NaN. The
    attribute ``scenario`` holds the scenario as JSON. Arrays without an entry, as headings of
    robots that have none, are left out: NetCDF 3 cannot hold them. An ImportError says how to get
    xarray.
    """
    library = load("xarray", "to_xarray()", _EXTRA)
    scenario, times, arrays = trajectory.scenario, trajectory.times, _arrays(trajectory)
    coordinates: dict[str, Any] = {
        "time": ("time", times, {"units": "s"}),
        "step": np.arange(len(times) - 1),
        "step_end": ("step", times[1:], {"units": "s"}),
        "axis": list(_AXES[: scenario.dim]),
        "angle": list(_ANGLES[: arrays["headings"].shape[-1]]),
    }
    variables = {}
    for name, array in arrays.items():
        dimensions, unit = DIMENSIONS[name]
        variables[name] = (dimensions, array, {"units": unit} if unit else {})
    attributes = {"scenario": json.dumps(scenario.to_plain())}
    made = library.Dataset(variables, coordinates, attributes)
    return made.drop_dims([name for name, length in made.sizes.items() if length == 0])


def pandas_dataframe(trajectory: Any) -> pandas.DataFrame:
    """A pandas DataFrame with a row for each moment, team and robot.

    Index ``env``, ``robot``, ``step`` (0 is the start). Columns: ``time`` s; ``x``, ``y``, ``z`` m;
    ``yaw``, ``pitch``, and a custom model's ``roll``, ``angle_3``, rad; ``active``; ``lyapunov``
    m²/s, of the team; ``reward`` and ``contact`` of the step that led there, NaN and False at the
    start. An ImportError says how to get pandas.
    """
    library = load("pandas", "to_dataframe()", _EXTRA)
    arrays = _arrays(trajectory)
    positions, headings, rewards = (arrays[key] for key in ("positions", "headings", "rewards"))
    shape = positions.shape[:3]
    columns = {
        "time": trajectory.times[:, None, None],
        **{axis: positions[..., k] for k, axis in enumerate(_AXES[: positions.shape[-1]])},
        **{angle: headings[..., k] for k, angle in enumerate(_ANGLES[: headings.shape[-1]])},
        "active": arrays["active"],
        "lyapunov": arrays["lyapunov"][..., None],
        "reward": np.pad(rewards, ((1, 0), (0, 0)), constant_values=np.nan)[..., None],
        "contact": np.pad(arrays["contacts"], ((1, 0), (0, 0), (0, 0))),
    }
    steps, envs, robots = (index.ravel() for index in np.indices(shape))
    return library.DataFrame(
        {name: np.broadcast_to(column, shape).ravel() for name, column in columns.items()},
        index=library.MultiIndex.from_arrays([envs, robots, steps], names=["env", "robot", "step"]),
    ).sort_index()


def minari_dataset(trajectory: Any, name: str, **about: Any) -> MinariDataset:
    """Write an episode for each team, as one agent in ``gymnasium_env.RendezvousEnv`` lives it.

    Observations (T_b + 1, n, rows, d), actions (T_b, n, a), rewards of the team (T_b,). Terminated:
    all robots have met; truncated: the time limit. The steps of a team end with its episode. Infos:
    "active" (T_b + 1, n), which robots still existed on their own. ``recover_environment()`` of
    the data set makes an environment of the same scenario.

    Args:
        trajectory: one that kept observations and actions.
        name: of the data set, as Minari writes names: "rendezvous/ring-12-v0".
        about: further arguments of ``minari.create_dataset_from_buffers``, like ``author`` and
            ``algorithm_name``; Minari warns of those that it misses.

    Raises:
        ImportError: saying how to get Minari.
        ValueError: naming what was not recorded, or a name that is malformed or taken; nothing
            is written then.
    """
    minari = load("minari", "to_minari()", _EXTRA)
    load("h5py", "to_minari()", _EXTRA)
    from minari.data_collector import EpisodeBuffer

    recorded, scenario = trajectory.recorded, trajectory.scenario
    if missing := [part for part in ("observations", "actions") if part not in recorded]:
        raise ValueError(
            f"to_minari() needs {' and '.join(missing)}, which were not kept; ask for them: "
            'rollout(…, record="all")'
        )
    try:  # before Minari makes a folder of the name
        minari.dataset.minari_dataset.parse_dataset_id(name)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'name is {name!r}; it must be like "rendezvous/ring-12-v0": {error}'
        ) from error
    if name in minari.list_local_datasets():
        raise ValueError(f"name is {name!r}; it must be new: there is such a data set already")
    spec = EnvSpec(
        id="rendezvous/Rendezvous-v0",
        entry_point="rendezvous_env.envs.gymnasium_env:env_from_plain",
        kwargs={"scenario": scenario.to_plain()},
    )
    about = {
        "description": f"Teams of scenario {scenario.name!r}: bearings seen, actions taken",
        "env": spec,
        "eval_env": spec,
        **about,
    }
    episodes = []
    for team, success in enumerate(trajectory.success.tolist()):
        steps = int(trajectory.running[:, team].sum())
        last = np.arange(steps) == steps - 1
        episodes.append(
            EpisodeBuffer(
                id=team,
                observations=recorded["observations"][: steps + 1, team],
                actions=recorded["actions"][:steps, team],
                rewards=trajectory.rewards[:steps, team],
                terminations=last & success,
                truncations=last & (not success),
                infos={"active": trajectory.active[: steps + 1, team]},
            )
        )
    return minari.create_dataset_from_buffers(name, episodes, **about)


def _arrays(trajectory: Any) -> dict[str, NDArray[Any]]:
    """What is kept of every trajectory, and what was kept on request."""
    own = {name: array for name, array in vars(trajectory).items() if name in DIMENSIONS}
    return own | trajectory.recorded
