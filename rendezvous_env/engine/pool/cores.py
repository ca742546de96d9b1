"""How many cores this process may keep busy: by its affinity, its container and its user."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path, PurePosixPath


def available_cores() -> int:
    """Cores that this process may run on, and no more than its container's quota of processor time
    or NUMBA_NUM_THREADS, by which a process that is one of many is told to keep to its share.

    A part of a core is not counted: threads that look for news would use up the quota of all.
    """
    affine = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return max(1, int(min(affine, cpu_quota(), _granted())))


def _granted() -> float:
    """What the user's environment grants; inf without a number there."""
    share = os.environ.get("NUMBA_NUM_THREADS", "")
    return int(share) if share.isdecimal() and int(share) else float("inf")


@lru_cache
def cpu_quota(root: Path = Path("/")) -> float:
    """Cores' worth of processor time that the control groups of this process grant.

    Args:
        root: of the file system.

    Returns:
        The least of all groups that it is in; inf without control groups.
    """
    return min(_quotas(root), default=float("inf"))


def _quotas(root: Path) -> Iterator[float]:
    for line in _read(root / "proc/self/cgroup").splitlines():
        number, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if number == "0" and not controllers:  # version 2
            for folder in _upwards(root / "sys/fs/cgroup", path):
                yield from _share(_read(folder / "cpu.max").split())
        elif "cpu" in controllers.split(","):  # version 1
            for mount in (controllers, "cpu"):
                for folder in _upwards(root / "sys/fs/cgroup" / mount, path):
                    files = folder / "cpu.cfs_quota_us", folder / "cpu.cfs_period_us"
                    yield from _share([word for file in files for word in _read(file).split()])


def _upwards(mount: Path, path: str) -> Iterator[Path]:
    """A group and those it is in; a container may see its own as the outermost one."""
    within = PurePosixPath(path.lstrip("/"))
    if ".." not in within.parts:
        yield from (mount / folder for folder in (within, *within.parents))
    else:
        yield mount


def _share(words: list[str]) -> Iterator[float]:
    """Quota over period; nothing where there is no limit ("max", or −1) or no such file."""
    try:
        quota, period = map(float, words)
    except ValueError:
        return
    if quota > 0 and period > 0:
        yield quota / period


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return ""
