"""Links: wished velocities in, velocities that lengthen no link out (theorem R)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import inlined_entry, kernel, unfolded_kernel
from ..engine.pool.sharing import each_block
from ..engine.state_checks import check_observations
from ..equations.least_norm import least_norm_of
from ..equations.robots.kinematics import speed_scale
from ..equations.rows import degree_of, net_bearing_of
from ..equations.vectors import combine, dot, load, scaled, split, store
from ..experiment.checks import real, refuse
from ..experiment.scenario import Scenario
from .action_filter import ActionFilter, check_goes_anywhere
from .bearing_errors import check_bearing_error
from .kinds_of_links import DIRECTED, SWITCHING, kind_of_links
from .link_set import project_on_links
from .teams import over_teams, teams_of_block


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the arguments."""

    neighbour_slots: int
    radius: float
    speed_limit: float
    share: float
    bearing_error: float


class LinkKeeping(ActionFilter):
    """Held wishes and frames of the robots of B teams that lose no link (theorem R).

        v_i = λ min(d_i, r/(2τ), v_max) sin(φ_i − η)₊ q_i/‖q_i‖ + (1 − λ) P(wanted)

    with φ_i = asin ‖q_i‖, q_i of lemma 2, and P the projection onto B_i = ∩ ball(ρ g, ρ) over all
    bearings g within η of a seen one, ρ = r/(4τ). The first part is in B_i too, so v_i is.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        share: λ, in (0, 1], how much of each velocity is the law's.
        bearing_error: η, rad, the largest angle by which a bearing may be wrong.
        frame: "net_bearing" (x along f) or "local".
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right, or why the robots of
            this scenario cannot keep their links.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        num_threads: int | None = None,
    ) -> None:
        check_goes_anywhere(scenario, "theorem R")
        if reason := asymmetric_sight(scenario):
            raise ValueError(f"scenario: {reason}")
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.action_size,
            frame=frame,
            num_threads=num_threads,
        )
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            radius=scenario.merge_radius / (4.0 * scenario.tau),
            speed_limit=float(scenario.speed_limit),
            share=check_share(share),
            bearing_error=check_bearing_error(bearing_error),
        )

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``ActionFilter.act``."""
        observations = check_observations(observations, self._seen)
        actions = np.zeros(self._held.shape, dtype=np.float32)
        fixed = (observations, self._constants, self._held)
        given = (actions, self.alignment, self.lyapunov_rate)
        over_teams(lambda part: keep_links(part, *fixed, *given), *self._batch)
        return actions


def asymmetric_sight(scenario: Scenario) -> str:
    """Why a robot may see one that does not see it, or lose sight of one that is near (theorem R).

    Args:
        scenario: gives the graph and the sensor.

    Returns:
        Words; empty where sight is symmetric.
    """
    sensing, kind = scenario.sensing, kind_of_links(scenario.sensing_graph)
    needs = "theorem R needs that both see each other while they are near"
    if kind in (DIRECTED, SWITCHING):
        return f"graph is a {kind} one; {needs}: it must be undirected, or follow sight"
    if sensing.field_of_view < 2.0 * math.pi:
        return f"sensing.field_of_view is {sensing.field_of_view:.6g} rad; {needs}: it must be 2π"
    if sensing.dropout > 0.0:
        return f"sensing.dropout is {sensing.dropout:g}; {needs}: it must be 0"
    if sensing.occlusion != "none":
        return f"sensing.occlusion is {sensing.occlusion!r}; {needs}: it must be 'none'"
    return ""


def check_share(share: Any) -> float:
    """λ, a number without unit, in (0, 1] (theorem R c).

    Raises:
        ValueError: saying what was given.
    """
    if not 0.0 < real(share) <= 1.0:
        refuse("share", share, "in (0, 1]")
    return real(share)


@kernel
def keep_links(share, observations, constants, held, actions, alignment, lyapunov_rate):
    """The velocities of the teams that this thread takes (theorem R c and d).

        v = λ s sin(φ − η)₊ q/‖q‖ + (1 − λ) P(wanted),   s = min(d, r/(2τ), v_max)

    Args:
        share: this thread's part, as sharing.py says.
        observations: (B, n, rows, d), m/s, in the robots' own frames.
        constants: of the scenario and of the arguments, see ``LinkKeeping``.
        held: what is wanted, (B, n, d), in units of v_max.
        actions: v, (B, n, d) float32, m/s; filled in.
        alignment: |hᵀf|/‖f‖, (B, n), h along v; filled in, NaN where either is zero.
        lyapunov_rate: −2 f·v, (B, n), m²/s²; filled in.

    Returns:
        Whether all blocks are done, see ``each_block``.
    """
    arguments = observations, constants, held, actions, alignment, lyapunov_rate
    return each_block(share, _keep_links_of_teams, arguments)


@unfolded_kernel
def _keep_links_of_teams(block, arguments):
    observations, constants, held, actions, alignment, lyapunov_rate = arguments
    first, last = teams_of_block(block, len(observations))
    for team in range(first, last):
        for i in range(observations.shape[1]):
            rows = observations[team, i]
            velocity = link_keeping_velocity(load(held[team, i]), rows, constants)
            store(velocity, actions[team, i])
            f = net_bearing_of(rows, constants.neighbour_slots)
            alignment[team, i] = alignment_of(velocity, f)
            lyapunov_rate[team, i] = -2.0 * dot(f, velocity)


@kernel
def link_keeping_velocity(wish, rows, constants):
    """The velocity of one robot, a triple, m/s (theorem R c and d).

    Args:
        wish: a triple, in units of v_max; a longer one counts as v_max.
        rows: of the robot, a_ij g_ij, (rows, d), m/s.
        constants: of the scenario and of the arguments, see ``LinkKeeping``.
    """
    slots, radius, error = constants.neighbour_slots, constants.radius, constants.bearing_error
    degree = degree_of(rows, slots)
    if degree == 0.0:
        return 0.0, 0.0, 0.0
    sine, towards = split(least_norm_of(rows, slots))
    cosine = math.sqrt(max(1.0 - sine * sine, 0.0))
    sure = max(sine * math.cos(error) - cosine * math.sin(error), 0.0)
    speed = min(degree, 2.0 * radius, constants.speed_limit) * sure
    wanted = scaled(wish, constants.speed_limit)
    _, within = speed_scale(dot(wanted, wanted), constants.speed_limit)
    free = project_on_links(scaled(wanted, within), rows, slots, radius, error)
    return combine(constants.share * speed, towards, 1.0 - constants.share, free)


@inlined_entry
def alignment_of(velocity, net_bearing):
    """|hᵀf|/‖f‖ of a velocity's direction h, without unit; NaN where either triple is zero."""
    (speed, direction), (strength, towards) = split(velocity), split(net_bearing)
    return abs(dot(direction, towards)) if speed > 0.0 and strength > 0.0 else np.nan
