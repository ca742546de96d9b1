"""Kernels over many teams on as many threads as are worth their cost."""

from __future__ import annotations

from collections.abc import Callable

from ..compilation import inlined_entry
from ..engine.pool import threads
from ..engine.pool.sharing import Part

TEAMS_AT_ONCE = 32
"""That a thread takes at a time."""
_ROBOTS_PER_THREAD = 2048


@inlined_entry
def teams_of_block(block, num_envs):
    """The teams of a block k: 32 k ≤ team < min(32 (k + 1), B).

    Args:
        block: k, an index.
        num_envs: B.

    Returns:
        A pair of indices, without unit: of the first one, and of the one after the last.
    """
    return block * TEAMS_AT_ONCE, min((block + 1) * TEAMS_AT_ONCE, num_envs)


def over_teams(
    run_kernel: Callable[[Part], bool], num_envs: int, n_robots: int, num_threads: int | None
) -> None:
    """Run a kernel over a batch.

    Args:
        run_kernel: does the blocks of ``TEAMS_AT_ONCE`` teams that its part gives out.
        num_envs: B.
        n_robots: n.
        num_threads: most threads that may be used; None is one for each core.
    """
    most = num_envs * n_robots // _ROBOTS_PER_THREAD
    if most > 1:  # to ask how many cores there are takes a while
        most = min(most, threads.most_threads(num_threads))
    threads.share(run_kernel, -(-num_envs // TEAMS_AT_ONCE), max(1, most))
