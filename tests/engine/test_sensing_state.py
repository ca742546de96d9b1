"""What a sensor that errs remembers: as state, in copies, and when a team begins anew."""

from __future__ import annotations

import numpy as np
from conftest import refusing
from test_sensing_engine import PLANE, WORST, act, sensing, simulator

import rendezvous_env as rv


def test_the_state_knows_the_past_only_with_a_delay():
    assert "past" not in simulator(sensing(PLANE, noise=0.1)).get_state()
    sim = simulator(sensing(PLANE, delay=2))
    state = sim.get_state()
    assert state["past"].shape == (1, 3, 5, 4, 2) and state["past"].dtype == np.float32
    for wrong, message in ((np.nan, "finite"), (1e20, "at most")):
        bad = state["past"].copy()
        bad[0, 1, 2] = wrong
        with refusing(sim, rf"state: past\[0, 1, 2, 0, 0\].*{message}"):
            sim.set_state(state | {"past": bad})
    with refusing(sim, "past"):
        sim.set_state({name: value for name, value in state.items() if name != "past"})
    with refusing(sim, "past is float32 of shape"):
        sim.set_state(state | {"past": state["past"][:, :2]})


def test_a_restart_forgets_what_was_seen():
    scenario = PLANE.replace(sensing=WORST)
    sim = simulator(scenario, batch=3)
    for step in range(5):
        outcome = act(sim, step)
    kept = outcome.observations.copy()
    sim.restart(np.array([False, True, False]), outcome)
    fresh = rv.Simulator(scenario)
    fresh.reset(4)
    assert (outcome.observations[1:2] == fresh.reset()).all()
    assert (outcome.observations[[0, 2]] == kept[[0, 2]]).all()
    for step in range(5, 9):
        assert (act(sim, step).observations[1:2] == act(fresh, step).observations).all()
