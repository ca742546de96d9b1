"""Cores that a container's quota leaves."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rendezvous_env.engine import threads as cores


def files(root: Path, **contents: str) -> None:
    for name, text in contents.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


OURS = "proc/self/cgroup"
V1 = "sys/fs/cgroup/cpu,cpuacct"


@pytest.mark.parametrize(
    ("contents", "quota"),
    [
        ({}, math.inf),
        ({OURS: "0::/\n"}, math.inf),
        ({OURS: "0::/\n", "sys/fs/cgroup/cpu.max": "max 100000\n"}, math.inf),
        ({OURS: "0::/\n", "sys/fs/cgroup/cpu.max": "250000 100000\n"}, 2.5),
        (  # the least of all groups around it
            {
                OURS: "0::/pod/box\n",
                "sys/fs/cgroup/cpu.max": "max 100000\n",
                "sys/fs/cgroup/pod/cpu.max": "300000 100000\n",
                "sys/fs/cgroup/pod/box/cpu.max": "400000 100000\n",
            },
            3.0,
        ),
        (  # what the group is called outside is not seen from inside
            {OURS: "0::/../elsewhere\n", "sys/fs/cgroup/cpu.max": "150000 100000\n"},
            1.5,
        ),
        (
            {
                OURS: "5:memory:/a\n4:cpu,cpuacct:/docker/abc\n0::/\n",
                f"{V1}/cpu.cfs_quota_us": "200000\n",
                f"{V1}/cpu.cfs_period_us": "100000\n",
            },
            2.0,
        ),
        (
            {
                OURS: "4:cpu:/docker/abc\n",
                "sys/fs/cgroup/cpu/docker/abc/cpu.cfs_quota_us": "50000\n",
                "sys/fs/cgroup/cpu/docker/abc/cpu.cfs_period_us": "100000\n",
                "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
                "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
            },
            0.5,
        ),
        ({OURS: "nonsense", "sys/fs/cgroup/cpu.max": "1 1"}, math.inf),
        ({OURS: "0::/\n", "sys/fs/cgroup/cpu.max": "nonsense"}, math.inf),
    ],
)
def test_the_quota_of_both_versions_of_control_groups_counts(tmp_path, contents, quota):
    files(tmp_path, **contents)
    assert cores.cpu_quota(tmp_path) == quota


@pytest.mark.parametrize(("quota", "left"), [(math.inf, 8), (2.9, 2), (0.5, 1), (100.0, 8)])
def test_a_part_of_a_core_is_not_counted(monkeypatch, quota, left):
    monkeypatch.setattr(cores, "cpu_quota", lambda: quota)
    monkeypatch.setattr(cores.os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert cores.available_cores() == left
