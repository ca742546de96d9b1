"""Teams of several robot models.

Each robot has the model of one *member*, and all have the same layout of actions and memory:

    action    as many components as the widest member has; each robot uses its first ones
    memory    as many angles as a member has at most, then other quantities, such as a velocity

The frame of a robot without angles, in a team in which others have some, is given by the angles: a
constant rotation, in 3-D without roll.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import raise_invalid
from ..compilation import by_type, kernel
from ..physics.random_streams import uniform
from .motion import (
    Motion,
    chord_error_bound,
    constants_of_robot,
    describe,
    displacement_at,
    frame_of,
    frame_turns,
    init_memory,
    is_number,
    keeps_memory,
    period,
    propose,
    proprioception,
    update_memory,
)
from .nonholonomic_3d import body_frame_3d
from .robot_models import RobotModel, constants_of
from .unicycle import body_frame_2d

MAX_MEMBERS = 3
"""Largest number of different robot models in a team."""
_OWN_COLUMNS = 5  # of the table of constants, ahead of those of a robot's member


class _Places(NamedTuple):
    """Entries that a model uses of an action or memory of the team: the first ones, then others.

    The others follow the team's angles. Only lengths of these tuples count, so that compiled loops
    know the entries.
    """

    entries: tuple[int, ...]  # one for each entry that the model uses
    own: tuple[int, ...]  # one for each of the first ones: of a memory, the angles of the model
    angles: tuple[int, ...]  # one for each angle of the team


class MixedTeam(NamedTuple):
    """Constants of a robot of a team with several models."""

    duration: float  # τ, s
    speed_limit: float  # of the robot, m/s
    member: float  # index of its model among the members
    in_global_frame: float  # 1 if frames without angles are the global one, else 0
    is_steady: float  # 1 if no step changes its memory and frame, else 0
    members: tuple[Any, ...]  # constants of each model
    inputs: tuple[_Places, ...]  # of each model, its components of an action
    kept: tuple[_Places, ...]  # of each model, its entries of the memory
    angles: _Places  # entries of the memory that are angles
    blank: tuple[float, ...]  # a memory of zeros
    unsensed: tuple[float, ...]  # proprioception of models without any: zeros, or nothing


@by_type("model", frame_turns)
def _turns(model):
    """True if the frame of robots of this model may turn."""


@kernel(inline="code")
def _place(places, m):
    """Index of entry m that a model uses."""
    return m if m < len(places.own) else m + len(places.angles) - len(places.own)


@kernel(inline="code")
def _part(values, places):
    """Entries that a model uses, at most five numbers."""
    return _chosen(values, places.entries, places)


@kernel(inline="code")
def _chosen(values, entries, places):
    if len(entries) == 0:
        return ()
    first = values[_place(places, 0)]
    if len(entries) == 1:
        return (first,)
    second = values[_place(places, 1)]
    if len(entries) == 2:
        return first, second
    third = values[_place(places, 2)]
    if len(entries) == 3:
        return first, second, third
    fourth = values[_place(places, 3)]
    if len(entries) == 4:
        return first, second, third, fourth
    return first, second, third, fourth, values[_place(places, 4)]


@kernel(inline="code")
def _entry(memory, places, values, k):
    for m in range(len(values)):
        if _place(places, m) == k:
            return values[m]
    return memory[k]


@kernel(inline="code")
def _replaced(memory, kept, values):
    """Memory, of at most five numbers, with other values where a model keeps them."""
    if len(values) == 0:
        return memory
    first = _entry(memory, kept, values, 0)
    if len(memory) == 1:
        return (first,)
    second = _entry(memory, kept, values, 1)
    if len(memory) == 2:
        return first, second
    third = _entry(memory, kept, values, 2)
    if len(memory) == 3:
        return first, second, third
    fourth = _entry(memory, kept, values, 3)
    if len(memory) == 4:
        return first, second, third, fourth
    return first, second, third, fourth, _entry(memory, kept, values, 4)


@kernel(inline="code")
def _members_of_robot(members, table, i):
    """Constants of robot i for each model; those of other models than its own have no meaning."""
    first, second = members[0], members[1]
    one, two = constants_of_robot(first, table, i), constants_of_robot(second, table, i)
    if len(members) == 2:
        return one, two
    return one, two, constants_of_robot(members[2], table, i)


@kernel(inline="code")
def _of_robot(model, table, i):
    """Constants of robot i, from row i of the table of ``mixed_limits``."""
    return MixedTeam(
        table[i, 0],
        table[i, 1],
        table[i, 2],
        table[i, 3],
        table[i, 4],
        _members_of_robot(model.members, table[:, _OWN_COLUMNS:], i),
        model.inputs,
        model.kept,
        model.angles,
        model.blank,
        model.unsensed,
    )


def _by_member(equation: Any) -> Any:
    """Kernel that applies an equation to the member of a robot.

    ``equation`` takes the constants of a member, its places of action and memory, and a tuple of
    the other arguments, which begins with the constants of the robot.
    """

    @kernel(inline="code")
    def chosen(members, inputs, kept, given):
        member = int(given[0].member)
        if member == 0:
            return equation(members[0], inputs[0], kept[0], given)
        if len(members) > 2:
            if member == 2:
                return equation(members[2], inputs[2], kept[2], given)
        return equation(members[1], inputs[1], kept[1], given)

    return chosen


@kernel(inline="code")
def _propose_as(member, inputs, kept, given):
    _, action, frame, memory = given
    return propose(member, _part(action, inputs), frame, _part(memory, kept))


@kernel(inline="code")
def _displacement_as(member, inputs, kept, given):
    _, action, frame, memory, time = given
    return displacement_at(member, _part(action, inputs), frame, _part(memory, kept), time)


@kernel(inline="code")
def _chord_error_bound_as(member, inputs, kept, given):
    _, action, memory = given
    return chord_error_bound(member, _part(action, inputs), _part(memory, kept))


@kernel(inline="code")
def _period_as(member, inputs, kept, given):
    _, action, memory = given
    return period(member, _part(action, inputs), _part(memory, kept))


@kernel(inline="code")
def _update_as(member, inputs, kept, given):
    _, action, frame, memory, displacement, contact = given
    own = _part(memory, kept)
    after = update_memory(member, _part(action, inputs), frame, own, displacement, contact)
    return _replaced(memory, kept, after)


@kernel(inline="code")
def _frame_as(member, inputs, kept, given):
    model, frame, memory = given
    if _turns(member):
        return frame_of(member, frame, _part(memory, kept))
    return _frame_at(frame, _part(memory, model.angles))


@kernel(inline="code")
def _frame_at(frame, angles):
    """Frame of a robot without own angles, from the angles of the team; unchanged without any."""
    if len(angles) == 0:
        return frame
    if len(angles) == 1:
        return body_frame_2d(angles[0])
    return body_frame_3d(angles[0], angles[1])


@kernel(inline="code")
def _sense_as(member, inputs, kept, given):
    model, frame, memory = given
    return _or_else(proprioception(member, frame, _part(memory, kept)), model.unsensed)


@kernel(inline="code")
def _or_else(sensed, unsensed):
    if len(sensed) == 0:
        return unsensed
    return sensed


@kernel(inline="code")
def _init_as(member, inputs, kept, given):
    model, key, counter = given
    angles = _first_angles(model.angles.own, model.in_global_frame, key, counter)
    turned = _replaced(model.blank, model.angles, angles)
    return _replaced(turned, kept, init_memory(member, key, counter))


@kernel(inline="code")
def _first_angles(angles, in_global_frame, key, counter):
    """Uniform yaw, and a pitch for which the x axis is uniformly distributed; or zeros, rad."""
    if len(angles) == 0:
        return ()
    drawn = 1.0 - in_global_frame
    yaw = drawn * math.pi * (2.0 * uniform(key, counter) - 1.0)
    if len(angles) == 1:
        return (yaw,)
    return yaw, drawn * math.asin(2.0 * uniform(key, counter + 1) - 1.0)


_propose_by, _displacement_by = _by_member(_propose_as), _by_member(_displacement_as)
_chord_error_bound_by, _period_by = _by_member(_chord_error_bound_as), _by_member(_period_as)
_frame_by = _by_member(_frame_as)
_sense_by, _init_by = _by_member(_sense_as), _by_member(_init_as)


@kernel(inline="code")
def _propose(model, action, frame, memory):
    given = model, action, frame, memory
    return _propose_by(model.members, model.inputs, model.kept, given)


@kernel(inline="code")
def _displacement_at(model, action, frame, memory, time):
    given = model, action, frame, memory, time
    return _displacement_by(model.members, model.inputs, model.kept, given)


@kernel(inline="code")
def _chord_error_bound(model, action, memory):
    given = model, action, memory
    return _chord_error_bound_by(model.members, model.inputs, model.kept, given)


@kernel(inline="code")
def _period(model, action, memory):
    return _period_by(model.members, model.inputs, model.kept, (model, action, memory))


@kernel(inline="code")
def _frame(model, frame, memory):
    return _frame_by(model.members, model.inputs, model.kept, (model, frame, memory))


@kernel(inline="code")
def _sense(model, frame, memory):
    return _sense_by(model.members, model.inputs, model.kept, (model, frame, memory))


class _Member(NamedTuple):
    """Constants of a robot of a team whose model is known while its loops are compiled."""

    team: MixedTeam
    model: Any  # constants of the robot's model
    inputs: _Places
    kept: _Places


@kernel(inline="code")
def _run_with(member, inputs, kept, given):
    team, run, arguments = given
    return run(_Member(team, member, inputs, kept), arguments)


_run_by = _by_member(_run_with)


@kernel(inline="code")
def _for_member(model, run, given):
    return _run_by(model.members, model.inputs, model.kept, (model, run, given))


@kernel(inline="code")
def _propose_member(one, action, frame, memory):
    return _propose_as(one.model, one.inputs, one.kept, (one.team, action, frame, memory))


@kernel(inline="code")
def _update_member(one, action, frame, memory, displacement, contact):
    given = one.team, action, frame, memory, displacement, contact
    return _update_as(one.model, one.inputs, one.kept, given)


@kernel(inline="code")
def _frame_member(one, frame, memory):
    return _frame_as(one.model, one.inputs, one.kept, (one.team, frame, memory))


@kernel(inline="code")
def _is_steady(model):
    return model.is_steady > 0.0


@kernel(inline="code")
def _init(model, key, counter):
    return _init_by(model.members, model.inputs, model.kept, (model, key, counter))


describe(
    MixedTeam,
    Motion(
        propose=_propose,
        displacement_at=_displacement_at,
        chord_error_bound=_chord_error_bound,
        frame=_frame,  # ``update`` is that of each member: see ``for_member``
        sense=_sense,
        init=_init,
        period=_period,
    ),
    of_robot=_of_robot,
    is_steady=_is_steady,
    for_member=_for_member,
)
describe(_Member, Motion(propose=_propose_member, update=_update_member, frame=_frame_member))


def _kept_besides(model: RobotModel, dim: int) -> int:
    """Size of the memory of a robot model without its angles."""
    return model.memory_size(dim) - model.n_angles


@cache
def mixed_model(members: tuple[RobotModel, ...]) -> RobotModel:
    """Robot model of a team with several models."""

    def size(dim: int) -> int:
        return n_angles + max(_kept_besides(member, dim) for member in members)

    n_angles = max(member.n_angles for member in members)
    return RobotModel(
        "mixed",
        dims=tuple(dim for dim in (2, 3) if all(dim in member.dims for member in members)),
        constants=_constants,
        bounds=lambda scenario: scenario.action_bounds.tolist(),
        n_angles=n_angles,
        n_kept=size,
        keeps_velocity=any(member.keeps_velocity for member in members),
        senses=next((member.senses for member in members if member.senses), None),
        action=", or ".join(dict.fromkeys(member.action for member in members)),
    )


def check_members(names: tuple[str, ...], members: tuple[RobotModel, ...], dim: int) -> None:
    """Reject robot models that cannot be in one team."""
    if len(members) > MAX_MEMBERS:
        wanted = f"a list of at most {MAX_MEMBERS} different models"
        raise_invalid("robot_model", list(names), wanted)
    for member in members:
        if dim not in member.dims:
            dims = " or ".join(map(str, member.dims))
            at = f"robot_model[{names.index(member.name)}]"
            raise_invalid(at, member.name, f"a model for dim {dim}; {member.name} is for {dims}")
    if any(member.keeps_velocity for member in members):
        for member in members:
            if not member.keeps_velocity and _kept_besides(member, dim) > 0:
                at = f"robot_model[{names.index(member.name)}]"
                raise_invalid(at, member.name, "a model that keeps angles or a velocity only")


def _constants(scenario: Any) -> MixedTeam:
    """Constants of a team: the largest speed, and the first member."""
    members, dim = scenario.models, scenario.dim
    n_angles, size = scenario.model.n_angles, scenario.model.memory_size(dim)
    angles = (0,) * n_angles
    kept = [
        _Places((0,) * member.memory_size(dim), (0,) * member.n_angles, angles)
        for member in members
    ]
    widths = [len(member.bounds(scenario.of_robot(_first(scenario, member)))) for member in members]
    senses = any(member.senses for member in members)
    return MixedTeam(
        duration=scenario.tau,
        speed_limit=float(scenario.speed_limit),
        member=0.0,
        in_global_frame=float(scenario.local_frames == "global"),
        is_steady=0.0,
        members=tuple(constants_of(scenario.of_robot(_first(scenario, m))) for m in members),
        inputs=tuple(_first_places(width) for width in widths),
        kept=tuple(kept),
        angles=_first_places(n_angles),
        blank=(0.0,) * size,
        unsensed=(0.0,) * (dim if senses else 0),
    )


def _first_places(count: int) -> _Places:
    return _Places(*((0,) * count,) * 3)


def _first(scenario: Any, member: RobotModel) -> int:
    return int(scenario.robot_model.index(member.name))


def mixed_limits(scenario: Any) -> NDArray[np.float64]:
    """Constants of each robot, (n, 4 + most constants of a member), as ``limits_of``."""
    team = _constants(scenario)
    names = [member.name for member in scenario.models]
    width = max(len(member._fields) for member in team.members)
    table = np.full((scenario.n_robots, _OWN_COLUMNS + width), math.nan)
    for robot, name in enumerate(scenario.robot_model):
        own, made = names.index(name), constants_of(scenario.of_robot(robot))
        frames, steady = team.in_global_frame, keeps_memory(type(made))
        table[robot, :_OWN_COLUMNS] = team.duration, made.speed_limit, own, frames, steady
        for column, (field, value) in enumerate(zip(made._fields, made, strict=True)):
            if is_number(type(made), field):
                table[robot, _OWN_COLUMNS + column] = value
            elif value != getattr(team.members[own], field):
                raise ValueError(
                    f"{', '.join(scenario.per_robot)}: robots differ in the constant {field!r} of "
                    f"robot model {name!r}; annotate it as float in its class"
                )
    return table
