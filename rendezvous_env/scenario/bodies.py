"""Robots with bodies: what a scenario must be for them not to overlap."""

from __future__ import annotations

from typing import Any

from .. import checks


def check_bodies(scenario: Any) -> None:
    """Bodies do not overlap: they dock at r, where every pair does, or stop (guarantees 13)."""
    packs, n, radius = scenario.meeting == "pack", scenario.n_robots, scenario.body_radius
    if radius is None:
        if packs:
            checks.refuse("body_radius", None, "given with meeting='pack': bodies touch")
        return
    if radius > 0.5 * scenario.merge_radius:
        most = f"at most half the merge_radius, {0.5 * scenario.merge_radius:g} m"
        checks.refuse("body_radius", radius, most)
    graph = scenario.sensing_graph
    if graph.directed or not graph.fixed or graph.most_links(n) < n * (n - 1) // 2:
        raise ValueError("graph must be complete with a body_radius: others would not stop")
    free = scenario.dim == 2 and not scenario.obstacles
    if packs and not (free and scenario.robot_model == "single_integrator"):
        raise ValueError(
            f"meeting is 'pack'; it must be 'merge' for {scenario.robot_model} robots in "
            f"{scenario.dim}-D{' among obstacles' if scenario.obstacles else ''}: bodies pack as "
            "single integrators in the plane, without obstacles"
        )
