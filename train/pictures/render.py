"""``rendezvous render``: one episode as a film or as a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from rendezvous_env.drawing.renderer import Renderer
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.experiment.scenarios import resolve
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Policy, Trajectory, rollout
from rendezvous_env.trajectory import run as steps_of

from .. import policies
from ..errors import UserError
from ..results import atomic, prepare_folder
from . import films, path_figures, style
from .reproduce import one_team

STILLS = (".png", ".pdf")
_USUAL_LENGTH = 8.0  # s, of a film whose speed is not given
_LEAST_STEPS = 15  # in a second of such a film; fewer would not look like motion
_LAST_PICTURE = 1.5  # s, for which a film shows the end of the episode
_LIMITS = {"seed": (0, 2**63 - 1), "size": (120, 4096), "fps": (1, 100), "speed": (1e-3, 1e3)}

Frame = NDArray[np.uint8]


@dataclass(frozen=True)
class Config:
    """Make a film (.gif, .mp4) or a figure (.png, .pdf) of one episode."""

    scenario: str = "fig4"
    """Name of a scenario, or path of a TOML file."""
    policy: str | None = None
    """Name of a policy; learned and learned:PATH are among them. None is the best that fits."""
    seed: int = 0
    """Of the start."""
    out: Path = Path("out/render.gif")
    """File to write; its ending says what: .gif, .mp4, .png or .pdf."""
    size: int = 600
    """Edge of a film's square picture, pixels; an odd one is made even."""
    fps: int = 25
    """Pictures in a second of film."""
    speed: float | None = None
    """Simulated seconds in a second of film; none makes the film 8 s long, or shorter
    if the episode has few steps."""


def run(config: Config) -> int:
    """Simulate, draw, and write the file.

    Raises:
        UserError: for an unknown name or ending, an impossible number, a file that cannot be
            written, or a missing extra.
    """
    scenario, name = _check(config)
    prepare_folder(config.out.parent)
    console = Console()
    with console.status("simulating; the first use on a machine compiles …"):
        policy = policies.make(name, scenario)
        trajectory = rollout(scenario, policy, config.seed)
    try:
        if config.out.suffix.lower() in STILLS:
            figure = path_figures.team_figure(scenario, one_team(trajectory), name)
            style.save(figure, config.out)
        else:
            _write_film(config, name, trajectory, console)
    except OSError as error:
        raise UserError(f"--out {config.out}: cannot write there: {error.strerror}") from error
    end = "met" if trajectory.success[0] else "did not meet, stopped"
    seconds = float(trajectory.times[-1])
    console.print(f"{scenario.name}, {name}: {end} after {seconds:.2f} s; {config.out}")
    return 0


def _check(config: Config) -> tuple[Scenario, str]:
    """The scenario and the policy's name, once everything is known to be right."""
    ending, known = config.out.suffix.lower(), (*films.ENDINGS, *STILLS)
    if ending not in known:
        raise UserError(
            f"--out {config.out}: unknown ending {ending!r}; known are {', '.join(known)}"
        )
    for field, (least, most) in _LIMITS.items():
        value = getattr(config, field)
        if value is not None and not least <= value <= most:
            raise UserError(f"--{field} is {value}; it must be from {least} to {most}")
    policies.check_names([config.policy] if config.policy else [])
    try:
        scenario = resolve(config.scenario)
        name = config.policy or policies.best(scenario)
        policies.make(name, scenario)
    except (ValueError, OSError) as error:
        raise UserError(str(error)) from error
    if ending in films.ENDINGS:
        films.check(config.out)
    return scenario, name


def _write_film(config: Config, name: str, trajectory: Trajectory, console: Console) -> None:
    """Play the episode once more, with a renderer looking on."""
    scenario = trajectory.scenario
    length = float(trajectory.times[-1])
    fps = films.rate(config.out, config.fps)
    steps = len(trajectory.times) - 1
    speed = config.speed or length / min(_USUAL_LENGTH, steps / _LEAST_STEPS)
    edge = 2 * (config.size // 2)
    simulator = Simulator(scenario)
    observations = simulator.reset(config.seed)
    renderer = Renderer(simulator, "rgb_array", (edge, edge), horizon=length)
    policy = policies.make(name, scenario)
    pictures = _pictures(renderer, simulator, policy, observations, (speed / fps, fps))
    total = math.ceil(length * fps / speed) + round(_LAST_PICTURE * fps)
    with Progress(console=console, transient=True) as progress, atomic(config.out) as temporary:
        counted = progress.track(pictures, total=total, description="drawing")
        films.write(temporary, config.out.suffix.lower(), counted, fps)


def _pictures(
    renderer: Renderer,
    simulator: Simulator,
    policy: Policy,
    observations: NDArray[np.float32],
    pace: tuple[float, float],
) -> Iterator[Frame]:
    """Pictures at equal times of the first state, the states between, and at length of the last.

    Args:
        renderer: of the simulator.
        simulator: freshly reset.
        policy: what moves the robots.
        observations: of the start.
        pace: simulated seconds from picture to picture, and pictures a second.
    """
    interval, fps = pace
    shown = 0
    for _ in _states(renderer, simulator, policy, observations):
        next_state = float(simulator.time[0]) + simulator.scenario.tau
        due = math.ceil(next_state / interval - 1e-9)
        count = round(_LAST_PICTURE * fps) if simulator.ended[0] else due - shown
        if count > 0:
            frame = renderer.render()
            assert frame is not None
            yield from repeat(frame, count)
        shown = max(shown, due)


def _states(
    renderer: Renderer, simulator: Simulator, policy: Policy, observations: NDArray[np.float32]
) -> Iterator[None]:
    """Stops at the start and after every step, of which the renderer has been told."""
    renderer.reset()
    yield
    for step in steps_of(simulator, policy, observations):
        renderer.see(step.outcome.contact)
        yield
