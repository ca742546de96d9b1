"""Which points of the plane a union of discs keeps apart.

Two discs that overlap are joined by the segment of their centres, which lies in both together. A
point p and a point q outside the union lie in different parts of the plane if and only if some
closed chain of joined discs goes round one of them and not the other: its segments then cross the
segment p q an odd number of times (Alexander duality modulo 2; that chains of segments find every
hole is the nerve theorem). So p and q are together if and only if every disc can be given a side, 0
or 1, such that two joined discs are on different sides exactly if their segment crosses p q.
"""

from ..compilation import kernel


@kernel
def _is_left(a, b, point):
    """Whether a point is to the left of the line from a to b; on it counts as not."""
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0.0


@kernel
def crosses(a, b, p, q):
    """Whether the segments a b and p q of the plane cross, each with its ends on both sides.

        sign((b − a) × (p − a)) ≠ sign((b − a) × (q − a)), and with the pairs exchanged

    Args:
        a: end of a segment, a triple, m; only x and y count.
        b: its other end, likewise.
        p: end of the other segment, likewise.
        q: its other end, likewise.
    """
    return _is_left(p, q, a) != _is_left(p, q, b) and _is_left(a, b, p) != _is_left(a, b, q)


@kernel
def are_joined(a, b, reach):
    """Whether two discs of the plane count as overlapping: ‖b − a‖ < reach.

    Args:
        a: centre of one, a triple, m; only x and y count.
        b: centre of the other, likewise.
        reach: sum of their radii, and of what gap counts as closed, m.
    """
    x, y = b[0] - a[0], b[1] - a[1]
    return x * x + y * y < reach * reach
