"""Options of a single environment: rejected where they would have no effect."""

import dataclasses

import gymnasium
import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env.envs.gymnasium_env import make_env, make_heading_env
from rendezvous_env.scenario.start_options import OPTIONS

FIELDS = [field.name for field in dataclasses.fields(rv.Scenario)]
FORMS = {
    "parallel": lambda: rv.parallel_env("fig3"),
    "one by one": lambda: rv.rendezvous_v0.env("fig3"),
    "guarantee": lambda: rv.HeadingVectorWrapper(rv.parallel_env("fig3")),
    "one agent": lambda: make_env("fig3"),
    "vector": lambda: rv.make_vec("fig3", 2),
    "vector guarantee": lambda: rv.vector.EnergyTankWrapper(rv.make_vec("fig3", 2)),
    "training": lambda: rv.training_env("fig3"),
    "vector training": lambda: rv.vector.training_env("fig3", 2),
}


@pytest.mark.parametrize("form", FORMS)
def test_reset_refuses_fields_of_the_scenario_as_options(form):
    env = FORMS[form]()
    env.reset(seed=0)
    before = env.unwrapped.simulator.get_state()
    for name in {*FIELDS, "max_cycles"} - {*OPTIONS}:
        message = f"options: '{name}' is (a field of the.*with {name}=|not an option; did you)"
        with pytest.raises(ValueError, match=message):
            env.reset(options={name: 3})
    np.testing.assert_equal(env.unwrapped.simulator.get_state(), before)
    env.reset(options={"minari_autoseed": True, "note": 1})  # of others, ignored
    with pytest.raises(ValueError, match="'n_robots' is a field of the scenario"):
        env.reset(options={"n_robots": None})


@pytest.mark.parametrize(
    "name",
    ["positions", "headings", "velocities", "frames", "weights", "obstacles", "merged_into",
     "active", "ended", "status", "steps", "time", "seeds", "contacts", "path_length",
     "initial_lyapunov", "min_clearance", "clearance"],
)  # fmt: skip
@pytest.mark.parametrize("scenario", ["clutter-4", "unicycle-6"])
def test_state_of_a_simulator_refuses_to_be_written_to(name, scenario):
    simulator = rv.Simulator(scenario, 2)
    simulator.reset(0)
    array = getattr(simulator, name)
    before = array.copy()
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 1
    own = array.copy()  # which may be written to
    own[...] = 1
    np.testing.assert_array_equal(getattr(simulator, name), before)


@pytest.mark.parametrize("form", FORMS)
def test_what_environments_give_out_may_be_written_to(form):
    env = FORMS[form]()
    given = env.reset(seed=0)
    if form == "one by one":
        given = env.last()
    if hasattr(env, "agents"):
        return
    for step in range(2):
        for value in [given[0], *given[-1].values()]:
            if isinstance(value, np.ndarray):
                value[...] = value.dtype.type(0)
        if step == 0:
            given = env.step(np.ones(env.action_space.shape, np.float32))


@pytest.mark.parametrize(
    ("make", "remedy"),
    [
        (rv.training_env, r"rendezvous_env\.vector\.training_env"),
        (rv.parallel_env, r"rendezvous_env\.make_vec"),
        (rv.rendezvous_v0.env, r"rendezvous_env\.make_vec"),
        (make_env, r"gymnasium\.make_vec"),
        (make_heading_env, r"gymnasium\.make_vec"),
    ],
)
def test_forms_of_one_team_name_the_vector_form(make, remedy):
    for wrong in (4, 0, "x"):
        with pytest.raises(ValueError, match=f"num_envs is {wrong!r}; .*for more, use {remedy}"):
            make("duo", num_envs=wrong)
    with pytest.raises(ValueError, match=r"for more, use gymnasium\.make_vec"):
        gymnasium.make("rendezvous/Rendezvous-v0", num_envs=3)
