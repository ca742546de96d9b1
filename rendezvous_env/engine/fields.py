"""The seam at which a kind of random field enters a start, by the type of its rules."""

from typing import Any

from ..compilation import chosen_by_type
from .draw_field import FieldRules, draw_field
from .draw_walls import WallRules, draw_walls
from .walled_in import none_walled_in

Rules = FieldRules | WallRules


def draw_obstacles(key: Any, rules: Rules, starts: Any, n_starts: int, world: Any) -> Any:
    """Draw the obstacles of one episode; whether they found room.

    Args:
        key: random stream, uint64.
        rules: of the field.
        starts: (n, d) start positions, m; only the first ``n_starts`` count.
        n_starts: number of starts to keep clear of.
        world: obstacles of one team, written to.
    """
    draw = draw_walls if isinstance(rules, WallRules) else draw_field
    return draw(key, rules, starts, n_starts, world)


@chosen_by_type(draw_obstacles)
def _compiled_draw_obstacles(key, rules, starts, n_starts, world):
    draw = draw_walls if rules.instance_class is WallRules else draw_field
    return lambda key, rules, starts, n_starts, world: draw(key, rules, starts, n_starts, world)


def is_possible(rules: Rules, world: Any, positions: Any, chains: Any) -> Any:
    """Whether the robots can reach one another, if the field promises that.

    Args:
        rules: of the field; walls close nothing in, see ``draw_walls``.
        world: obstacles of one team.
        positions: (n, d), m.
        chains: (M, 2) int64, working memory.
    """
    if isinstance(rules, WallRules) or rules.passage == 0.0:
        return True
    return none_walled_in(world, positions, rules.passage, chains)


@chosen_by_type(is_possible)
def _compiled_is_possible(rules, world, positions, chains):
    if rules.instance_class is WallRules:
        return lambda rules, world, positions, chains: True
    return lambda rules, world, positions, chains: (
        rules.passage == 0.0 or none_walled_in(world, positions, rules.passage, chains)
    )
