"""Detection: probability by distance, field of view, blind zone, and its memory."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .blocks import Blocks, half_width
from .errors import SIGNIFICANT, Estimate, most_likely
from .frames import Chances
from .log import Floats, Mask

EDGES = (0.0, 0.3, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 17.0, 22.0, 30.0)
"""Edges of the bins of distance, m; longer ones follow by a factor of 1.3."""
_LEAST = 60
"""Minimum number of opportunities of a bin; smaller bins are merged."""
_FLOOR = 0.003
"""Least probability of detection in likelihoods, so that single errors of truth do not decide."""
_ROUNDS = 3
_RUN = 3.0
"""Consecutive detections that count as one, for the end of the blind zone."""


class Binned(NamedTuple):
    """Share of detections in bins."""

    low: Floats
    high: Floats
    middle: Floats  # mean of the opportunities
    share: Floats
    number: Floats

    def rows(self, digits: int = 4) -> list[list[float]]:
        """Bins as plain rows of low, high, share and opportunities."""
        return [
            [round(float(a), 6), round(float(b), 6), round(float(s), digits), int(n)]
            for a, b, s, n in zip(self.low, self.high, self.share, self.number, strict=True)
        ]


def binned(values: Floats, seen: Mask, edges: Floats) -> Binned:
    """Share of detections by bins; empty bins are left out."""
    place = np.digitize(values, edges) - 1
    inside = (place >= 0) & (place < len(edges) - 1)
    place, count = place[inside], len(edges) - 1
    number = np.bincount(place, minlength=count).astype(np.float64)
    hits = np.bincount(place, seen[inside], minlength=count)
    total = np.bincount(place, values[inside], minlength=count)
    good = number > 0
    return Binned(
        edges[:-1][good], edges[1:][good], total[good] / number[good], hits[good] / number[good],
        number[good],
    )  # fmt: skip


def distance_edges(longest: float) -> Floats:
    """Edges of bins of distance up to the longest, m."""
    edges = list(EDGES)
    while edges[-1] < longest:
        edges.append(edges[-1] * 1.3)
    return np.array(edges)


class View(NamedTuple):
    """Detection of one sensor."""

    nodes: Floats  # (K,), m
    chance: list[Estimate]  # K
    half_field: Estimate  # rad
    falloff: Estimate  # rad
    min_range: Estimate  # m

    def probability(self, chances: Chances) -> Floats:
        """Probability of each opportunity."""
        p = np.interp(chances.distance, self.nodes, [one.value for one in self.chance])
        p = p * share_in_view(chances.bearing, self.half_field.value, self.falloff.value)
        return np.where(chances.distance < self.min_range.value, 0.0, p)


def share_in_view(bearing: Floats, half_field: float, falloff: float) -> Floats:
    """Factor of the detection probability due to the edge of the field of view."""
    inside = half_field - np.abs(bearing)
    if falloff < 1e-9:
        return (inside >= 0.0).astype(np.float64)
    return np.clip(inside / falloff, 0.0, 1.0)


def find_view(chances: Chances, blocks: Blocks) -> View:
    """Field of view, blind zone and probability by distance, estimated alternately."""
    half, falloff = _first_field(chances), 0.0
    blind = Estimate(0.0, 0.0, 0.0)
    nodes, values = np.array([1.0]), np.array([1.0])
    for _ in range(_ROUNDS):
        inner = share_in_view(chances.bearing, half, falloff) >= 0.999
        blind = _blind_zone(chances.some(inner & (np.abs(chances.bearing) <= half)))
        used = inner & (chances.distance >= blind.value)
        nodes, values = _table(chances.some(used))
        half, falloff = _field(chances, nodes, values, blind.value, half)
    inner = (share_in_view(chances.bearing, half, falloff) >= 0.999) & (
        chances.distance >= blind.value
    )
    table = _table_estimates(chances.some(inner), nodes, values, blocks)
    half_field, width = _field_estimates(chances, nodes, values, blind.value, half, falloff, blocks)
    return View(nodes, table, half_field, width, blind)


def _first_field(chances: Chances) -> float:
    """Half of a field of view that holds nearly all detections."""
    seen = np.abs(chances.bearing[chances.seen])
    return float(np.quantile(seen, 0.99)) if len(seen) else math.pi


def _joined(values: Floats, edges: Floats) -> Floats:
    """Edges of bins with enough opportunities."""
    counts, _ = np.histogram(values, edges)
    kept, total = [float(edges[0])], 0
    for count, edge in zip(counts, edges[1:], strict=True):
        total += int(count)
        if total >= _LEAST:
            kept.append(float(edge))
            total = 0
    return np.array(kept)


def _hats(distance: Floats, nodes: Floats) -> Floats:
    """Piecewise linear functions that are 1 at one node, (N, K); constant beyond the ends."""
    return np.stack([np.interp(distance, nodes, one) for one in np.eye(len(nodes))], axis=-1)


def _table(chances: Chances) -> tuple[Floats, Floats]:
    """Nodes and probabilities of a piecewise linear function of distance, by least squares."""
    if not len(chances.distance):
        return np.array([1.0]), np.array([0.0])
    edges = _joined(chances.distance, distance_edges(float(chances.distance.max())))
    if len(edges) < 2:
        return np.array([1.0]), np.array([float(chances.seen.mean())])
    edges[-1] = max(edges[-1], float(chances.distance.max()) + 1e-9)
    nodes = binned(chances.distance, chances.seen, edges).middle
    hats = _hats(chances.distance, nodes)
    return nodes, _solve(hats.T @ hats, hats.T @ chances.seen.astype(np.float64))


def _solve(matrix: Floats, right: Floats) -> Floats:
    scale = 1e-9 * float(np.trace(matrix)) / len(matrix) + 1e-12
    found = np.linalg.solve(matrix + scale * np.eye(len(matrix)), right[..., None])[..., 0]
    return np.clip(found, 0.0, 1.0)


def _table_estimates(
    chances: Chances, nodes: Floats, values: Floats, blocks: Blocks
) -> list[Estimate]:
    """Probabilities at the nodes with intervals."""
    if not len(chances.distance):
        return [Estimate(float(one), 0.0, 1.0) for one in values]
    hats, block = _hats(chances.distance, nodes), blocks.of(chances.observer, chances.time)
    size = len(nodes)
    products = (hats[:, :, None] * hats[:, None, :]).reshape(len(hats), -1)
    table = blocks.sums(block, np.concatenate([products, hats * chances.seen[:, None]], axis=-1))
    drawn = blocks.draws(block) @ table
    matrices, rights = drawn[:, : size * size].reshape(-1, size, size), drawn[:, size * size :]
    found = np.array([_solve(m, r) for m, r in zip(matrices, rights, strict=True)])
    out = []
    for k, value in enumerate(values):
        own = block[hats[:, k] > 0.25]
        half = half_width(found[:, k], len(np.unique(own)))
        count = max(float(hats[:, k].sum()) / _RUN, 1.0)
        least = 5.3 / count if value < 0.02 or value > 0.98 else 0.0  # for a fraction of 0 or 1
        out.append(Estimate.around(float(value), max(half, least), 0.0, 1.0))
    return out


def _likelihoods(chances: Chances, p: Floats, halves: Floats, falloffs: Floats) -> Floats:
    """Log-likelihood (N, H·W) of each opportunity for half-fields × fall-offs."""
    angle = np.abs(chances.bearing)[:, None]
    half, falloff = (grid.ravel()[None] for grid in np.meshgrid(halves, falloffs, indexing="ij"))
    inside = half - angle
    share = np.where(
        falloff > 1e-9, np.clip(inside / np.maximum(falloff, 1e-9), 0.0, 1.0), inside >= 0.0
    )
    chance = np.clip(p[:, None] * share, _FLOOR, 1.0 - _FLOOR)
    return np.log(np.where(chances.seen[:, None], chance, 1.0 - chance))


def _edge_rows(
    chances: Chances, nodes: Floats, values: Floats, blind: float, low: float, high: float = 4.0
) -> tuple[Chances, Floats]:
    """Opportunities near the edge, and their probability within the field."""
    angle = np.abs(chances.bearing)
    rows = (chances.distance >= blind) & (angle >= low) & (angle <= high)
    found = chances.some(rows)
    return found, np.interp(found.distance, nodes, values)


def _field(
    chances: Chances, nodes: Floats, values: Floats, blind: float, near: float
) -> tuple[float, float]:
    """Half-field and fall-off of the highest likelihood, rad, first by a coarse grid."""
    rows, p = _edge_rows(chances, nodes, values, blind, 0.0)
    if not len(p):
        return math.pi, 0.0
    thin = max(1, len(p) // 8_000)
    rows, p = rows.some(np.arange(len(p)) % thin == 0), p[::thin]
    halves = np.unique(np.append(np.minimum(near * np.linspace(0.5, 1.5, 41), math.pi), math.pi))
    falloffs = near * np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7])
    total = np.concatenate(
        [_likelihoods(rows, p, np.array([h]), falloffs).sum(axis=0) for h in halves]
    ).reshape(len(halves), -1)
    total[halves == math.pi, 1:] = -np.inf  # no edge, no fall-off
    if total[halves == math.pi, 0] > total.max() - 0.5 * SIGNIFICANT:
        return math.pi, 0.0  # no robot was missed for its bearing
    h, w = np.unravel_index(np.argmax(total), total.shape)
    half, falloff = float(halves[h]), float(falloffs[w])
    fine_h, fine_w = _fine(half, falloff, near)
    low = max(0.0, min(half - falloff, near) - 0.3 * near)
    rows, p = _edge_rows(chances, nodes, values, blind, low, half + 0.4 * near)
    thin = max(1, len(p) // 40_000)
    rows, p = rows.some(np.arange(len(p)) % thin == 0), p[::thin]
    total = sum(
        _likelihoods(rows.some(part), p[part], fine_h, fine_w).sum(axis=0)
        for part in _parts(len(p))
    )
    h, w = np.unravel_index(np.argmax(total), (len(fine_h), len(fine_w)))
    return float(fine_h[h]), float(fine_w[w])


def _fine(half: float, falloff: float, near: float) -> tuple[Floats, Floats]:
    """Finer grids about a half-field and a fall-off."""
    halves = np.minimum(half + near * np.linspace(-0.05, 0.05, 21), math.pi)
    falloffs = np.maximum(falloff + near * np.linspace(-0.1, 0.1, 21), 0.0)
    return np.unique(halves), np.unique(falloffs)


def _parts(count: int, size: int = 4000) -> list[Mask]:
    """Masks of consecutive rows."""
    number = np.arange(count)
    return [(number >= k) & (number < k + size) for k in range(0, count, size)]


def _field_estimates(
    chances: Chances, nodes: Floats, values: Floats, blind: float, half: float, falloff: float,
    blocks: Blocks,
) -> tuple[Estimate, Estimate]:  # fmt: skip
    """Half-field and fall-off with intervals."""
    if half == math.pi:
        return Estimate(math.pi, math.pi, math.pi), Estimate(0.0, 0.0, 0.0)
    halves = half * np.linspace(0.88, 1.12, 25)
    halves = np.unique(np.append(np.minimum(halves, math.pi), half))
    falloffs = np.unique(
        np.append(np.maximum(falloff + half * np.linspace(-0.25, 0.25, 26), 0.0), falloff)
    )
    low = max(0.0, half - falloff - 0.3 * half)
    rows, p = _edge_rows(chances, nodes, values, blind, low, 1.3 * half)
    block = blocks.of(rows.observer, rows.time)
    sums = np.zeros((blocks.count, len(halves) * len(falloffs)))
    for part in _parts(len(p)):
        sums += blocks.sums(block[part], _likelihoods(rows.some(part), p[part], halves, falloffs))
    best = np.argmax(blocks.draws(block) @ sums, axis=1)
    drawn_h, drawn_w = halves[best // len(falloffs)], falloffs[best % len(falloffs)]
    used = len(np.unique(block))
    step_h, step_w = 0.5 * 0.01 * half, 0.5 * 0.02 * half
    wide_h = max(half_width(drawn_h, used), step_h)
    wide_w = max(half_width(drawn_w, used), step_w)
    return (
        Estimate.around(half, wide_h, 0.0, math.pi),
        Estimate.around(falloff, wide_w, 0.0),
    )


def _blind_zone(chances: Chances) -> Estimate:
    """Distance below which nothing is detected, m; 0 without enough near opportunities."""
    seen = np.sort(chances.distance[chances.sure])
    if len(seen) < 40:
        return Estimate(0.0, 0.0, 0.0)
    rank = min(int(0.0002 * len(seen)), len(seen) // 4)
    edge = float(seen[rank])
    spacing = float(seen[rank + 20] - seen[rank]) / 20.0
    below = int((chances.distance < edge).sum())
    near = (chances.distance >= edge) & (chances.distance < edge + max(0.3 * edge, 20.0 * spacing))
    rate = float(chances.seen[near].mean()) if near.any() else 0.0
    if (1.0 - rate) ** (below / _RUN) > 0.005 or edge <= 0.0:
        return Estimate(0.0, 0.0, float(seen[0]))
    low = float(seen[0]) - 5.3 * _RUN * spacing
    return Estimate(max(edge - _RUN * spacing, 0.0), max(low, 0.0), edge + spacing)


class DetectionMemory(NamedTuple):
    """Detection in successive frames."""

    persistence: Estimate  # s; 0 is independent
    seen_again: float
    seen_after_miss: float
    interval: float  # s, median time between the frames
    runs_seen: list[int]  # lengths of runs, frames
    runs_missed: list[int]


def find_memory(chances: Chances, view: View, blocks: Blocks) -> DetectionMemory:
    """Time constant of detection, by maximum likelihood of successive opportunities in view."""
    inner = np.abs(chances.bearing) <= view.half_field.value - view.falloff.value
    inner &= chances.distance >= view.min_range.value
    rows = chances.some(inner)
    p = np.clip(view.probability(rows), 0.02, 0.98)
    second = np.flatnonzero(rows.follows)
    first = second - 1
    gap = rows.interval[second]
    a, b = rows.seen[first], rows.seen[second]
    again = float(b[a].mean()) if a.any() else math.nan
    after = float(b[~a].mean()) if (~a).any() else math.nan
    step = float(np.median(gap)) if len(gap) else 0.0
    runs = _runs(rows)
    none = DetectionMemory(Estimate(0.0, 0.0, 0.5 * step), again, after, step, *runs)
    varies = (view.probability(rows) < 0.98).mean() > 0.02 if len(p) else False
    if len(second) < 100 or not varies:
        return none
    times = step * np.geomspace(0.05, 100.0, 121)
    kept = np.exp(-gap[:, None] / times)
    before, now = p[first][:, None], p[second][:, None]
    stays = np.where(
        a[:, None], np.minimum(1.0, now / before), np.maximum(0.0, (now - before) / (1.0 - before))
    )
    chance = np.clip(kept * stays + (1.0 - kept) * now, 1e-6, 1.0 - 1e-6)
    white = np.where(b, p[second], 1.0 - p[second])
    gain = np.log(np.where(b[:, None], chance, 1.0 - chance)) - np.log(white)[:, None]
    block = blocks.of(rows.observer[second], rows.time[second])
    found = most_likely(times, gain, block, blocks)
    return none if found is None else none._replace(persistence=found)


def _runs(rows: Chances) -> tuple[list[int], list[int]]:
    """Lengths of runs of detections and of misses, in frames."""
    if not len(rows.seen):
        return [], []
    begins = ~rows.follows | (np.diff(rows.seen.astype(np.int8), prepend=-1) != 0)
    start = np.flatnonzero(begins)
    length = np.diff(np.append(start, len(rows.seen)))
    hit = rows.seen[start]
    return length[hit].tolist(), length[~hit].tolist()
