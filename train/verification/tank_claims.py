"""The claims of theorem D: any motion at all, while its ledger lasts (guarantees 8)."""

from __future__ import annotations

from .claim import Claim
from .judging import keeps, meets
from .promises import anything
from .tank_cases import draw_bodies, draw_ledgers, draw_obstructed, draw_timed, tanked
from .tank_watches import (
    ledger_is_kept,
    nothing_rises_above,
    stays_below_start,
    stays_bounded,
)
from .time_limits import bound_d, for_a_while

TANK = (
    Claim(
        "tank-ledger",
        "any wishes under a tank: V + ΣA never rises in a step without a merge, A ≥ 0",
        draw_ledgers,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=ledger_is_kept,
    ),
    Claim(
        "tank-start",
        "any wishes under a tank: V ≤ V(0) + ΣB until the first merge",
        draw_ledgers,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=stays_below_start,
    ),
    Claim(
        "theorem-D",
        "any wishes under a tank: V ≤ V0⁺ + (n−1)rW + ΣB always, all meet, T ≤ D",
        draw_timed,
        tanked,
        bound_d,
        (meets, keeps),
        anything,
        timed=True,
        watch=stays_bounded,
    ),
    Claim(
        "tank-obstacles",
        "the same among obstacles: V ≤ V(0) + ΣB in motion without contact or merge",
        draw_obstructed,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=stays_below_start,
    ),
    Claim(
        "tank-nonholonomic",
        "any inputs of nonholonomic robots: V ≤ V(0) + ΣB until the first merge, bounded always",
        draw_bodies,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=nothing_rises_above,
    ),
)
