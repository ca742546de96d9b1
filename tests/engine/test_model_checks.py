"""Validation of custom robot models at registration."""

import dataclasses
import math
import pickle
from typing import NamedTuple

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env.robots import motion, robot_models

pytestmark = pytest.mark.usefixtures("registry")


class Still(NamedTuple):
    """Constants of an incompletely defined robot model."""

    duration: float
    speed_limit: float


def test_invalid_model_is_rejected_with_reason():
    good = {"constants": lambda s: Still(s.tau, 1.0), "bounds": lambda s: [1.0] * 2}
    with pytest.raises(ValueError, match="it must be a RobotModel"):
        rv.register_robot_model("still")
    rv.register_robot_model(rv.RobotModel("still", dims=(2,), **good))
    with pytest.raises(ValueError, match="are a Still; register its equations"):
        rv.Simulator(rv.Scenario(robot_model="still"))
    hover = motion._MOTIONS[type(rv.Scenario().model.constants(rv.Scenario()))]
    with pytest.raises(TypeError, match="chord_error_bound of a Still is 3; it must be a function"):
        rv.describe_motion(Still, hover._replace(chord_error_bound=3))
    with pytest.raises(ValueError, match="must be a NamedTuple class"):
        rv.describe_motion(dict, hover)
    rv.describe_motion(Still, hover)
    with pytest.raises(ValueError, match="has been described before"):
        rv.describe_motion(Still, hover._replace(drifts=True))
    short = rv.RobotModel("still", **good | {"dims": (2,), "constants": lambda s: Still(0.0, 1.0)})
    rv.register_robot_model(short, replace=True)
    with pytest.raises(ValueError, match=r"duration in .* is 0\.0; it must be the step, 0\.05 s"):
        rv.Simulator(rv.Scenario(robot_model="still", time_step=0.05, allow_long_step=True))


def walker(equations=None, fastest=1.5, **fields):
    """Register a valid robot model with some equations and fields replaced."""

    def propose(model, action, frame, memory):
        way = model.duration * action[0], model.duration * action[1]
        return way, math.hypot(*way)

    class Walker(NamedTuple):
        duration: float
        speed_limit: float

    rv.describe_motion(Walker, rv.Motion(**{"propose": propose} | (equations or {})))
    good = {
        "name": "walker",
        "dims": (2,),
        "constants": lambda s: Walker(s.tau, fastest * s.speed_limit),
        "bounds": lambda s: [s.speed_limit] * 2,
    }
    model = rv.RobotModel(**good | fields)
    rv.register_robot_model(model)
    return model


def test_minimal_model_needs_only_propose():
    walker()
    scenario = rv.Scenario(robot_model="walker")
    assert scenario.action_size == 2
    del robot_models.ROBOT_MODELS["walker"]  # as in a program that knows another model
    with pytest.raises(ValueError, match="robot model 'walker' is not registered here; import th"):
        rv.Simulator(pickle.loads(pickle.dumps(scenario)))


KEEPS = {"n_angles": 1, "n_kept": lambda dim: 1}


def evenly(model, action, frame, memory, time):
    return time * action[0], time * action[1]


def bent(model, action, frame, memory, time):
    """A path with a larger deviation from its chord than declared."""
    return time * action[0] + time * (model.duration - time) * 9.0, time * action[1]


TURNS = {"init": lambda model, key, counter: (0.5,), "displacement_at": evenly}
BAD_EQUATIONS = {
    "NaN": ({"propose": lambda *_: ((math.nan, 0.0), 1.0)}, {}, "propose .* 2 finite numbers"),
    "of space": ({"propose": lambda *_: ((0.0, 0.0, 0.0), 0.0)}, {}, "a tuple of 2 finite"),
    "no pair": ({"propose": lambda *_: 3.0}, {}, "a displacement and the path length"),
    "text": ({"propose": lambda *_: (("a", "b"), 1.0)}, {}, "2 finite numbers"),
    "negative length": ({"propose": lambda *_: ((0.0, 0.0), -1.0)}, {}, "or longer"),
    "a length below the way's": ({"propose": lambda *_: ((1e-3, 0.0), 0.0)}, {}, "or longer"),
    "beyond the speed limit": (
        {"propose": lambda model, *_: ((2 * model.speed_limit * model.duration, 0.0), 1e9)},
        {},
        "speed_limit times",
    ),
    "raises": ({"propose": lambda *_: [][0]}, {}, "propose of .* fails: IndexError"),
    "a frame that is none": ({"frame": lambda *_: (2.0, 0.0, 0.0, 2.0)}, {}, "a rotation"),
    "forgets": ({**TURNS, "update": lambda *_: ()}, KEEPS, "update .* 1 finite"),
    "begins with nothing": ({}, KEEPS, "init .* 1 finite"),
    "goes elsewhere": ({**TURNS, "displacement_at": lambda *_: (9.0, 9.0)}, KEEPS, "_at .* what"),
    "negative bend": ({**TURNS, "chord_error_bound": lambda *_: -1.0}, KEEPS, "bound .* 0 or more"),
    "comes back before it goes": ({**TURNS, "period": lambda *_: 0.0}, KEEPS, "period .* positive"),
    "more bent than it says": ({**TURNS, "displacement_at": bent}, KEEPS, "curvature"),
    "senses what it does not say": ({"sense": lambda *_: (1.0, 0.0)}, {}, "sense .* 0 finite"),
    "senses nothing after all": ({}, {"senses": "velocity"}, "sense .* 2 finite"),
}
BAD_FIELDS = {
    "bounds NaN": ({"bounds": lambda s: [1.0, math.nan]}, r"bounds\[1\] .* is nan"),
    "bounds negative": ({"bounds": lambda s: [-1.0, 1.0]}, r"bounds\[0\] .* is -1.0"),
    "bounds empty": ({"bounds": lambda s: []}, "must be a list of numbers"),
    "bounds a number": ({"bounds": lambda s: 1.0}, "must be a list of numbers"),
    "bounds too few": ({"bounds": lambda s: [1.0]}, "propose of .* fails: IndexError"),
    "bounds too many": ({"bounds": lambda s: [1.0] * 3}, r"do not use action\[2\]"),
    "bounds raise": ({"bounds": lambda s: s.nothing}, "bounds of .* fails: AttributeError"),
    "bounds no function": ({"bounds": [1.0, 1.0]}, "bounds of .* must be a function"),
    "constants none": ({"constants": None}, "constants of .* is None; it must be a function"),
    "constants raise": ({"constants": lambda s: 1 / "a"}, "constants of .* fails: TypeError"),
    "constants a dict": ({"constants": lambda s: {}}, "are a dict; register its equations"),
    "angles": ({"n_angles": -1}, "n_angles of .* is -1; it must be an integer, 0 or .* 4"),
    "kept": ({"n_kept": 2}, "n_kept of .* is 2; it must be a function"),
    "kept what": ({"n_kept": lambda dim: "a"}, "keeps 'a' numbers"),
    "kept much": ({"n_kept": lambda dim: 6}, "keeps 6 numbers.* from 0.* to 5"),
    "kept velocity": ({"n_kept": lambda dim: 3, "keeps_velocity": True}, "be 2"),
    "kept angles": ({"n_angles": 2, "n_kept": lambda dim: 1}, "from 2"),
    "flag": ({"keeps_velocity": 1}, "keeps_velocity of .* is 1; it must be one of True, False"),
    "senses": ({"senses": "smell"}, "senses of .* is 'smell'; it must be one of"),
    "dims": ({"dims": None}, "must be a tuple of 2 and 3"),
    "dims of lists": ({"dims": ([2],)}, "must be a tuple of 2 and 3"),
    "taken": ({"name": "unicycle"}, "is already registered; replace=True"),
    "no name": ({"name": ""}, "must be a word"),
    "name a number": ({"name": 3}, "must be a word"),
    "action": ({"action": None}, "action of .* is None; it must be a text"),
    "bounded": ({"bounded": True}, r"speed_limit .* is 6\.0; it must be the scenario's 4 m/s, si"),
    "theorem": ({"theorem": 3}, "theorem of .* is 3; it must be a text"),
}


BAD = BAD_EQUATIONS | {case: ({}, *wrong) for case, wrong in BAD_FIELDS.items()}


@pytest.mark.parametrize("case", BAD)
def test_unusable_model_is_rejected_at_registration(case):
    equations, fields, message = BAD[case]
    known = set(robot_models.ROBOT_MODELS)
    with pytest.raises((ValueError, TypeError), match=message):
        walker(equations, **fields)
    assert set(robot_models.ROBOT_MODELS) == known


def bounded(share=1, turned=1, least=0, **fields):
    """A model that moves by its action, rotated into the global frame and bounded, or nearly so."""

    def propose(model, action, frame, memory):
        speed = math.hypot(*action)
        scale = share * model.duration * min(1.0, model.speed_limit / speed if speed else 1.0)
        scale *= speed >= least
        along, aside = scale * action[0], scale * action[1] * turned
        way = frame[0] * along + frame[1] * aside, frame[2] * along + frame[3] * aside
        return way, math.hypot(*way)

    return walker({"propose": propose}, 1, bounded=True, **fields)


def test_bounded_model_gets_theorems():
    model = bounded()
    assert rv.certificate(rv.Scenario(robot_model="walker")).guaranteed
    for most in (0.02, 20.0):  # tanks would go more slowly, or be paid for more, than is so
        other = dataclasses.replace(model, name="other", bounds=lambda s, most=most: [most] * 2)
        with pytest.raises(ValueError, match=r"bounds\[0\] .* must be the scenario's 4 m/s"):
            rv.register_robot_model(other)
    twice = lambda s: model.constants(s)._replace(duration=2.0 * s.tau)  # noqa: E731
    rv.register_robot_model(dataclasses.replace(model, constants=twice), replace=True)
    with pytest.raises(ValueError, match=r"duration .* it must be the step, 0\.025 s"):
        rv.Simulator(rv.Scenario(robot_model="walker"))


@pytest.mark.parametrize(
    "wrong",
    [{"share": 0.5}, {"turned": -1}, {"bounds": lambda s: [s.speed_limit] * 3}, {"least": 0.1}],
    ids=["half of it", "mirrored", "three numbers", "not below 0.1 m/s"],
)
def test_no_theorem_applies_to_misdeclared_bounded_model(wrong):
    message = "propose .* of 2 numbers, limited to 4 m/s at most, since the model is bounded"
    with pytest.raises(ValueError, match=message):
        bounded(**wrong)


@pytest.mark.parametrize("name", ["unicycle", "double_integrator"])
def test_built_in_equations_are_not_for_bounded_models(name):
    model = dataclasses.replace(robot_models.ROBOT_MODELS[name], name="walker", bounded=True)
    with pytest.raises(ValueError, match="since the model is bounded"):
        rv.register_robot_model(model)
    free = dataclasses.replace(robot_models.ROBOT_MODELS["single_integrator"], name="walker")
    rv.register_robot_model(free)
    assert rv.certificate(rv.Scenario(robot_model="walker")).guaranteed


@pytest.mark.parametrize("name", sorted(robot_models.ROBOT_MODELS))
def test_built_in_models_pass_validation(name):
    model = robot_models.ROBOT_MODELS[name]
    for dim in model.dims:
        scenario = rv.Scenario(robot_model=name, dim=dim)
        constants = model.constants(scenario)
        motion_of = motion.motion_of(type(constants))
        bounds = np.array(model.bounds(scenario))
        robot_models.try_equations(model, motion_of, constants, bounds, dim)


def test_old_equation_names_warn():
    with pytest.warns(DeprecationWarning, match="bend is called chord_error_bound now"):
        old = rv.Motion(propose=math.hypot, bend=math.sin)
    assert old == rv.Motion(propose=math.hypot, chord_error_bound=math.sin)
    with pytest.raises(TypeError, match="turns"):
        rv.Motion(propose=math.hypot, turns=math.sin)
