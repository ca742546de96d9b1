"""``rendezvous render``: one episode as a video or as a figure."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, repeat
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from tyro.conf import arg

from rendezvous_env.render.palette import OBSTACLE, OBSTACLE_EDGE, ROBOTS, mixed
from rendezvous_env.render.renderer import Renderer
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Step, Trajectory, rollout
from rendezvous_env.trajectory import run as steps_of

from .. import policies
from ..checks import Bounds, Flags, UserError, check_installed, user_error
from ..console import Console
from ..results import atomic, prepare_folder
from . import path_figures, style
from .reproduce import one_team

STILLS = (".png", ".pdf")
_USUAL_LENGTH = 8.0  # s, default duration of a video
_LEAST_STEPS = 15  # steps per second of such a video; fewer would not look like motion
_LAST_PICTURE = 1.5  # s, time at the end of a video

Frame = NDArray[np.uint8]
"""Image array (height, width, 3); frames of a video have equal and even sizes."""

EXAMPLES = (
    "--scenario fig4",
    "--scenario trap --policy tangent-merged --out out/trap.mp4 --fps 30",
)


@dataclass(frozen=True)
class Config(Flags):
    """Render one episode as a video (.gif, .mp4) or a figure (.png, .pdf)."""

    scenario: Annotated[str, arg(aliases=("--scenarios",))] = "fig4"
    """Name of a scenario, or path of a TOML file."""
    policy: Annotated[str | None, arg(aliases=("--policies",))] = None
    """Name of a policy, including learned and learned:PATH. Default: the best policy that fits."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of the initial condition."""
    out: Path = Path("out/render.gif")
    """File to write; its extension selects the format: .gif, .mp4, .png or .pdf."""
    size: Annotated[int, Bounds(120, 4096)] = 600
    """Edge of a video frame, pixels; rounded to an even number."""
    fps: Annotated[int, Bounds(1, 100)] = 25
    """Frames per second of the video."""
    speed: Annotated[float | None, Bounds(1e-3, 1e3)] = None
    """Simulated seconds per second of video. Default: a video of 8 s, or shorter if the episode has
    few steps."""
    set: tuple[str, ...] = ()
    """Overrides of scenario fields, for example n_robots=9 time_limit=60."""


def run(config: Config) -> int:
    """Simulate, draw, and write the file."""
    scenario, name = _check(config)
    prepare_folder(config.out.parent)
    console = Console()
    with console.status("simulating; the first use on a machine compiles …"):
        policy = policies.make(name, scenario)
        trajectory = rollout(scenario, policy, config.seed)
    with user_error(f"--out {config.out}: cannot write there: ", OSError):
        if config.out.suffix.lower() in STILLS:
            figure = path_figures.team_figure(scenario, one_team(trajectory), name)
            style.save(figure, config.out)
        else:
            _write_video(config, name, trajectory, console)
    end = "met" if trajectory.success[0] else "did not meet, stopped"
    seconds = float(trajectory.times[-1])
    console.print(f"{scenario.name}, {name}: {end} after {seconds:.2f} s; {config.out}")
    return 0


def _check(config: Config) -> tuple[Scenario, str]:
    """Validate the settings; returns the scenario and the policy's name."""
    ending, known = config.out.suffix.lower(), (*VIDEOS, *STILLS)
    if ending not in known:
        raise UserError(
            f"--out {config.out}: unknown ending {ending!r}; known are {', '.join(known)}"
        )
    policies.check_names([config.policy] if config.policy else [])
    scenario = policies.resolve_scenario(config.scenario, config.set)
    name = config.policy or policies.best(scenario)
    policies.tried(name, scenario)
    if ending in VIDEOS:
        writer = "PIL" if ending == ".gif" else "imageio_ffmpeg"
        check_installed(f"--out {config.out}", "render", writer, "pygame")
    return scenario, name


def _write_video(config: Config, name: str, trajectory: Trajectory, console: Console) -> None:
    """Repeat the episode with a renderer."""
    length, steps = float(trajectory.times[-1]), len(trajectory.times) - 1
    fps = video_rate(config.out, config.fps)
    speed = config.speed or length / min(_USUAL_LENGTH, steps / _LEAST_STEPS)
    policy, edge = policies.make(name, trajectory.scenario), 2 * (config.size // 2)
    simulator = Simulator(trajectory.scenario)
    states = steps_of(simulator, policy, simulator.reset(config.seed))
    renderer = Renderer(simulator, "rgb_array", (edge, edge), horizon=length)
    renderer.policy = name
    pictures = _pictures(renderer, simulator, states, speed / fps, round(_LAST_PICTURE * fps))
    total = math.ceil(length * fps / speed) + round(_LAST_PICTURE * fps)
    with Progress(console=console, transient=True) as progress, atomic(config.out) as temporary:
        counted = progress.track(pictures, total=total, description="drawing")
        write = _write_gif if config.out.suffix.lower() == ".gif" else _write_mp4
        write(temporary, counted, fps)


def _pictures(
    renderer: Renderer, simulator: Simulator, steps: Iterator[Step], interval: float, last: int
) -> Iterator[Frame]:
    """Frames at equal intervals, s, of the first state and of those after each step.

    The last frame is repeated the given number of times.
    """
    renderer.reset()
    shown = 0
    for step in chain([None], steps):
        if step is not None:
            renderer.see(step.outcome.contact)
        next_state = float(simulator.time[0]) + simulator.scenario.tau
        due = math.ceil(next_state / interval - 1e-9)
        count = last if simulator.ended[0] else due - shown
        if count > 0:
            frame = renderer.render()
            assert frame is not None
            yield from repeat(frame, count)
        shown = max(shown, due)


VIDEOS = (".gif", ".mp4")
_SHARES = (0.0, 0.15, 0.3, 0.5, 0.65, 0.8)
"""Fractions of white in a colour: paths are lighter than robots, and edges are smooth."""


def video_rate(path: Path, fps: int) -> float:
    """Frame rate of the file format; GIF delays are multiples of 0.01 s, at least 0.02 s."""
    return 100 / max(2, round(100 / fps)) if path.suffix.lower() == ".gif" else float(fps)


def _write_gif(path: Path, frames: Iterable[Frame], fps: float) -> None:
    from PIL import Image

    palette, none = Image.new("P", (1, 1)), Image.Dither.NONE
    palette.putpalette(_palette())
    pictures = (Image.fromarray(one).quantize(palette=palette, dither=none) for one in frames)
    first = next(pictures)
    duration = round(1000 / fps)
    first.save(path, format="GIF", save_all=True, append_images=pictures, duration=duration, loop=0)


def _palette() -> list[int]:
    """Palette as red, green, blue, red, …: colours of the frames and their blends with white."""
    white, black = (255, 255, 255), (0, 0, 0)
    greys = [mixed(black, white, step / 15) for step in range(16)]
    dark = [mixed(robot, black, 0.5) for robot in ROBOTS]
    colours = (*ROBOTS, OBSTACLE, OBSTACLE_EDGE)
    faded = [mixed(colour, white, share) for colour in colours for share in _SHARES]
    edges = [
        mixed(OBSTACLE, other, share) for other in (OBSTACLE_EDGE, *ROBOTS) for share in (0.3, 0.6)
    ]
    return list(chain.from_iterable([*greys, *dark, *faded, *edges]))


def _write_mp4(path: Path, frames: Iterable[Frame], fps: float) -> None:
    from imageio_ffmpeg import write_frames

    pictures = iter(frames)
    first = next(pictures)
    height, width = first.shape[:2]
    writer = write_frames(
        str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2
    )
    writer.send(None)
    try:
        for frame in chain([first], pictures):
            writer.send(frame.tobytes())
    finally:
        writer.close()
