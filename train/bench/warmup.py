"""``rendezvous warmup``: compile beforehand what the first use of a scenario would compile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.progress import track
from tyro.conf import arg

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import names
from rendezvous_env.trajectory import begin

from ..policies import resolve_scenario

_TOGETHER = 8
"""Teams of a batch: from five on they are computed side by side, by other code than a few."""


@dataclass(frozen=True)
class Config:
    """Compile beforehand what the first use of a scenario would compile."""

    scenarios: Annotated[tuple[str, ...], arg(aliases=("--scenario",))] = ()
    """Names of scenarios or TOML files; without any all named ones are taken, some minutes."""


def run(config: Config) -> None:
    """Step every scenario once, one team and many, and ask every policy that fits it."""
    scenarios = [resolve_scenario(name) for name in config.scenarios or names()]
    for scenario in track(scenarios, "compiling", console=Console(stderr=True)):
        for teams in (1, _TOGETHER):
            _use(scenario, teams)
    print(f"{len(scenarios)} scenarios are ready")


def _use(scenario: Scenario, teams: int) -> None:
    simulator = rv.Simulator(scenario, teams)
    observations = simulator.reset(0)
    for name in baselines.names(scenario):
        policy = baselines.make(name, scenario)
        begin(policy, simulator)
        actions = policy(observations, simulator.time)
        simulator.step(np.asarray(actions, dtype=np.float32))
        observations = simulator.reset(0)
