"""Bitwise recomputation of observations of exact sensors from recordings."""

import numpy as np
import pytest
from test_initial_conditions import FAR

import rendezvous_env as rv
from rendezvous_env import graphs
from rendezvous_env.scenario import scenarios
from train import policies
from train.compare import Job, play_job
from train.recording import observations, with_observations

NAMES = "fig4", "trap", "clutter-16-team-8", "random-10", "unicycle-6", "uav-6", "cloud-8"
TEAMS = [
    *map(scenarios.get, NAMES),
    rv.Scenario(name="listed links", n_robots=40, graph=graphs.cycle((0.5, 1.5))),
    rv.Scenario(name="inertia", n_robots=4, robot_model="double_integrator", obstacles=FAR),
]


@pytest.mark.parametrize(
    "team",
    [*TEAMS[:-1], pytest.param(TEAMS[-1], marks=pytest.mark.slow)],
    ids=lambda team: team.name,
)
def test_exact_observations_are_recomputed_bitwise(team):
    scenario, name = team.replace(time_limit=6.0), team.name
    law, count = policies.fitting(scenario, ())[-1], 6 if name == "inertia" else 3
    seen, merges = shown(scenario, law, count), 0
    for team, recording in enumerate(recordings(scenario, law, count)):
        assert "observations" not in recording
        at = np.rint(recording["times"] / scenario.tau).astype(int)
        assert np.array_equal(observations(recording, scenario), seen[at, team])
        merges += int((~recording["active"][-1]).sum())
    assert merges > 0 or name == "inertia"


def shown(scenario, law, count):
    """Observations of the same environments, (T, B, n, rows, d)."""
    policy = policies.make(law, scenario)
    return rv.rollout(scenario, policy, 5, num_envs=count, record="observations").observations


def recordings(scenario, law, count):
    played = play_job(Job(scenario, law), episodes=count, seed=5, keep=count)
    return played.recordings.values()


def test_imperfect_observations_are_stored():
    sensor = rv.Sensing(noise=0.3, dropout=0.2, delay=2)
    scenario = rv.Scenario(name="blurred", n_robots=3, sensing=sensor, time_limit=1)
    (kept,) = recordings(scenario, "bearing-only", 1)
    assert "weights" not in kept and with_observations(kept, scenario) is kept
    assert np.array_equal(kept["observations"], shown(scenario, "bearing-only", 1)[:, 0])
