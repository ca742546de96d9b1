"""The small thread pool, and how its threads share the blocks of a kernel."""

from __future__ import annotations

import gc
import platform
import signal
import threading
import time
import weakref
from types import SimpleNamespace

import numba
import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import Simulator
from rendezvous_env.compilation import kernel, unfolded_kernel
from rendezvous_env.engine import stepper
from rendezvous_env.engine.pool import threads
from rendezvous_env.engine.pool.sharing import (
    DONE,
    Share,
    each_block,
    look_in_vain,
    new_counters,
    pause,
)
from rendezvous_env.guarantee import teams
from rendezvous_env.vector import HeadingVectorWrapper


@kernel
def mark(share, marks, work):
    """Count how often each block is taken; ``work`` makes it take its time."""
    return each_block(share, _mark_block, (marks, work))


@unfolded_kernel
def _mark_block(block, arguments):
    marks, work = arguments
    waste = 1.0
    for _ in range(work):
        waste = np.sqrt(waste + 1.0)
    marks[block] += 1.0 + 0.0 * waste


def marked(blocks, most, work=0):
    marks = np.zeros(blocks)
    threads.share(lambda part: mark(part, marks, work), blocks, most)
    return marks


def share_slowly(run, blocks, most):
    """As a kernel would, but in Python, so that a test can see and hold up the threads."""

    one_by_one = getattr(each_block, "py_func", each_block)
    threads.share(lambda part: one_by_one(part, lambda block, _: run(block), ()), blocks, most)


def is_caller():
    return threading.current_thread() is threading.main_thread()


@pytest.mark.parametrize("most", [1, 2, 4])
@pytest.mark.parametrize("blocks", [0, 1, 2, 7, 1000])
def test_every_block_is_done_once(blocks, most):
    for _ in range(50):
        np.testing.assert_array_equal(marked(blocks, most), 1.0)


def test_long_and_short_work_in_turn():
    """Threads sleep and wake between calls; nothing is lost, whenever they do."""
    for k in range(60):
        np.testing.assert_array_equal(marked(31, 3, work=20_000 if k % 3 else 0), 1.0)
        time.sleep(0.001 * (k % 4))


def test_threads_work_at_the_same_time():
    barrier = threading.Barrier(3, timeout=20)
    share_slowly(lambda _: barrier.wait(), 3, 3)
    assert not barrier.broken


def test_one_thread_is_the_callers():
    seen = set()
    share_slowly(lambda _: seen.add(threading.current_thread()), 5, 1)
    assert seen == {threading.current_thread()}


def test_a_caller_waits_for_a_slow_helper():
    """Longer than it looks for news before it sleeps."""
    done, both = [], threading.Barrier(2, timeout=20)

    def run(block):
        both.wait()
        if not is_caller():
            time.sleep(0.05)
        done.append(block)

    share_slowly(run, 2, 2)
    assert sorted(done) == [0, 1]


def test_a_helper_that_wakes_too_late_does_nothing():
    """Its core is busy: the caller does all blocks, and nothing is kept for the helper."""
    release = threading.Event()
    hold = threads._Job(lambda _: release.wait(20))
    threads._ensure_workers(1)
    for _ in threads._workers:
        threads._jobs.put((hold, None))
    marks = np.zeros(9)
    gone = weakref.ref(marks)
    threads.share(lambda part, marks=marks: mark(part, marks, 0), 9, 2)
    np.testing.assert_array_equal(marks, 1.0)
    del marks
    gc.collect()
    assert gone() is None
    release.set()


def test_what_a_helper_raises_reaches_the_caller():
    both = threading.Barrier(2, timeout=20)

    def run(block):
        if block < 2:
            both.wait()
            if not is_caller():
                raise KeyError("a block")
        time.sleep(0.001)

    with pytest.raises(KeyError, match="a block"):
        share_slowly(run, 8, 2)
    np.testing.assert_array_equal(marked(8, 2), 1.0)  # and the pool still works


@pytest.mark.parametrize("moment", ["before", "after", "again"])
@pytest.mark.parametrize("most", [2, 4])
def test_an_interrupted_job_ends_for_all_before_the_caller_leaves(moment, most):
    """Wherever the interrupt comes: helpers may already be at work, and would go on."""
    left = {"before": 1, "after": 1, "again": 3}[moment]
    marks = np.zeros(64)

    def run_kernel(part):
        nonlocal left
        interrupted = is_caller() and left > 0
        left -= interrupted
        if interrupted and moment != "after":
            time.sleep(0.002)  # helpers begin
            raise KeyboardInterrupt
        done = mark(part, marks, 20_000)
        if interrupted:
            raise KeyboardInterrupt
        return done

    for _ in range(10):
        left, marks[:] = (1 if moment != "again" else 3), 0.0
        with pytest.raises(KeyboardInterrupt):
            threads.share(run_kernel, 64, most)
        seen = marks.copy()
        time.sleep(0.01)
        np.testing.assert_array_equal(seen, 1.0)
        np.testing.assert_array_equal(marks, 1.0)
        np.testing.assert_array_equal(marked(9, most), 1.0)  # and the pool still works


def test_an_interrupted_job_is_done_though_no_helper_has_begun():
    """All are busy elsewhere, and the interrupts come one after another."""
    release, left = threading.Event(), 3
    hold = threads._Job(lambda _: release.wait(20))
    threads._ensure_workers(1)
    for _ in threads._workers:
        threads._jobs.put((hold, None))
    marks = np.zeros(9)

    def run_kernel(part):
        nonlocal left
        left -= 1
        if left >= 0:
            raise KeyboardInterrupt
        return mark(part, marks, 0)

    with pytest.raises(KeyboardInterrupt):
        threads.share(run_kernel, 9, 2)
    np.testing.assert_array_equal(marks, 1.0)
    release.set()


def test_when_the_caller_fails_helpers_come_to_their_end():
    """Its blocks are lost, but nobody writes any more."""
    both, written = threading.Barrier(2, timeout=20), []

    def run(block):
        if block in (0, 8):
            both.wait()
        if is_caller():
            raise KeyError("a block")
        time.sleep(0.02)
        written.append(block)

    with pytest.raises(KeyError, match="a block"):
        share_slowly(run, 16, 2)
    seen = list(written)
    time.sleep(0.1)
    assert seen == written and len(seen) >= 1


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs timers")
def test_an_interrupted_step_is_one_for_all_teams_or_none(monkeypatch):
    """Interrupts by a timer, as Ctrl-C sends them, at all moments of a step of four threads."""
    monkeypatch.setattr(stepper, "_WORK_PER_THREAD", 1)
    sim = Simulator(rv.scenarios.get("swarm-20").replace(time_limit=1e4), 256, num_threads=4)
    sim.reset(0)
    actions = np.full((256, 20, 2), 1e-3, np.float32)
    sim.step(actions)
    assert sim._stepper.width == 4

    def interrupt(*_):
        raise KeyboardInterrupt

    before, interrupts = signal.signal(signal.SIGALRM, interrupt), 0
    random = np.random.default_rng(0)
    gc.disable()  # what is raised in a callback of the collector (hypothesis has one) is lost
    try:
        for _ in range(300):
            try:
                signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-4, 5e-3))
                for _ in range(100):
                    sim.step(actions)
            except KeyboardInterrupt:
                interrupts += 1
                steps, positions = sim.steps, sim.positions
                assert (steps == steps[0]).all()
                time.sleep(1e-3)
                np.testing.assert_array_equal(sim.positions, positions)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        gc.enable()
    assert interrupts > 100
    sim.step(actions)
    assert sim.all_running


def test_a_waiting_thread_looks_for_a_tenth_of_a_millisecond():
    counters = new_counters(1)
    took = []
    for _ in range(20):
        start = time.perf_counter()
        assert look_in_vain(counters, threads._spin_limit()) == threads._spin_limit()
        took.append(time.perf_counter() - start)
    assert 0.2e-4 < min(took) < 5e-4
    counters[0] = 1
    assert look_in_vain(counters, 10**12) == 0


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the instruction has another name")
def test_a_waiting_thread_pauses():
    """Without it a waiting thread takes the other one of its core half of what that could do."""

    @numba.njit
    def wait():
        pause()

    wait()
    assert "pause" in "".join(wait.inspect_asm().values())


def test_steering_uses_no_more_threads_than_it_may(monkeypatch):
    used = []
    monkeypatch.setattr(teams, "_ROBOTS_PER_THREAD", 1)
    monkeypatch.setattr(threads, "available_cores", lambda: 3)
    counted = SimpleNamespace(
        share=lambda run, blocks, most: used.append(most), most_threads=threads.most_threads
    )
    monkeypatch.setattr(teams, "threads", counted)
    for num_threads in (None, 1, 2):
        venv = HeadingVectorWrapper(rv.make_vec("fig3", 64, num_threads=num_threads))
        venv.reset(seed=0)
    assert used == [3, 1, 2]


def test_what_the_caller_raises_is_raised():
    def run(_):
        raise KeyError("a block")

    with pytest.raises(KeyError, match="a block"):
        share_slowly(run, 3, 1)


def test_callers_do_not_get_into_each_others_way():
    results = {}

    def caller(name):
        results[name] = sum(marked(40, 3, work=100) for _ in range(50))

    callers = [threading.Thread(target=caller, args=(k,)) for k in range(4)]
    for thread in callers:
        thread.start()
    for thread in callers:
        thread.join(30)
    assert sorted(results) == [0, 1, 2, 3]
    for total in results.values():
        np.testing.assert_array_equal(total, 50.0)


def test_without_compilation_one_thread_does_all(monkeypatch):
    """Counters of plain Python cannot be shared."""
    monkeypatch.setattr(threads, "compiled", lambda: False)
    monkeypatch.setattr(threads, "_ensure_workers", lambda _: pytest.fail("a thread was used"))
    np.testing.assert_array_equal(marked(7, 4), 1.0)


def test_blocks_done_are_counted_for_everybody():
    counted = []

    def run_kernel(part):
        done = mark(part, np.zeros(6), 0)
        counted.append(int(Share(*part).counters[DONE]))
        return done

    threads.share(run_kernel, 6, 1)
    assert counted == [6]


def test_workers_do_not_keep_the_process_alive_and_are_as_many_as_needed():
    marked(10, 5)
    assert len(threads._workers) >= 4 and all(worker.daemon for worker in threads._workers)
    assert threads.available_cores() >= 1


def test_a_forked_child_starts_without_workers():
    marked(4, 2)
    jobs, workers = threads._jobs, list(threads._workers)
    threads._forget_workers()
    try:
        assert threads._workers == [] and threads._jobs is not jobs
        np.testing.assert_array_equal(marked(4, 2), 1.0)
    finally:
        threads._jobs = jobs
        threads._workers[:] = workers
