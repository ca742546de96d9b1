"""Number of initial conditions of a scenario: one without relevant randomness."""

import numpy as np
import pytest
from parameters import marked

from rendezvous_env import Capsule, Disc, ObstacleField, Scenario, Simulator, graphs
from rendezvous_env.engine.preparation import has_fixed_start
from rendezvous_env.scenario import scenarios
from train.compare import compare
from train.compare.evaluation import counts_contacts, starts_of

GIVEN = Scenario(n_robots=3, start_positions=((0.0, 0.0), (3.0, 0.0), (0.0, 4.0)))
FAR = Capsule(((90.0, 0.0), (91.0, 0.0)), 0.1)
"""The double integrator needs no further compilation, as other tests have it."""
CYCLIST = GIVEN.replace(robot_model="unicycle")
CASES = {
    "fig3": scenarios.get("fig3"),
    "given": GIVEN,
    "drawn places": GIVEN.replace(start_positions=None),
    "fixed discs": GIVEN.replace(obstacles=Disc((1.0, 1.0), 0.3)),
    "drawn discs": GIVEN.replace(obstacles=ObstacleField(2, (0.1, 0.2), 2.0, 0.2)),
    "drawn gains": GIVEN.replace(graph=graphs.complete((0.5, 2.0))),
    "drawn tree": GIVEN.replace(graph=graphs.random_tree()),
    "drawn headings": CYCLIST,
    "given headings": CYCLIST.replace(start_headings=((0.1,), (0.2,), (0.3,))),
    "at rest": GIVEN.replace(robot_model="double_integrator", obstacles=FAR),
}


def starts(scenario, seeds):
    """Content of several initial conditions, without the robots' frames."""
    simulator = Simulator(scenario, seeds)
    simulator.reset(0)
    parts = (simulator.positions, simulator.headings, simulator.weights, simulator.obstacles)
    return [tuple(part[b].tobytes() for part in parts) for b in range(seeds)]


@pytest.mark.parametrize("case", marked(CASES, slow=["at rest"]))
def test_fixed_initial_condition_counts_once(case):
    found = len(set(starts(CASES[case], 16)))
    assert has_fixed_start(CASES[case]) == (found == 1), found
    assert starts_of(CASES[case], 16) == (1 if found == 1 else 16)


def test_random_frames_do_not_count_as_randomness():
    """fig4 samples the frames, and law (1) moves all teams equally up to rounding."""
    import baselines
    from rendezvous_env import rollout

    scenario = scenarios.get("fig4").replace(time_limit=1.0)
    moved = rollout(scenario, baselines.make("bearing-only", scenario), num_envs=5)
    assert np.ptp(moved.positions, axis=1).max() < 1e-5


def test_contacts_count_unless_ignored():
    fig3, fig4 = scenarios.get("fig3"), scenarios.get("fig4")
    assert counts_contacts(fig4) and not counts_contacts(fig3)
    assert counts_contacts(fig3.replace(obstacles=()))  # nothing to touch: all is clean


@pytest.mark.parametrize(
    ("name", "count", "kept"),
    [("fig4", 1, 3), ("swarm-20", 100, 3), ("clutter-16-team-8", 100, 3),
     ("clutter-16-team-16", 50, 1), ("clutter-16-team-32", 25, 1)],
)  # fmt: skip
def test_many_robots_among_obstacles_get_fewer_episodes(name, count, kept):
    scenario = scenarios.get(name)
    usual = compare.Config()
    assert (usual.count(scenario), usual.kept(scenario)) == (count, kept)
    asked = compare.Config(episodes=7, keep=2)
    assert (asked.count(scenario), asked.kept(scenario)) == (min(7, count), 2)
