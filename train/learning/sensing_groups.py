"""Teams in groups, each with a sensor of its own that is drawn anew every few updates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from baselines.learned.perceiving import PerceivingTeams
from rendezvous_env.engine.state_checks import check_entries, check_keys
from rendezvous_env.experiment.sensing import Sensing
from rendezvous_env.faces.infos import Info, Transition
from rendezvous_env.simulator import Simulator

MakeTeams = Callable[[Sensing, int], PerceivingTeams]
"""Makes so many teams with that sensor."""


class SensingGroups(VectorEnv[Any, Any, Any]):
    """Groups of ``PerceivingTeams`` as one vector environment of all their teams.

    The sensor of group g follows from its generation, which grows by one every ``period`` updates,
    for one group after the other. A group with a new sensor begins new episodes; its teams go on to
    the next ones of their seeds. A robot that is shown nothing makes choice 0, as it does when the
    policy is served.

    Args:
        make: the teams of a group.
        draw: the sensor of a group, from its number and its generation.
        sizes: how many teams each group has.
        period: updates for which a group keeps its sensor.
    """

    def __init__(
        self,
        make: MakeTeams,
        draw: Callable[[int, int], Sensing],
        sizes: Sequence[int],
        period: int,
    ) -> None:
        self._make, self._draw, self._period = make, draw, period
        self._sizes, self._bounds = list(sizes), np.cumsum(sizes)[:-1]
        self.generations = np.zeros(len(sizes), dtype=np.int64)
        self.groups = self._make_all(self.generations)
        first = self.groups[0]
        self.num_envs = sum(sizes)
        self.metadata, self.render_mode = first.metadata, None
        self.single_observation_space = first.single_observation_space
        self.single_action_space = first.single_action_space
        self.layout, self.global_state = first.layout, first.global_state
        shape = (self.num_envs, self.simulator.scenario.n_robots)
        self._blind = np.zeros(shape, dtype=np.bool_)

    def _make_all(self, generations: NDArray[np.int64]) -> list[PerceivingTeams]:
        return [self._make_group(g, int(k)) for g, k in enumerate(generations)]

    def _make_group(self, group: int, generation: int) -> PerceivingTeams:
        return self._make(self._draw(group, generation), self._sizes[group])

    @property
    def simulator(self) -> Simulator:
        """Of the first group; each has its own."""
        return self.groups[0].env.simulator

    @property
    def sensors(self) -> list[Sensing]:
        """Of the groups."""
        return [teams.env.scenario.sensing for teams in self.groups]

    @property
    def alignment(self) -> NDArray[np.float64]:
        """(B, n), as ``PerceivingTeams.alignment``."""
        return np.concatenate([teams.alignment for teams in self.groups])

    # ---- episodes -----------------------------------------------------------------------------

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin a new episode in all teams, as ``RendezvousVectorEnv.reset`` without options.

        Raises:
            ValueError: if there are options.
        """
        if options:
            raise ValueError(f"options are {dict(options)}; groups of teams take none")
        seeds = [seed + team for team in range(self.num_envs)] if isinstance(seed, int) else seed
        begun = []
        for teams, stop in zip(self.groups, np.cumsum(self._sizes).tolist(), strict=True):
            own = None if seeds is None else seeds[stop - teams.num_envs : stop]
            begun.append(teams.reset(seed=own))
        observations = np.concatenate([seen for seen, _ in begun])
        self._note_blind(slice(None), observations)
        return observations, self._joined([infos for _, infos in begun])

    def step(self, actions: ArrayLike) -> Transition:
        """As ``PerceivingTeams.step``."""
        chosen = np.where(self._blind, 0, np.asarray(actions))
        parts = np.split(chosen, self._bounds)
        steps = [teams.step(own) for teams, own in zip(self.groups, parts, strict=True)]
        *arrays, infos = zip(*steps, strict=True)
        seen, rewards, ends, cuts = (np.concatenate(parts) for parts in arrays)
        self._note_blind(slice(None), seen)
        return seen, rewards, ends, cuts, self._joined(infos)

    def renew(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Give the groups whose time has come before this update their next sensor.

        Returns:
            Which teams have begun new episodes, (B,), and their observations, one after the other.
        """
        groups = len(self.groups)
        due = (update + self._period * np.arange(groups) // groups) // self._period
        which = np.repeat(due != self.generations, self._sizes)
        begun = [np.empty((0, *self.single_observation_space.shape), dtype=np.float32)]
        for group in np.flatnonzero(due != self.generations).tolist():
            renewed = self._make_group(group, int(due[group]))
            begun.append(_next_episodes(self.groups[group], renewed))
            self.groups[group], self.generations[group] = renewed, due[group]
        observations = np.concatenate(begun)
        self._note_blind(which, observations)
        return which, observations

    def _note_blind(self, which: Any, observations: NDArray[np.float32]) -> None:
        self._blind[which] = ~observations[..., : self.layout.size].any(axis=-1)

    def _joined(self, parts: Sequence[Info]) -> Info:
        """Infos of all groups as of one; where a group tells nothing there are zeros or None."""
        joined: Info = {}
        for key in dict.fromkeys(key for part in parts for key in part):
            told = next(part[key] for part in parts if key in part)
            if isinstance(told, dict):
                joined[key] = self._joined([part.get(key, {}) for part in parts])
                continue
            nothing = None if told.dtype == object else told.dtype.type(0)
            joined[key] = np.concatenate(
                [
                    part[key] if key in part else np.full((size, *told.shape[1:]), nothing)
                    for part, size in zip(parts, self._sizes, strict=True)
                ]
            )
        return joined

    # ---- state --------------------------------------------------------------------------------

    def get_state(self) -> dict[str, Any]:
        """The generations, running episodes and memory of all groups, as copies."""
        groups = {str(g): teams.get_state() for g, teams in enumerate(self.groups)}
        return groups | {"generations": self.generations.copy(), "blind": self._blind.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out, with the sensors that belong to it.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        check_keys(state, [str(g) for g in range(len(self.groups))])
        own = check_entries({"generations": self.generations, "blind": self._blind}, state)
        if (own["generations"] < 0).any():
            raise ValueError(f"generations are {own['generations']}; they must not be negative")
        groups = self._make_all(own["generations"])
        for g, teams in enumerate(groups):
            teams.set_state(state[str(g)])
        self.groups = groups
        self.generations, self._blind = own["generations"].copy(), own["blind"].copy()


def _next_episodes(before: PerceivingTeams, renewed: PerceivingTeams) -> NDArray[np.float32]:
    """Begin in new teams what would have been the next episodes of others; observations."""
    drawn = before.env.simulator.get_state()
    simulator = renewed.env.simulator
    simulator.reset(drawn["seed"].tolist())
    simulator.set_state(simulator.get_state() | {"episode": drawn["episode"]})
    return renewed.reset()[0]
