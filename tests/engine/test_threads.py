"""Threads: slices of a batch, interrupts, and the number of threads."""

import gc
import multiprocessing
import os
import signal
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import islice

import numpy as np
import pytest
from conftest import five
from parameters import needed, slow

import rendezvous_env as rv
from rendezvous_env import Simulator
from rendezvous_env.compilation import kernel
from rendezvous_env.engine import batch_runner, threads
from rendezvous_env.engine.thread_tuner import ThreadTuner
from rendezvous_env.safety import safety_filter as teams
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper


@kernel
def mark(part, marks, work):
    """Count the runs of each block; ``work`` adds a delay."""
    for block in range(part[0], part[1]):
        waste = 1.0
        for _ in range(work):
            waste = np.sqrt(waste + 1.0)
        marks[block] += 1.0 + 0.0 * waste


def kernels(marks, work=0):
    """Calls that cannot be interrupted: the caller executes some."""
    return lambda part: [partial(mark, part, marks, work)]


def python(marks, work=0):
    """A call from Python: the caller leaves all to others."""
    return lambda part: [lambda: mark(part, marks, work)]


KINDS = pytest.mark.parametrize("kind", [kernels, python])


def marked(blocks, most, work=0, kind=kernels, head_start=0.0):
    marks = np.zeros(blocks)
    threads.share(kind(marks, work), blocks, most, head_start)
    return marks


@KINDS
@pytest.mark.parametrize("most", [1, 2, 4])
@pytest.mark.parametrize("blocks", [0, 1, 2, 7, 1000])
def test_share_runs_every_block_once(blocks, most, kind):
    for head_start in (0.0, 0.1, 1.0):
        for _ in range(20):
            np.testing.assert_array_equal(
                marked(blocks, most, kind=kind, head_start=head_start), 1.0
            )


def test_share_gives_the_caller_the_larger_slice_of_compiled_calls_only():
    """Otherwise the caller waits, since Python might interrupt it."""
    parts, by = {}, {0: [], 1: []}

    def calls_of(part):
        parts[part[2]] = part[:2]
        who = islice(iter(threading.get_ident, None), 1)  # by no instruction of Python's own
        return [partial(by[part[2]].extend, who)]

    threads.share(calls_of, 100, 2, 0.2)
    assert parts == {0: (0, 60), 1: (60, 100)}
    assert by[0] == [threading.get_ident()] and by[1] != by[0]
    done = []
    threads.share(lambda _: [lambda: done.append(threading.current_thread())], 100, 2, 0.2)
    assert len(done) == 2 and threading.current_thread() not in done


@pytest.mark.parametrize("compiled", [True, False])
def test_share_with_one_thread_or_without_compilation_runs_in_the_caller(compiled, monkeypatch):
    monkeypatch.setattr(threads, "compiled", lambda: compiled)
    seen = set()
    most = 1 if compiled else 4
    threads.share(lambda _: [lambda: seen.add(threading.current_thread())], 5, most)
    assert seen == {threading.current_thread()}


def test_share_within_a_slice_runs_in_the_thread_of_the_slice():
    """Otherwise all threads might wait for each other."""
    caller, done = threading.current_thread(), []

    def within(part):
        return [lambda: done.append((part, threading.current_thread() is caller))]

    threads.share(lambda _: [lambda: threads.share(within, 8, 2)], 8, 2)
    assert done == [((0, 8, 0), False)] * 2


def test_share_runs_slices_concurrently_and_waits_for_the_slowest():
    barrier, done = threading.Barrier(2, timeout=20), []

    def run(part):
        barrier.wait()
        time.sleep(0.05 * part[2])
        done.append(part[:2])

    threads.share(lambda part: [partial(run, part)], 8, 2)
    assert sorted(done) == [(0, 4), (4, 8)]


@pytest.mark.slow
@KINDS
def test_share_releases_the_arguments_of_its_calls(kind):
    """Even if a thread that woke too late still has the job."""
    marks = np.zeros(9)
    gone = weakref.ref(marks)
    threads.share(kind(marks), 9, 2)
    np.testing.assert_array_equal(marks, 1.0)
    del marks
    time.sleep(0.05)
    gc.collect()
    assert gone() is None


@kernel
def fail(part, wrong):
    if part[2] == wrong:
        raise KeyError("a block")


@pytest.mark.parametrize(("most", "wrong"), [(1, 0), (2, 0), (2, 1)])
def test_share_raises_the_error_of_a_slice_in_the_caller(most, wrong):
    """Errors of the caller or of another thread; no thread still writes afterwards."""
    for call in (fail, fail.py_func if hasattr(fail, "py_func") else fail, partial(fail)):
        marks = np.zeros(8)

        def calls_of(part, call=call, marks=marks):
            return [partial(call, part, wrong), *kernels(marks, 2000)(part)]

        with pytest.raises(KeyError, match="a block"):
            threads.share(calls_of, 8, most)
        seen = marks.copy()
        time.sleep(1e-3)
        np.testing.assert_array_equal(marks, seen)
    np.testing.assert_array_equal(marked(8, 2), 1.0)  # and the threads still work


@contextmanager
def interrupts(handler):
    """Function that schedules an interrupt by a timer, s, like Ctrl-C.

    A second time repeats it; without times the timer is cancelled.
    """
    if not hasattr(signal, "setitimer"):
        pytest.skip("needs timers")
    before, random = signal.signal(signal.SIGALRM, handler), np.random.default_rng(0)
    gc.disable()  # what is raised in a callback of the collector (hypothesis has one) is lost
    try:
        yield lambda least=0.0, most=0.0, again=0.0: signal.setitimer(
            signal.ITIMER_REAL, random.uniform(least, most), again
        )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        time.sleep(1e-2)  # one may be on its way still, and Python says so if nobody wants it
        signal.signal(signal.SIGALRM, before)
        gc.enable()


@KINDS
@pytest.mark.parametrize("most", [2, slow(4)])
@pytest.mark.parametrize("again", [0.0, 3e-5], ids=["one signal", "several in a row"])
def test_share_when_interrupted_is_complete_or_never_begun(again, most, kind):
    """An interrupt anywhere in ``threads``: all blocks are complete, or none has begun.

    No thread still writes when the caller returns. A time-out is no KeyboardInterrupt.
    """
    marked(64, most)  # compiled
    heard = 0

    def late(_, frame):
        nonlocal heard
        if frame.f_code.co_filename == threads.__file__:
            heard += 1
            raise TimeoutError

    with interrupts(late) as within:
        for _ in range(200):
            marks = np.zeros(64)
            try:
                within(1e-5, 1e-3, again)
                threads.share(kind(marks, 5_000), 64, most)
            except TimeoutError:
                seen = marks.copy()
                time.sleep(1e-3)
                np.testing.assert_array_equal(marks, seen)
            within()
            assert (marks == marks[0]).all() and marks[0] in (0.0, 1.0)
    assert heard > (200 if again else 100)
    np.testing.assert_array_equal(marked(9, most), 1.0)  # and the threads still work


@pytest.mark.parametrize("around", [None, slow(HeadingVectorWrapper), needed(EnergyTankWrapper)])
def test_step_when_interrupted_advances_all_environments_or_none(around, monkeypatch):
    """Interrupts at any time of a step of four threads.

    Under a guarantee, tanks are updated in all environments that have stepped. If the wrapper has
    not received the step, it does not use the observations.
    """
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    monkeypatch.setattr(
        ThreadTuner, "begin", lambda tuner: tuner.max_threads
    )  # though one may be quicker
    scenario = rv.scenarios.get("swarm-20").replace(time_limit=1e4)
    env = rv.make_vec(scenario, 256, num_threads=4)
    env = env if around is None else around(env)
    env.reset(seed=[0] * 256)  # so all teams are alike
    sim, count, refused = env.unwrapped.simulator, 0, 0
    actions = np.full((256, 20, 2), 1e-3, np.float32)
    env.step(actions)
    assert sim._runner._tuner.max_threads == 4
    with interrupts(signal.default_int_handler) as within:
        for _ in range(300):
            try:
                within(1e-4, 5e-3)
                for _ in range(100):
                    env.step(actions)
            except KeyboardInterrupt:
                count += 1
                steps, positions = sim.steps, sim.positions
                assert (steps == steps[0]).all() and (positions == positions[0]).all()
                if around is EnergyTankWrapper:
                    assert (env.tank.levels == env.tank.levels[0]).all()
                time.sleep(1e-3)
                np.testing.assert_array_equal(sim.positions, positions)
                try:
                    env.step(actions)
                except RuntimeError:
                    refused += 1
                    env.reset(seed=[0] * 256)
    assert count > 100 and (refused > 0) == (around is not None)
    env.reset(seed=1)
    env.step(actions)
    assert sim.all_running


def test_filter_uses_at_most_num_threads(monkeypatch):
    used = []
    monkeypatch.setattr(teams, "_ROBOTS_PER_THREAD", 1)
    monkeypatch.setattr(threads, "available_cores", lambda: 3)
    monkeypatch.setattr(threads, "share", lambda calls_of, blocks, most, *_: used.append(most))
    for num_threads in (None, 1, 2):
        venv = HeadingVectorWrapper(rv.make_vec("fig3", 64, num_threads=num_threads))
        venv.reset(seed=0)
    assert used == [3, 1, 2]


def test_share_from_several_callers_at_once():
    with ThreadPoolExecutor(4) as callers:
        work = [callers.submit(lambda: [marked(40, 3, 100) for _ in range(50)]) for _ in range(4)]
        np.testing.assert_array_equal([one.result(30) for one in work], 1.0)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs threads that choose cores")
def test_workers_run_on_the_cores_of_their_process():
    """The affinity of threads is unchanged."""
    before, found = os.sched_getaffinity(0), []
    for kind in (lambda part: [partial(list)], lambda part: [list]):
        for _ in range(3):
            calls = lambda part: [*kind(part), lambda: found.append(os.sched_getaffinity(0))]  # noqa: B023, E731
            threads.share(calls, 2, 2)
    assert len(found) == 12 and all(cores == before for cores in found)
    assert os.sched_getaffinity(0) == before


def test_workers_are_daemons_and_as_many_as_needed():
    marked(10, 5, kind=python)  # the caller waits for five
    workers = [thread for thread in threading.enumerate() if thread.name == "rendezvous"]
    assert len(workers) >= 5 and all(worker.daemon for worker in workers)


def test_available_cores_is_at_most_numba_num_threads(monkeypatch):
    monkeypatch.setattr(threads, "_cores", lambda: 8)
    for share, left in (("3", 3), ("12", 8), ("", 8), ("0", 8), ("some", 8)):
        monkeypatch.setenv("NUMBA_NUM_THREADS", share)
        assert threads.available_cores() == left


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:os.fork.. was called:RuntimeWarning")  # if JAX is loaded
def test_step_in_a_forked_child_after_a_threaded_step(monkeypatch):
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    sim = Simulator(five("unicycle"), 64, num_threads=2)
    sim.reset(0)
    actions = np.ones((64, 5, 2), np.float32)
    sim.step(actions)
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=lambda: sender.send((sim.step(actions), sim.positions)[1]))
    child.start()
    assert receiver.poll(60), "the forked child hangs"
    positions = receiver.recv()
    child.join(20)
    assert child.exitcode == 0
    sim.step(actions)
    np.testing.assert_array_equal(positions, sim.positions)


@pytest.fixture
def steps(monkeypatch):
    """Make steps with given durations for one and several threads; returns the threads of each."""
    now, tuner = [0], ThreadTuner(4, 0.1)
    monkeypatch.setattr(time, "perf_counter_ns", lambda: now[0])

    def make(count, alone, several):
        made = []
        for _ in range(count):
            made.append(tuner.begin())
            now[0] += alone if made[-1] == 1 else several
            tuner.end()
        return made

    return make


def test_tuner_starts_with_several_threads_and_settles_on_one_if_faster(steps):
    made = steps(9000, alone=200, several=300)
    assert set(made[:399]) == {4} and made[500:].count(1) > 0.94 * len(made[500:])


def test_tuner_keeps_several_threads_if_faster_and_retries_one(steps):
    made = steps(9000, alone=300, several=200)
    assert 0 < made.count(1) < 0.06 * len(made)


def test_tuner_follows_a_change_of_speed(steps):
    steps(2000, alone=300, several=200)
    assert steps(1000, alone=300, several=900)[100:].count(4) < 120
    assert steps(4000, alone=300, several=200)[2000:].count(1) < 150


def test_tuner_ignores_one_slow_step_but_not_many(steps):
    steps(2700, alone=300, several=200)
    steps(1, alone=300, several=10**9)
    assert set(steps(20, alone=300, several=200)) == {4}
    for _ in range(10):
        steps(1, alone=300, several=4000)
        steps(19, alone=300, several=200)
    assert set(steps(20, alone=300, several=200)) == {1}


def test_tuner_discards_the_first_steps_of_a_trial(steps):
    """An idle core is slow initially."""
    assert set(steps(399, alone=200, several=300)) == {4}
    assert set(steps(48, alone=10**6, several=300)) == {1}
    steps(48, alone=200, several=300)
    assert set(steps(500, alone=200, several=300)) == {1}


def test_tuner_with_one_thread_always_returns_one():
    assert {ThreadTuner(1, 0.0).begin() for _ in range(600)} == {1}
