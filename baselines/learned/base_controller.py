"""Base controller of learned policies: from a choice to a certified action.

The controller applies the rule of merged intervals with f rotated by a chosen angle. It is
identical in training and in use.
"""

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_shape, floats
from rendezvous_env.engine.state_checks import check_observations
from rendezvous_env.engine.threads import Calls, Slice
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.safety_filter import over_robots, over_teams
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.scenario.scenario import Scenario

from ..network_actions import check_choices, raise_not_finite
from ..obstacle_rules.planes_in_space import PASSABLE
from ..policy import Float32, Mask
from ..search.direct_control import DirectController
from ..steady_frames import OdometryFrame, OdometryPlane
from .base_controller_kernels import Rule, aim, desired_velocities, room_for_aim, unit_vectors
from .features import Features
from .policy_settings import PolicySettings

Array = NDArray[np.float64]


class CommandedTank(EnergyTank):
    """``EnergyTank`` without feedback about contacts and merges: steps count as commanded."""

    uses_feedback, reuses_calls = False, True

    def __init__(self, scenario: Scenario, num_envs: int, **arguments: Any) -> None:
        super().__init__(scenario, num_envs, frame="local", **arguments)
        team = num_envs, scenario.n_robots
        self._booked = np.zeros(team)
        on_their_own = np.tile(np.arange(scenario.n_robots), (num_envs, 1))
        self._alone = np.zeros(team, np.bool_), on_their_own, np.zeros(num_envs, np.bool_)

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._booked[which] = 0.0

    def settle(self, share: float, bends: Any = 0.0) -> None:
        """Correct the tank update of the previous step, which lasted only a fraction σ of τ.

        On a straight line G is concave in time and 0 at first. In a fraction σ ≤ 1 of a step a
        robot therefore gains at least σ G, which remains. An arc deviates from its chord by at most
        σ (1 − σ) |v ω| τ²/2, so σ G − σ (1 − σ) D̄ |v ω| τ² remains. A longer step adds G. A
        negative level becomes zero. ``bends`` are |v ω| τ² of arcs of less than 2 rad, (B, n), m.
        """
        left = 1.0 - min(share, 1.0)
        lost = left * self._booked + left * (1.0 - left) * self.scenario.max_degree * bends
        self._levels[...] = np.maximum(self._levels - lost, 0.0)
        self._booked[...] = 0.0

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``EnergyTank.apply_calls``; the tank is updated immediately, for duration τ."""
        mine = slice(*part[:2])
        note = partial(np.copyto, self._booked[mine], self._deposits[mine])
        acted = super().apply_calls(part, observations, actions)
        return [*acted, note, *self.update_calls(part, *self._alone)]


class HeadingTankFilter(CommandedTank):
    """Velocities along chosen headings, as fast as law (1) moves along f (theorem D).

    Δ = τ min(v_max, s ‖f‖) h,   s = min(1, r/(2 D τ))
    """

    reuses_calls = True

    def __init__(self, scenario: Scenario, num_envs: int, **arguments: Any) -> None:
        super().__init__(scenario, num_envs, **arguments)
        self.carried = np.zeros((num_envs, scenario.n_robots, scenario.dim))
        """Last desired headings h_i, (B, n, d), in the robots' own frames; zero where undefined."""
        self._velocities = np.zeros_like(self.carried)

    @property
    def velocities(self) -> Array:
        """Last actions, (B, n, d), m/s."""
        return self._velocities.copy()

    @property
    def _memory(self) -> dict[str, Array]:
        return {"headings": self.carried, "velocities": self._velocities, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self.carried[which] = self._velocities[which] = 0.0

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``CommandedTank.apply_calls``."""
        memory, mine = (self.carried, self._held), slice(*part[:2])
        desire = partial(desired_velocities, part, observations, self._robot, *memory)
        note = partial(np.copyto, self._velocities[mine], actions[mine])
        return [desire, *super().apply_calls(part, observations, actions), note]


class BaseController:
    """Base controller of B environments: features, choices, and certified actions.

        show → (a network chooses) → choose, or head → apply:  raw = rule(R(φ) f)

    The robots follow the rule of ``tangent-merged-tuned`` with f rotated by their choices. The raw
    vector becomes a certified heading, or with tanks any heading that the stored energy allows.
    Unicycles turn as their gate or tank allows, with memory in ``OdometryFrame``. In 3-D all of
    this takes place in a plane (``OdometryPlane``). ``show`` updates the memory, so it is called
    once per decision, and ``apply`` in every step. Arguments and errors are those of ``Features``.
    """

    uses_feedback, reuses_calls = False, True  # as ``CommandedTank``
    action_diagnostics = ()

    def __init__(
        self,
        settings: PolicySettings,
        scenario: Scenario,
        num_envs: int,
        *,
        obstacle_slots: int | None = None,
        num_threads: int | None = None,
    ) -> None:
        self.perception = Features(
            scenario,
            num_envs,
            decision_time=settings.decision_period(scenario) * scenario.tau,
            obstacle_slots=obstacle_slots,
            tank_columns=settings.layout(0, 0).tank_columns,
            num_threads=num_threads,
        )
        layout, team = scenario.observation_layout, (num_envs, scenario.n_robots)
        clearance, certified = float(settings.clearance), settings.guarantee == "heading"
        self._rule = Rule(layout.neighbour_slots, clearance, float(settings.persistence))
        self._seen = *team, *layout.shape
        self._batch, self._action_size = (*team, num_threads), scenario.action_size
        most = settings.max_turn_rate if certified else math.inf
        self.bodies: OdometryFrame | OdometryPlane | None = None
        if scenario.dim == 3:
            keeps = PASSABLE if certified else math.inf
            self.bodies = OdometryPlane(scenario, num_envs, 0.5 * clearance, most, keeps)
        elif scenario.model.nonholonomic:
            # within the clearance of a free direction nothing is ahead of a body
            self.bodies = OdometryFrame(scenario, num_envs, clearance, most)
        common = {"min_alignment": settings.min_alignment, "num_threads": num_threads}
        self.steering: HeadingFilter | CommandedTank
        self.tank: CommandedTank | None = None
        if certified:
            heading: dict[str, Any] = common | {"max_turn_rate": most, "frame": "local"}
            self.steering = HeadingFilter(scenario, num_envs, **heading)
        else:
            budget = settings.budget_of(scenario)
            make_tank = HeadingTankFilter if self.bodies is None else CommandedTank
            self.tank = self.steering = make_tank(scenario, num_envs, budget=budget, **common)
        self.angles = settings.angles
        self._turns = np.stack((np.cos(self.angles), np.sin(self.angles)), axis=-1)
        self.choices = np.zeros(team, dtype=np.int64)
        self._directions = self._turns[self.choices]

    def settle(self, share: float) -> None:
        """Account for the previous step, which lasted this fraction of τ."""
        bends = 0.0 if self.bodies is None else self.bodies.settle(share)
        if self.tank is not None:
            self.tank.settle(share, bends)

    @property
    def _carried(self) -> Array:
        """Carried headings, (B, n, 2)."""
        steering: Any = self.steering
        return steering.carried if self.bodies is None else self.bodies.headings

    def show(
        self,
        shown: Float32,
        observations: Float32,
        which: Mask | None = None,
        elapsed: Array | None = None,
    ) -> Float32:
        """Features of the robots before a decision; arguments as ``Features.see``."""
        moving = self.steering if self.bodies is None else self.bodies
        if self.bodies is not None:
            teams = np.arange(self._batch[0]) if which is None else np.flatnonzero(which)
            observations = self.bodies.seen(check_observations(observations, self._seen), teams)
        return self.perception.see(
            observations,
            self._carried,
            which,
            velocities=getattr(moving, "velocities", None),
            levels=None if self.tank is None else self.tank.normalised_levels,
            elapsed=elapsed,
            shown=shown,
        )

    def choose(self, choices: ArrayLike) -> None:
        """Set choices (B, n) until the next call; a ValueError names the robot of a wrong one."""
        self.choices = check_choices(choices, self.choices.shape, len(self.angles))
        self._directions = self._turns[self.choices]
        self.perception.note(self.angles[self.choices])

    def head(self, vectors: ArrayLike) -> None:
        """Set directions (B, n, 2), with x along f, in place of choices; zero is along f.

        A ValueError names the robot whose vector is not finite.
        """
        given = floats("actions", vectors)
        check_shape("actions", given, (*self.choices.shape, 2), axes="(B, n, 2)")
        turned = np.empty(given.shape)
        if not unit_vectors(given, turned, tuple(self._turns[0])):
            raise_not_finite(given)
        self._directions = turned
        if self.perception.remembers_angles:
            self.perception.note(np.arctan2(turned[..., 1], turned[..., 0]))

    def apply(self, observations: Float32, *, elapsed: float | None = None) -> Float32:
        """Actions (B, n, a) for observations (B, n, rows, d).

        ``elapsed`` is as for ``SafetyFilter.apply``.
        """
        observations = check_observations(observations, self._seen)
        actions = np.zeros((*self._seen[:2], self._action_size), np.float32)
        over_teams(
            lambda part: self.apply_calls(part, observations, actions, elapsed), *self._batch
        )
        return actions

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``apply``, unchecked, for a slice, with output ``actions``."""
        carried, bodies = self._carried, self.bodies
        steer = self.steering.apply_calls(part, observations, actions, elapsed)
        if bodies is None:
            raw = self.steering.held if self.tank is None else carried
            return [*self._aim_calls(part, observations, carried, raw), *steer]

        def follow() -> None:
            there = bodies.seen(observations, np.arange(*part[:2]))
            for one in self._aim_calls(part, there, carried, carried):
                one()
            bodies.follow(part, observations, self.steering.held)

        return [follow, *steer, partial(bodies.turn, part, actions)]

    def _aim_calls(self, part: Slice, observations: Float32, carried: Array, raw: Array) -> Calls:
        """Call that writes the directions of the rule to ``raw``, (B, n, 2)."""
        work = room_for_aim(observations.shape[2], self._rule.neighbour_slots)
        bits = np.ascontiguousarray(observations).view(np.int64)
        arrays = observations, bits, self._directions, carried, raw
        return over_robots(aim, part, self._rule, *arrays, work=work)

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """No operation, see ``uses_feedback``."""
        return ()

    def forget(self, which: Mask | None = None) -> None:
        """Clear headings and memory of all environments or of those of a mask (B,)."""
        for memory in (self.steering, self.perception, self.bodies):
            if memory is not None:
                memory.forget(which)


Controller = BaseController | DirectController
"""Base controller that maps a network's choices to actions, with or without a filter."""


def make_controller(
    settings: PolicySettings,
    scenario: Scenario,
    num_envs: int,
    *,
    obstacle_slots: int | None = None,
    num_threads: int | None = None,
) -> Controller:
    """Base controller of a policy with these settings; arguments as of ``BaseController``."""
    if settings.guarantee != "none":
        slots, threads = obstacle_slots, num_threads
        return BaseController(
            settings, scenario, num_envs, obstacle_slots=slots, num_threads=threads
        )
    layout = settings.layout_of(scenario)
    if obstacle_slots is not None:
        layout = settings.layout(layout.neighbour_slots, obstacle_slots)
    return DirectController(settings.commands, scenario, num_envs, layout, num_threads)
