"""Directed sensing graphs: a robot need not be seen by whom it sees (guarantees, section 10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .graph_checks import ordered_arcs
from .graph_kinds import LARGE_TEAM, Graph
from .graph_numbers import closed_groups, least_weight, max_out_degree
from .topologies import DIRECTED


@dataclass(frozen=True)
class DirectedGraph(Graph):
    """Arcs i → j, robot i sees robot j, with weights a_ij, m/s.

    ``edges`` are the arcs, each once; ``links`` lists (who sees, who is seen, weight).
    """

    _KINDS: ClassVar[tuple[str, ...]] = ("directed", "directed_cycle")
    _LISTED: ClassVar[str] = "directed"

    def _ordered(self, n: int) -> tuple[tuple[int, int, float], ...]:
        return ordered_arcs(self.edges, n)

    @property
    def directed(self) -> bool:
        """True, even if every arc has a way back: the weights of the two are not one."""
        return True

    @property
    def topology(self) -> int:
        """DIRECTED."""
        return DIRECTED

    def links(self, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """The arcs before drawing: who sees, who is seen, and weights in m/s; each (E,)."""
        arcs = (
            self._edges_for(n)
            if self.kind == self._LISTED
            else tuple((i, (i + 1) % n, 1.0) for i in range(n))
        )
        table = np.array(arcs, dtype=np.float64).reshape(-1, 3)
        return table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2].copy()

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """Weights before drawing, (n, n): row i is what robot i gives to those it sees.

        Raises:
            ValueError: if the graph's arcs are for another number of robots.
        """
        weights = np.zeros((n, n))
        sees, seen, weight = self.links(n)
        weights[sees, seen] = weight
        return weights

    def why_not_joined(self, n: int) -> str | None:
        """Why robots of this graph need not meet, in words; None if a globally reachable one makes
        them (guarantees, section 10).
        """
        return why_not_led_together(self.base_weights(n))

    def most_neighbours(self, n: int) -> int:
        """The most robots that one can come to see, merges included."""
        out = (self.base_weights(n) > 0).sum(axis=1)
        return 1 if out.max(initial=0) <= 1 else n - 1

    def max_degree(self, n: int) -> float:
        """D̄, m/s: the largest D_i = Σ_j a_ij, over who is seen, that merges can produce."""
        base, (_, high) = self.base_weights(n), self.weight_range
        pieces = self.components(n)
        return max((max_out_degree(base[np.ix_(c, c)] * high) for c in pieces), default=0.0)

    def step_degree(self, n: int) -> float:
        """The D_i, m/s, that a step is made for; of a large team the largest before any merge."""
        worst = self.max_degree(n)
        if n < LARGE_TEAM:
            return worst
        return min(worst, self.weight_range[1] * float(self.base_weights(n).sum(axis=1).max()))

    def bottleneck_weight(self, n: int) -> float:
        """The least weight of an arc, m/s, in the place of a*: the least D_i of a robot that sees
        someone (c of theorem G).
        """
        return least_weight(self.base_weights(n)) * self.weight_range[0]

    def weight_sum(self, n: int) -> float:
        """W, m/s: half the sum of all arcs, so that V ≤ 2 W × the largest distance."""
        return 0.5 * float(self.base_weights(n).sum()) * self.weight_range[1]


def why_not_led_together(weights: NDArray[np.float64]) -> str | None:
    """Why no robot is globally reachable, in words; None if one is (guarantees, section 10).

    Args:
        weights: (n, n), a_ij > 0 where robot i sees robot j.
    """
    groups = closed_groups(weights)
    if len(groups) == 1:
        return None
    listed = " and ".join(map(str, groups))
    return (
        f"{listed} each see nobody outside their own group, and so need not meet (guarantees, "
        "section 10); let some robot be reached from all"
    )
