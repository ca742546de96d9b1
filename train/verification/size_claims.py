"""Claims about the size L of a team, and what follows from it (guarantees 9, 10, 11 and 13)."""

from __future__ import annotations

from .claim import Claim
from .judging import falls, keeps, meets
from .laws import by_name, certified, weighted
from .occlusion import what_is_seen
from .promises import as_chosen, by_law_1, no_rise
from .pursuit import pursuit
from .size_cases import (
    draw_followed,
    draw_held,
    draw_pursuers,
    draw_uniform,
)
from .time_limits import (
    bound_c,
    bound_gains,
    bound_held,
    bound_law_1,
    bound_occluded,
    bound_pursuit,
)
from .watches import bodies_stay_apart, hull_draws_back, hull_shrinks

_law_1 = by_name("bearing-only")

SIZE = (
    Claim(
        "bound-C-uniform",
        "any policy under certified headings, complete graph of one weight: T ≤ V0/(2(n−1)ε²a²)",
        draw_uniform,
        certified,
        bound_c,
        (meets, falls),
        as_chosen,
        timed=True,
    ),
    Claim(
        "theorem-G",
        "law (1): the hull never grows, T ≤ the smaller of A and G",
        draw_followed,
        _law_1,
        bound_law_1,
        (meets, keeps),
        by_law_1,
        timed=True,
        watch=hull_shrinks,
    ),
    Claim(
        "gain-wrapper",
        "any weights of neighbours, a* ≤ Σ_j c_ij ≤ D̄: the hull never grows, T ≤ G with c = a*",
        draw_followed,
        weighted,
        bound_gains,
        (meets, keeps),
        no_rise,
        timed=True,
        watch=hull_draws_back,
    ),
    Claim(
        "bound-N",
        "law (1), all D_i equal, τ ≤ (r/2c) sin(βπ/n): T ≤ G sin(π/n)/sin((1−β)π/n) + (n−1)τ",
        draw_held,
        _law_1,
        bound_held,
        (meets,),
        by_law_1,
        timed=True,
    ),
    Claim(
        "pursuit",
        "2-D, 3-D: turn to one robot, drive at c < ω_max r/2 if aligned: T ≤ G + nπ/(ω_max − 2c/r)",
        draw_pursuers,
        pursuit,
        bound_pursuit,
        (meets,),
        no_rise,
        timed=True,
    ),
    Claim(
        "bodies",
        "discs and balls of radius r/2 never overlap before they dock, whatever the policy",
        draw_uniform,
        certified,
        bound_c,
        (keeps, meets),
        as_chosen,
        watch=bodies_stay_apart,
    ),
    Claim(
        "occlusion",
        "law (1) on what robots of radius r/2 do not hide: T ≤ G with c = a*",
        draw_uniform,
        what_is_seen,
        bound_occluded,
        (meets, keeps),
        no_rise,
        timed=True,
        watch=hull_shrinks,
    ),
)
