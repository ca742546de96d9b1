"""``rendezvous play``: an episode in a window, with robots and obstacles that can be moved."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from rendezvous_env.checks import counted
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Policy, begin

from .. import policies
from ..checks import Bounds, Flags, UserError, check_installed
from ..console import Console

EXAMPLES = ("clutter-8", "trap --policy tangent-merged --set n_robots=3")


@dataclass(frozen=True)
class Config(Flags):
    """Play an episode in a window: space pauses, s steps, r resets, q closes.

    Click or tab selects a robot; the panel shows its observation. The mouse drags robots and
    obstacles. With d, the arrow keys drive the selected robot.
    """

    scenario: Positional[str]
    """Name of a scenario, or path of a TOML file."""
    policy: Annotated[str | None, arg(aliases=("--policies",))] = None
    """Name of the policy of all robots that the keys do not drive. Default: the best that fits."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of the first initial condition; r continues with the next episode."""
    size: Annotated[int, Bounds(300, 4096)] = 700
    """Edge of the picture, pixels; the panel beside it has 260 more."""
    steps: Annotated[int | None, Bounds(1, 10**9)] = None
    """Close the window after this number of steps. Default: only the user closes it."""
    set: tuple[str, ...] = ()
    """Overrides of scenario fields, for example n_robots=9 time_limit=60."""


def run(config: Config) -> int:
    """Open the window and play until it is closed."""
    check_installed("a window", "render", "pygame")
    policies.check_names([config.policy] if config.policy else [])
    scenario = policies.resolve_scenario(config.scenario, config.set)
    name = config.policy or policies.best(scenario)
    policy = policies.tried(name, scenario)
    console = Console()
    made = _play(config, Simulator(scenario), name, policy, console)
    console.print(f"{scenario.name}, {name}: {counted(made, 'step')}")
    return 0


def _play(config: Config, simulator: Simulator, name: str, policy: Policy, console: Console) -> int:
    """Number of steps that the user has made."""
    with console.status("the first use on a machine compiles …"):
        simulator.reset(config.seed)
        simulator.compile()
    from rendezvous_env.render.player import Player

    try:
        player = Player(
            simulator,
            lambda seen, time: np.asarray(policy(seen, time)),
            name,
            config.size,
            config.seed,
            lambda: begin(policy, simulator),
        )
    except RuntimeError as error:
        raise UserError(f"{error}; rendezvous render writes a video instead") from error
    made = player.run(config.steps)
    player.close()
    return made
