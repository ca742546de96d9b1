"""Commands on a local Ray cluster of two nodes: results equal those of ``--jobs 1``.

The results also hold if workers are lost. The tests run in a separate environment, created by
``make test-adapters``.
"""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import one_mode  # noqa: F401
import pytest

pytest.importorskip("ray")

import psutil  # Ray brings it along
from ray import cloudpickle
from ray.cluster_utils import Cluster

from rendezvous_env.engine.threads import available_cores
from train import tasks as cluster_tasks
from train.checks import UserError
from train.tasks import Workers, parallel_map

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own
cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers do not have this file

PLAYED = (
    "compare", "--scenarios", "duo", "clutter-8", "--policies", "bearing-only", "tangent-merged",
    "learned", "--episodes", "140", "--keep", "2", "--no-figures", "--ceiling", "1",
)  # fmt: skip


@pytest.fixture(scope="module")
def two():
    """Cluster of two nodes with one core each."""
    machine = {"num_cpus": 1, "object_store_memory": 10**8, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=machine)
    cluster.add_node(num_cpus=1, object_store_memory=10**8)
    yield cluster
    cluster.shutdown()


@pytest.fixture
def open_to_all():
    """Address of a cluster of two nodes, started by a process without a token."""
    started = """
from ray.cluster_utils import Cluster
machine = {"num_cpus": 1, "object_store_memory": 10**8, "include_dashboard": False}
cluster = Cluster(initialize_head=True, head_node_args=machine)
cluster.add_node(num_cpus=1, object_store_memory=10**8)
print(cluster.address, flush=True)
input()
cluster.shutdown()
"""
    with subprocess.Popen(
        [sys.executable, "-c", started],
        env=os.environ | {"RAY_AUTH_MODE": "disabled"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        yield process.stdout.readline().strip()
        process.communicate("\n", timeout=60)


def busy(cluster):
    """Worker processes that run a task of these tests."""
    found = []
    for node in cluster.list_all_nodes():
        raylet = psutil.Process(node.all_processes["raylet"][0].process.pid)
        for worker in raylet.children():
            try:
                if worker.cmdline()[:1] == [f"ray::{cluster_tasks.NAME}"]:
                    found.append(worker)
            except (psutil.NoSuchProcess, psutil.ZombieProcess):
                continue
    return found


def command(*words, **environment):
    return subprocess.Popen(
        [sys.executable, "-m", "train.cli", *map(str, words)],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def alone(*words):
    """Run a command in one process."""
    done = command(*words, "--jobs", 1)
    said, _ = done.communicate(timeout=600)
    assert done.returncode == 0, said


def with_a_kill(cluster, *words, begun):
    """Run a command on the cluster, and kill a worker after the first task has started."""
    running = command(*words, "--backend", "ray", "--address", cluster.address)
    killed = None
    while running.poll() is None and killed is None:
        if begun() and (found := busy(cluster)):
            found[0].send_signal(signal.SIGKILL)
            killed = found[0]
        time.sleep(0.02)
    said, _ = running.communicate(timeout=600)
    assert killed is not None, f"no worker was seen at work: {said}"
    assert not killed.is_running()
    assert running.returncode == 0, said


def tried(task):
    """Write a file when started and, if requested, end the process the first time."""
    number, folder, dies = task
    times = folder / str(number)
    with times.open("a") as file:
        file.write("x")
    time.sleep(0.1)
    if dies and times.stat().st_size < dies:
        os.kill(os.getpid(), signal.SIGKILL)
    return number, np.full(100_000, number), os.getpid(), os.getcwd()


def threads(task):
    return os.environ["NUMBA_NUM_THREADS"], available_cores(), os.getpid()


def refuses(task):
    raise UserError(f"task {task} cannot be")


class TestEach:
    def test_parallel_map_repeats_only_task_of_lost_worker(self, two, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        tasks = [(number, tmp_path, 2 * (number == 5)) for number in range(16)]
        found = dict(parallel_map(tried, tasks, Workers(on="ray", address=two.address)))
        assert sorted(found) == [found[number][0] for number in range(16)] == list(range(16))
        times = Counter({number: (tmp_path / str(number)).stat().st_size for number in range(16)})
        assert times == Counter(range(16)) + Counter([5])
        assert all((found[number][1] == number).all() for number in found)
        assert all(found[number][1].flags.writeable for number in found)
        assert len({result[2] for result in found.values()} - {os.getpid()}) >= 2
        assert {Path(result[3]) for result in found.values()} == {tmp_path}

    def test_parallel_map_raises_after_repeated_worker_loss(self, two, tmp_path):
        tasks = [(0, tmp_path, 100)]
        with pytest.raises(UserError, match="workers of the cluster ended 3 times at one task"):
            list(parallel_map(tried, tasks, Workers(on="ray", address=two.address)))
        assert (tmp_path / "0").stat().st_size == 3

    def test_parallel_map_starts_local_cluster_with_single_threads(self):
        found = dict(parallel_map(threads, range(8), Workers(jobs=2, on="ray")))
        assert sorted(found) == list(range(8))
        assert {result[:2] for result in found.values()} == {("1", 1)}
        processes = {result[2] for result in found.values()}
        assert os.getpid() not in processes and 1 <= len(processes) <= 2

    def test_parallel_map_propagates_task_error(self, two):
        with pytest.raises(UserError, match=r"^task \d cannot be$"):
            list(parallel_map(refuses, range(4), Workers(on="ray", address=two.address)))

    def test_parallel_map_rejects_unreachable_cluster(self, open_to_all, tmp_path):
        """The cluster has no token, and this process rejects connections without one."""
        tasks = [(number, tmp_path, 0) for number in range(8)]
        said = r"did not reach this process to fetch a result: RAY_AUTH_MODE is token here"
        with pytest.raises(UserError, match=said):
            list(parallel_map(tried, tasks, Workers(on="ray", address=open_to_all)))

    def test_parallel_map_rejects_cluster_without_token(self, two, tmp_path):
        asks = ("verify", "--trials", 1, "--backend", "ray", "--address", two.address)
        done = command(*asks, "--out", tmp_path, RAY_AUTH_MODE="disabled")
        said, _ = done.communicate(timeout=600)
        assert done.returncode == 2
        assert f"--address {two.address}: " in said
        assert "RAY_AUTH_MODE is disabled here and must be that of the cluster" in said

    def test_parallel_map_rejects_missing_cluster(self):
        with pytest.raises(UserError, match=r"--address 127\.0\.0\.1:9: no cluster answers there"):
            list(parallel_map(refuses, range(4), Workers(on="ray", address="127.0.0.1:9")))


def test_compare_with_lost_worker_equals_single_process(two, tmp_path):
    alone(*PLAYED, "--out", tmp_path / "one")
    cells = tmp_path / "ray.part" / "cells"
    with_a_kill(
        two, *PLAYED, "--out", tmp_path / "ray", begun=lambda: len(list(cells.glob("*.cell"))) >= 2
    )
    for name in ("results.csv", "episodes.csv", "paired.csv", "ceiling.csv", "trajectories.npz"):
        assert (tmp_path / "ray" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()


def test_train_seeds_write_into_given_folders(two, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = (
        "train", "--scenario", "clutter-4", "--num-envs", 4, "--n-steps", 8, "--batch-size", 64,
        "--epochs", 1, "--total-steps", 256, "--set-width", 4, "--hidden", 8, "--eval-every", 0,
        "--no-tensorboard", "--seeds", 0, 3, "--out", "runs",
    )  # fmt: skip
    done = command(*small, "--backend", "ray", "--address", two.address)
    said, _ = done.communicate(timeout=600)
    assert done.returncode == 0, said
    for seed in (0, 3):
        assert (tmp_path / "runs" / f"seed-{seed}" / "checkpoints" / "latest.json").is_file()
