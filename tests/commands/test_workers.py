"""Tasks in worker processes: results do not depend on workers or on losses."""

import os
import signal
from contextlib import closing
from itertools import chain, islice

import numpy as np
import pytest
from threadpoolctl import threadpool_limits
from training_runs import SMALL, UPDATE, network
from worker_tasks import dies, dies_once, refuses, threads, where

import rendezvous_env as rv
from train import interrupts, tasks
from train.checks import UserError
from train.compare import compare, playing
from train.learn import command
from train.tasks import Workers, parallel_map
from train.verify import verify
from train.verify.claims import CLAIMS


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Start workers immediately."""
    monkeypatch.setattr(tasks, "_ALONE", 0.0)


class TestEach:
    def test_one_worker_uses_this_process(self):
        found = list(parallel_map(where, "abc", Workers(jobs=1)))
        assert [number for number, _ in found] == [0, 1, 2]
        assert [result[:2] for _, result in found] == [(letter, os.getpid()) for letter in "abc"]

    @pytest.mark.slow
    def test_two_workers_are_single_threaded_processes(self):
        found = dict(parallel_map(where, range(12), Workers(jobs=2)))
        assert sorted(found) == list(range(12))
        assert all(found[number][0] == number for number in found)
        assert {result[2:] for result in found.values()} == {("1", 1)}
        processes = {result[1] for result in found.values()}
        assert os.getpid() not in processes and 1 <= len(processes) <= 2

    @pytest.mark.slow
    def test_matrix_products_use_one_thread_everywhere(self, set_threads):
        """OpenBLAS and torch round differently on several threads, by default one per core."""
        set_threads(3)
        with threadpool_limits(3, "blas"):
            found = [
                result
                for n in (1, 2)
                for _, result in parallel_map(threads, "abcd", Workers(jobs=n))
            ]
            assert {*chain(*found)} == {1} and min(map(len, found)) > 1
            assert {*threads(None)} == {3}

    @pytest.mark.slow
    def test_here_tasks_stay_in_this_process(self):
        found = dict(
            parallel_map(where, range(6), Workers(jobs=2), here=lambda task: task % 2 == 0)
        )
        assert [found[number][1] == os.getpid() for number in range(6)] == [True, False] * 3

    def test_lost_worker_repeats_its_task(self, tmp_path):
        tasks = [(number, tmp_path) for number in range(8)]
        found = dict(parallel_map(dies_once, tasks, Workers(jobs=2)))
        assert found == {number: number for number in range(8)}
        assert (tmp_path / "died").exists()

    @pytest.mark.slow
    def test_repeated_worker_loss_is_error(self):
        with pytest.raises(UserError, match="workers ended 3 times before any task was done"):
            list(parallel_map(dies, range(4), Workers(jobs=2)))

    @pytest.mark.parametrize("count", [1, 2])
    def test_task_error_is_propagated(self, count):
        with pytest.raises(UserError, match=r"task \d cannot be"):
            list(parallel_map(refuses, range(4), Workers(jobs=count)))

    @pytest.mark.slow
    def test_ctrl_c_ends_workers(self):
        processes = set()
        tasks = parallel_map(where, range(10_000), Workers(jobs=2))
        with interrupts.raised("test"), pytest.raises(KeyboardInterrupt), closing(tasks):
            for number, found in tasks:
                processes.add(found[1])
                if number == 4:
                    os.kill(os.getpid(), signal.SIGINT)
        assert processes
        for process in processes:
            with pytest.raises(ProcessLookupError):
                os.kill(process, 0)

    @pytest.mark.slow
    def test_unfinished_tasks_are_dropped(self):
        """Many short tasks: discarded ones are not searched for."""
        with closing(parallel_map(abs, range(-3000, 0), Workers(jobs=2))) as found:
            assert len(list(islice(found, 5))) == 5

    def test_short_work_stays_in_this_process(self, monkeypatch):
        monkeypatch.setattr(tasks, "_ALONE", 60.0)
        found = list(parallel_map(where, range(5), Workers(jobs=2)))
        assert {result[1] for _, result in found} == {os.getpid()}


@pytest.mark.slow
def test_compare_with_two_workers_equals_one(tmp_path, monkeypatch):
    """Three blocks of initial conditions for each policy and scenario."""
    monkeypatch.setattr(playing, "BLOCK", 8)
    given = {"scenarios": ("duo", "clutter-8"), "policies": ("bearing-only", "learned")}
    given |= {"episodes": 20, "keep": 2, "ceiling": 1, "set": ("time_limit=10",), "figures": False}
    for jobs in (1, 2):
        config = compare.Config(**given, jobs=jobs, out=tmp_path / str(jobs))
        assert compare.run(config) == 0
    for name in ("results.csv", "episodes.csv", "paired.csv", "ceiling.csv", "trajectories.npz"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


@pytest.mark.slow
def test_verify_with_two_workers_equals_one(tmp_path):
    claims = [claim for claim in CLAIMS if claim.name in ("lemma-1", "theorem-1")]
    found = []
    for jobs in (1, 2):
        assert verify.run(verify.Config(trials=120, jobs=jobs, out=tmp_path), claims) == 0
        lines = (tmp_path / "verify.csv").read_text().splitlines()
        found.append([[*line.split(",")[:5], line.split(",")[6]] for line in lines])
    assert found[0] == found[1] and len(found[0]) == 3


class TestSeeds:
    def config(self, out, **changes):
        own = {"total_steps": 2 * UPDATE, "eval_every": 0, "num_threads": None, "seeds": (0, 3)}
        return command.Config(**SMALL | own | {"out": out} | changes)

    @pytest.mark.slow
    def test_train_seeds_in_parallel_equal_sequential_and_resume(self, tmp_path):
        one, two = tmp_path / "1", tmp_path / "2"
        assert command.run(self.config(two, jobs=2)) == 0
        for seeds in ((0,), (0, 3)):  # seed 0 is finished when it is asked for again
            assert command.run(self.config(one, seeds=seeds, jobs=1)) == 0
        found = [network(folder / f"seed-{s}") for s in (0, 3) for folder in (one, two)]
        for first, second in (found[:2], found[2:]):
            assert all(np.array_equal(first[name], second[name]) for name in first)
        assert any(not np.array_equal(found[0][name], found[2][name]) for name in found[0])
        assert f"done: {2 * UPDATE:,} steps" in (two / "seed-0.txt").read_text()
        with pytest.raises(UserError, match="seed-0 contains a run of other settings"):
            command.run(self.config(one, learning_rate=1e-4))

    @pytest.mark.slow
    def test_registered_extensions_are_trained_in_this_process(self, tmp_path):
        rv.reward_term("of this process", lambda step: -step.time)
        file = tmp_path / "own.toml"
        paid = rv.RewardWeights(custom={"of this process": 0.1})
        rv.scenarios.get("clutter-4").replace(reward=paid).to_toml(file)
        assert command.run(self.config(tmp_path, scenario=str(file), jobs=2)) == 0
        assert (tmp_path / "seed-3.txt").exists()


@pytest.mark.slow
def test_many_tasks_start_workers_at_once(tmp_path, monkeypatch):
    """The first task compiles kernels and may take as long as many tasks, with idle cores."""
    monkeypatch.setattr(tasks, "_ALONE", 60.0)
    monkeypatch.setattr(playing, "make_ready", lambda *_: 1 / 0)  # where the one that asked plays
    given = {"scenarios": ("duo",), "policies": ("bearing-only", "unit-mean"), "episodes": 2}
    config = compare.Config(**given, jobs=2, figures=False, out=tmp_path / "out")
    monkeypatch.setattr(playing, "_MANY", 2)
    assert compare.run(config) == 0
    assert len((tmp_path / "out" / "episodes.csv").read_text().splitlines()) == 1 + 4
    monkeypatch.setattr(playing, "_MANY", 3)
    with pytest.raises(ZeroDivisionError):
        compare.run(config)
