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
    "obstacle_offsets": (("time", "env", "obstacle", "axis"), "m"),
    "observations": (("time", "env", "robot", "row", "axis"), ""),
    "actions": (("step", "env", "robot", "action"), ""),
}
"""Dimensions and unit of every array of a trajectory."""
_EXTRA = "analysis"  # extra that installs the libraries
_AXES = ("x", "y", "z")
_ANGLES = ("yaw", "pitch", "roll", "angle_3")  # as many as a robot model may have


def xarray_dataset(trajectory: Any) -> xarray.Dataset:
    """Convert to an xarray Dataset with the array names, shaped by ``DIMENSIONS``.

    Coordinates: ``time`` (T + 1,), s; ``step`` (T,), from 0; ``step_end`` (T,), s, the end time of
    each step. ``xarray.concat([one, other], "run", join="outer")`` joins rollouts of different
    lengths by the indices of ``time`` and ``step``. Missing values are NaN. The attribute
    ``scenario`` holds the scenario as JSON. Empty arrays, such as headings of robots without any,
    are omitted: NetCDF 3 does not support them.

    Raises:
        ImportError: if xarray is not installed, with the command to install it.
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
    """Convert to a pandas DataFrame with one row per time, environment and robot.

    Index ``env``, ``robot``, ``step`` (0 is the initial condition). Columns: ``time`` s; ``x``,
    ``y``, ``z`` m; ``yaw``, ``pitch``, and a custom model's ``roll``, ``angle_3``, rad; ``active``;
    ``lyapunov`` m²/s, of the environment. ``reward`` and ``contact`` are those of the preceding
    step, initially NaN and False.

    Raises:
        ImportError: if pandas is not installed, with the command to install it.
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
    """Write one episode per environment, for the agent of ``gymnasium_env.RendezvousEnv``.

    Observations (T_b + 1, n, rows, d), actions (T_b, n, a), team rewards (T_b,). Terminated: all
    robots have met; truncated: the time limit. The steps of an environment end with its episode.
    Infos: "active" (T_b + 1, n), the active robots. ``recover_environment()`` of the data set
    creates an environment of the same scenario.

    Args:
        trajectory: one with recorded observations and actions.
        name: name of the data set in Minari's format: "rendezvous/ring-12-v0".
        about: further arguments of ``minari.create_dataset_from_buffers``, such as ``author`` and
            ``algorithm_name``; Minari warns about missing ones.

    Raises:
        ImportError: if Minari is not installed, with the command to install it.
        ValueError: for missing recordings, or a name that is malformed or taken; nothing is
            written.
    """
    minari = load("minari", "to_minari()", _EXTRA)
    load("h5py", "to_minari()", _EXTRA)
    from minari.data_collector import EpisodeBuffer

    recorded, scenario = trajectory.recorded, trajectory.scenario
    if missing := [part for part in ("observations", "actions") if part not in recorded]:
        raise ValueError(
            f"to_minari() needs {' and '.join(missing)}, which were not recorded; request them: "
            'rollout(…, record="all")'
        )
    try:  # before Minari creates the folder
        minari.dataset.minari_dataset.parse_dataset_id(name)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'name is {name!r}; it must be like "rendezvous/ring-12-v0": {error}'
        ) from error
    if name in minari.list_local_datasets():
        raise ValueError(f"name is {name!r}; it must be new: this data set already exists")
    spec = EnvSpec(
        id="rendezvous/Rendezvous-v0",
        entry_point="rendezvous_env.envs.gymnasium_env:env_from_plain",
        kwargs={"scenario": scenario.to_plain()},
    )
    about = {
        "description": f"Episodes of scenario {scenario.name!r}: bearing observations and actions",
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
    """Arrays of every trajectory, and those recorded on request."""
    own = {name: array for name, array in vars(trajectory).items() if name in DIMENSIONS}
    if not trajectory.obstacle_offsets.size:
        del own["obstacle_offsets"]
    return own | trajectory.recorded
