"""Bearings of the plane known by sector only."""

from rendezvous_env.compilation import kernel
from rendezvous_env.equations.sensing import in_sectors


@kernel
def round_rows(rows, sectors, out):
    """Turn rows into the middles of their sectors.

    Args:
        rows: (N, 2).
        sectors: how many there are, all round.
        out: (N, 2), as long as the rows.
    """
    for i in range(rows.shape[0]):
        out[i, 0], out[i, 1] = in_sectors((rows[i, 0], rows[i, 1]), sectors)
