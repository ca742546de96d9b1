"""The small thread pool."""

from __future__ import annotations

import threading
import time

import pytest

from rendezvous_env import threads


@pytest.mark.parametrize("count", [1, 2, 3, 7, 40])
def test_every_slice_is_done_once(count):
    done = []
    threads.run(done.append, count)
    assert sorted(done) == list(range(count))


@pytest.mark.parametrize(("count", "width"), [(3, 1), (3, 2), (9, 4), (2, 8)])
def test_more_slices_than_threads(count, width):
    done, used = [], set()

    def task(k):
        used.add(threading.get_ident())
        done.append(k)

    threads.run(task, count, width)
    assert sorted(done) == list(range(count)) and len(used) <= width
    if width == 1:
        assert used == {threading.get_ident()}


def test_a_caller_waits_for_a_slow_slice():
    """Longer than it looks for ends before it sleeps."""
    done = []

    def task(k):
        if threading.current_thread() is not threading.main_thread():
            time.sleep(20 * threads._PATIENCE)
        else:
            time.sleep(2 * threads._PATIENCE)
        done.append(k)

    threads.run(task, 2)
    assert sorted(done) == [0, 1]


def test_one_slice_stays_in_the_callers_thread():
    seen = []
    threads.run(lambda _: seen.append(threading.current_thread()), 1)
    assert seen == [threading.current_thread()]


def test_slices_run_at_the_same_time():
    barrier = threading.Barrier(3, timeout=20)
    threads.run(lambda _: barrier.wait(), 3)
    assert not barrier.broken


def test_all_slices_end_before_an_error_is_raised():
    done = []

    def task(k):
        if k == 0:
            raise KeyError("slice 0")
        time.sleep(0.02)
        done.append(k)

    with pytest.raises(KeyError, match="slice 0"):
        threads.run(task, 4)
    assert sorted(done) == [1, 2, 3]
    threads.run(done.append, 2)  # and the pool still works
    assert sorted(done) == [0, 1, 1, 2, 3]


def test_callers_do_not_get_into_each_others_way():
    results = {}

    def caller(name):
        done = []
        for _ in range(50):
            threads.run(done.append, 3)
        results[name] = sorted(done)

    callers = [threading.Thread(target=caller, args=(k,)) for k in range(4)]
    for thread in callers:
        thread.start()
    for thread in callers:
        thread.join(30)
    assert results == dict.fromkeys(range(4), sorted([0, 1, 2] * 50))


def test_workers_do_not_keep_the_process_alive_and_are_as_many_as_needed():
    threads.run(lambda _: None, 5)
    assert len(threads._workers) >= 4 and all(worker.daemon for worker in threads._workers)
    assert threads.available_cores() >= 1


def test_a_forked_child_starts_without_workers(monkeypatch):
    threads.run(lambda _: None, 2)
    jobs, workers = threads._jobs, list(threads._workers)
    threads._forget_workers()
    try:
        assert threads._workers == [] and threads._jobs is not jobs
        done = []
        threads.run(done.append, 2)
        assert sorted(done) == [0, 1]
    finally:
        threads._jobs = jobs
        threads._workers[:] = workers
