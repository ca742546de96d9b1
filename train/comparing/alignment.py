"""How well commanded velocities follow the net bearing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.engine.state_checks import check_mask, check_numbers, check_observations
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.trajectory import Step


def alignments(scenario: Scenario, step: Step) -> NDArray[np.float64]:
    """Alignment |vᵀf|/(‖v‖‖f‖) of every robot with ‖f‖ ≥ 2δ, NaN for the others.

    v is the commanded velocity; for nonholonomic robots it has the direction of the body axis,
    for robots with inertia it is the commanded acceleration. A robot told to rest has alignment 0.
    Robots of teams that have finished have NaN.

    Args:
        scenario: gives δ and the robot model.
        step: what the robots saw and were told to do.

    Returns:
        (B, n), in [0, 1].

    Raises:
        ValueError: for a step of other robots.
    """
    n, layout = scenario.n_robots, scenario.observation_layout
    shape = (len(step.running), n, *layout.shape)
    observations = check_observations(step.observations, shape)
    acted = (*shape[:2], scenario.action_size)
    actions = check_numbers("actions", step.actions, acted, "(B, n, a)")
    running = check_mask(step.running, shape[0])
    least = max(2.0 * scenario.dead_zone, 1e-12)
    slots, along_x = layout.neighbour_slots, scenario.model.nonholonomic
    out = np.empty(shape[:2])
    batch_alignments(observations, actions, running, slots, along_x, least, out)
    return out


@kernel
def batch_alignments(
    observations: Any,
    actions: Any,
    running: Any,
    slots: int,
    along_x: bool,
    least: float,
    out: Any,
) -> None:
    """Alignments of the robots of running teams, to ``out`` (B, n)."""
    batch, n = out.shape
    for b in range(batch):
        for i in range(n):
            out[b, i] = np.nan
            if running[b]:
                rows = observations[b, i, :slots]
                out[b, i] = _alignment(rows, actions[b, i], along_x, least)


@kernel
def _alignment(rows: Any, action: Any, along_x: bool, least: float) -> float:
    """|vᵀf|/(‖v‖‖f‖) of one robot; NaN if ‖f‖ is below ``least`` (m/s), 0 if v = 0."""
    f_square, v_square, product = 0.0, 0.0, 0.0
    for k in range(rows.shape[1]):
        f = 0.0
        for row in range(rows.shape[0]):
            f += rows[row, k]
        v = 0.0
        if not along_x:
            v = action[k]
        elif k == 0:
            v = 1.0
        f_square += f * f
        v_square += v * v
        product += v * f
    if f_square < least * least:
        return np.nan
    if v_square == 0.0:
        return 0.0
    return min(1.0, abs(product) / np.sqrt(f_square * v_square))
