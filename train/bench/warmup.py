"""``rendezvous warmup``: compile the kernels of scenarios in advance."""

from dataclasses import dataclass
from typing import Annotated

from rich.progress import track
from tyro.conf import arg

from rendezvous_env import baselines
from rendezvous_env.checks import counted
from rendezvous_env.scenario.scenarios import names

from ..checks import Flags
from ..compare.playing import TOGETHER, make_ready
from ..compare.settings import Job
from ..console import Console
from ..policies import resolve_scenario


@dataclass(frozen=True)
class Config(Flags):
    """Compile the kernels that the first use of a scenario needs."""

    scenarios: Annotated[tuple[str, ...], arg(aliases=("--scenario",))] = ()
    """Names of scenarios or TOML files. Default: all named scenarios."""


def run(config: Config) -> None:
    """Run every fitting policy for two steps, with one environment and with a batch."""
    scenarios = [resolve_scenario(name) for name in config.scenarios or names()]
    for scenario in track(scenarios, "compiling", console=Console(stderr=True)):
        for name in baselines.names(scenario):
            for teams in (1, TOGETHER):  # five or more use the SIMD code path
                make_ready(Job(scenario, name), teams)
    verb = "is" if len(scenarios) == 1 else "are"
    print(f"{counted(len(scenarios), 'scenario')} {verb} ready")
