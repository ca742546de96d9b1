"""``rendezvous reproduce``: figures of the paper and studies of this project.

Figures 3 and 4 of the paper; collision-free success over margin and budget of an energy tank; time
bounds against measured times; policies with cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional

from rendezvous_env import baselines
from rendezvous_env.checks import counted
from rendezvous_env.safety.theorems.certificate import certificate
from rendezvous_env.scenario import scenarios
from rendezvous_env.trajectory import Trajectory, rollout

from .. import policies, results
from ..checks import Bounds, Flags, check_installed, check_unused
from ..console import Console
from ..recording import Recording
from . import bounds, path_figures, style
from .figures import BLUE, VERMILLION
from .style import PAGE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LAWS = {"fig3": "bearing-only", "fig4": "tangent-merged"}
"""Figure 3: law (1) through the obstacles. Figure 4: law (4) around them."""

_JUMPS = ("lyapunov_before_merge", "lyapunov_after_merge")

TANK_SCENARIO, TANK_POLICY = "clutter-24", "tank-merged"
MARGINS = (0.05, 0.1, 0.2, 0.4, 0.8)
BUDGETS = (0.0, 20.0)
"""Energy budgets, m²/s."""
_TANK_COLOURS = (BLUE, VERMILLION)

EXAMPLES = (
    "fig3", "fig4 --policy learned", "tank --episodes 1000", "bounds", "pixels --episodes 50",
)  # fmt: skip


_COMPILING = "the first use on a machine compiles …"


@dataclass(frozen=True)
class Config(Flags):
    """Reproduce a figure of the paper or a study of this project.

    The paper gives no coordinates, so initial positions and obstacles are this project's choice.
    """

    figure: Positional[Literal["fig3", "fig4", "tank", "bounds", "pixels"]]
    """Figure to make. fig3: paths and V(t) of law (1), obstacles ignored. fig4: paths and V(t) of
    law (4) around the obstacles. tank: tank-merged among 24 discs over margins and budgets. bounds:
    table of measured times and time bounds under every guarantee. pixels: success from camera
    images and the prediction of Sensing.camera()."""
    policy: str | None = None
    """Policy of fig3, fig4 or pixels. Default: bearing-only, tangent-merged, or four policies."""
    out: Path = Path("out/reproduce")
    """Folder for the figure and its data."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of the local frames (fig3, fig4), or of the first initial condition."""
    episodes: Annotated[int, Bounds(1, 10**6)] = 256
    """Number of initial conditions per point (tank), row (bounds) or policy (pixels)."""
    page: Path | None = None
    """Markdown page in which the table of bounds replaces the one with the same header."""


def run(config: Config) -> int:
    """Simulate, draw, and write FIGURE.png, FIGURE.pdf, FIGURE.npz and FIGURE.csv."""
    unused = {} if config.figure == "bounds" else {"page": f"{config.figure} has no table"}
    if shown := {"tank": TANK_POLICY, "bounds": "random choices"}.get(config.figure):
        unused["policy"] = f"{config.figure} shows {shown} alone"
    check_unused(config, unused)
    own = {"tank": _tank, "bounds": _bounds, "pixels": _pixels}
    return own.get(config.figure, _paper)(config)


def _save(figure: Figure, path: Path) -> None:
    for ending in (".png", ".pdf"):
        style.save(figure, path.with_suffix(ending))


def _paper(config: Config) -> int:
    """Make figure 3 or 4."""
    scenario = scenarios.get(config.figure)
    name = config.policy or _LAWS[config.figure]
    policy = policies.tried(name, scenario)
    path, console = results.prepare_folder(config.out) / f"{config.figure}.png", Console()
    with console.status(f"simulating; {_COMPILING}"):
        trajectory = rollout(scenario, policy, config.seed, record="observations")
    recording = one_team(trajectory)
    results.write_arrays(path.with_suffix(".npz"), recording)
    table = _table_of(recording)
    results.write_csv(path.with_suffix(".csv"), table)
    _save(path_figures.team_figure(scenario, recording, name), path)
    end = f"met after {recording['times'][-1]:.2f} s" if trajectory.success[0] else "did not meet"
    (rise,) = trajectory.largest_rise_between_merges
    console.print(f"{config.figure}, {name}: {end}; largest change of V in a step {rise:.2g} m²/s")
    console.print(f"picture and data: {path}, .pdf, .npz and .csv")
    return 0


def one_team(trajectory: Trajectory) -> Recording:
    """The first environment of a rollout, every step a frame."""
    return path_figures.recording_of(trajectory)


def _table_of(recording: Recording) -> list[dict[str, Any]]:
    """Rows of the CSV file, one per frame: s, m²/s (empty without a merge), m."""
    positions = recording["positions"]
    places = [f"{axis}_{robot}" for robot in range(positions.shape[1]) for axis in ("x", "y")]
    columns = ["time", "robots", "lyapunov", *_JUMPS, *places]
    numbers = (recording[name] for name in ("lyapunov", *_JUMPS))
    first = recording["times"], recording["active"].sum(axis=1)
    table = np.column_stack([*first, *numbers, positions.reshape(len(positions), -1)])
    return [dict(zip(columns, row, strict=True)) for row in table.tolist()]


def _bounds(config: Config) -> int:
    """Simulate, print the table, and write bounds.csv and the page."""
    path, console = results.prepare_folder(config.out) / "bounds.csv", Console()
    with console.status(f"playing; {_COMPILING}"):
        rows = list(bounds.measure(bounds.ROWS, config.episodes, config.seed))
    results.write_csv(path, rows)
    table = bounds.table_of(rows)
    if config.page is not None:
        bounds.write_into(config.page, table)
    console.print("\n".join(table), soft_wrap=True)
    console.print(f"data: {path}")
    return 0


def _pixels(config: Config) -> int:
    """Simulate, print, and write pixels.csv."""
    check_installed("reproduce pixels", "mujoco", "mujoco")
    from ..pixels import pixels

    path, console = results.prepare_folder(config.out) / "pixels.csv", Console()
    names, rows = [config.policy] if config.policy else pixels.POLICIES, []
    policies.check_names(names)
    for name in names:
        with console.status(f"{name} looks; {_COMPILING}"):
            rows.append(row := pixels.compare(name, config.episodes, config.seed))
        console.print(
            f"{name}: {row['collision_free']:.1%} [{row['low']:.1%}, {row['high']:.1%}] "
            f"collision-free from pixels, {row['predicted']:.1%} by Sensing.camera(), "
            f"{row['exact']:.1%} exact; "
            f"{row['steps_per_core_second']:.0f} steps per core second",
            soft_wrap=True,
        )
    results.write_csv(path, rows)
    console.print(f"data: {path}")
    return 0


def _tank(config: Config) -> int:
    """Simulate, draw, and write tank.png, tank.pdf and tank.csv."""
    path, console = results.prepare_folder(config.out) / "tank.png", Console()
    with console.status(f"playing; {_COMPILING}"):
        rows = list(measure_tanks(config.episodes, config.seed))
    results.write_csv(path.with_suffix(".csv"), rows)
    _save(tank_tradeoff_figure(rows), path)
    for row in rows:
        console.print(
            f"B = {row['budget']:g} m²/s, ε = {row['min_alignment']:g}: "
            f"{row['collision_free_success']:.1%} without a contact; theorem D: "
            f"{row['bound']:.4g} s"
        )
    console.print(f"picture and data: {path}, .pdf and .csv")
    return 0


def measure_tanks(episodes: int, seed: int) -> Iterator[dict[str, Any]]:
    """One row per budget and margin, from the same initial conditions starting at a seed."""
    scenario = scenarios.get(TANK_SCENARIO)
    free = scenario.replace(obstacles=())  # theorem D assumes no obstacles
    for budget, margin in product(BUDGETS, MARGINS):
        options = {"budget": budget, "min_alignment": margin}
        policy = baselines.make(TANK_POLICY, scenario, **options)
        found = rollout(scenario, policy, seed=seed, num_envs=episodes, record=())
        touched = found.contacts.any(axis=(0, 2))
        yield {
            **options,
            "episodes": episodes,
            "collision_free_success": float((found.success & ~touched).mean()),
            "success": float(found.success.mean()),
            "contact": float(touched.mean()),
            "bound": certificate(free, margin, by="tank", budget=budget).time_bound,
        }


@styled
def tank_tradeoff_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Collision-free success and time bound against ε, one line per budget."""
    figure = new_figure(PAGE, 2.6)
    left, right = figure.subplots(1, 2)
    for budget, colour in zip(BUDGETS, _TANK_COLOURS, strict=True):
        line = [row for row in rows if row["budget"] == budget]
        margins = [row["min_alignment"] for row in line]
        style_of = {"marker": "o", "color": colour, "label": f"B = {budget:g} m²/s"}
        left.plot(margins, [100 * row["collision_free_success"] for row in line], **style_of)
        right.plot(margins, [row["bound"] for row in line], **style_of)
    starts = rows[0]["episodes"]
    left.set(ylim=(0, 103), ylabel="collision-free success (%)")
    left.set(title=f"measured: {TANK_SCENARIO}, {counted(starts, 'episode')}")
    right.set(yscale="log", ylabel="time bound (s)")
    right.yaxis.set_major_formatter("{x:,.0f}")
    right.set(title="certified (Theorem D), without obstacles")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="minimum alignment ε")
        axes.set_xticks(MARGINS, [f"{margin:g}" for margin in MARGINS])
        axes.minorticks_off()
        axes.grid()
    left.legend(loc="lower left")
    return figure
