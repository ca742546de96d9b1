"""Suggestions for unknown names: synonyms and similar words."""

import difflib
import re
from collections.abc import Iterable
from typing import Any

_LONGEST_WORD = 100
STEPS = ("max_steps", "max_episode_steps", "horizon", "episode_length")
_SYNONYMS = {
    "n_robots": ("n", "n_agents", "num_agents", "num_robots", "team_size"),
    "dim": ("d", "dimension", "ndim", "n_dims"),
    "robot_model": ("model", "dynamics", "kinematics"),
    "merge_radius": ("r", "rendezvous_radius", "meeting_radius", "capture_radius"),
    "time_step": ("dt", "tau", "timestep", "step_size", "certified_step"),
    "max_cycles": STEPS,
    "time_limit": STEPS,
    "max_speed": ("v_max", "speed_limit", "speed_limits", "min_speed_limit", "max_velocity"),
    "max_turn_rate": ("turn_limit", "min_turn_limit", "omega_max", "max_angular_velocity"),
    "max_acceleration": ("a_max", "acceleration_limit"),
    "spawn_size": ("spawn_edges", "spawn_diagonal", "arena_size", "world_size"),
    "obstacle_contact": ("contact_mode", "collision", "collisions"),
    "sensing": ("sensor", "sensors"),
    "graph": ("sensing_graph", "topology", "adjacency"),
    "positions": ("start_positions", "initial_positions"),
    "headings": ("start_headings", "initial_headings"),
    "weights": ("graph", "adjacency", "edge_weights"),
    "cycle": ("ring", "circle", "loop"),
    "path": ("line", "chain"),
    "complete": ("full", "fully_connected", "all", "clique"),
    "erdos_renyi": ("gnp", "er"),
    "proximity": ("disk", "geometric"),
    "error": ("adversarial_error",),
}
"""Names of the same concepts in other packages, and of properties that follow from a field."""


def nearest_word(
    word: Any, words: Iterable[str], cutoff: float = 0.65, parts: bool = True
) -> str | None:
    """Known word for ``word``: a synonym, a similar word, or one that contains it.

    A similar word has a similarity of at least ``cutoff`` (at most 1). Parts are separated by - and
    _; with ``parts=False`` they do not count.
    """
    if not isinstance(word, str) or len(word) > _LONGEST_WORD:
        return None
    known = list(words)
    if alike := [one for one in known if _plain(one) == _plain(word)]:
        return alike[0]
    if meant := [ours for ours, theirs in _SYNONYMS.items() if word in theirs and ours in known]:
        return meant[0]
    having = [one for one in known if parts and word in re.split("[-_]", one)]
    close = difflib.get_close_matches(word, known, 1, cutoff)
    close = close or difflib.get_close_matches(word, having, 1, 0.0)
    return close[0] if close else None


def _plain(word: str) -> str:
    return word.lower().replace("-", "_")


def closest_match(word: Any, words: Iterable[str], before: str = "", after: str = "") -> str:
    """Question that suggests the ``nearest_word``, between two texts; empty without one."""
    near = nearest_word(word, words)
    return f"{before}did you mean {near!r}?{after}" if near else ""
