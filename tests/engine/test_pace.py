"""One thread or several: whichever has been quicker of late."""

import pytest

from rendezvous_env.engine import pace as module
from rendezvous_env.engine.pace import Pace


@pytest.fixture
def steps(monkeypatch):
    """Makes steps that take so long by one thread and by several: the threads of each."""
    now, pace = [0], Pace(4, 0.1)
    monkeypatch.setattr(module.time, "perf_counter_ns", lambda: now[0])

    def make(count, alone, several):
        made = []
        for _ in range(count):
            made.append(pace.begin())
            now[0] += alone if made[-1] == 1 else several
            pace.end()
        return made

    return make


def test_several_threads_begin_and_one_takes_over_where_it_is_quicker(steps):
    made = steps(9000, alone=200, several=300)
    assert set(made[:399]) == {4} and made[500:].count(1) > 0.94 * len(made[500:])


def test_several_stay_where_they_are_quicker_and_one_is_tried_now_and_then(steps):
    made = steps(9000, alone=300, several=200)
    assert 0 < made.count(1) < 0.06 * len(made)


def test_what_becomes_quicker_is_found_out(steps):
    steps(2000, alone=300, several=200)
    assert steps(1000, alone=300, several=900)[100:].count(4) < 120
    assert steps(4000, alone=300, several=200)[2000:].count(1) < 150


def test_one_step_that_is_held_up_changes_nothing_and_many_do(steps):
    steps(2700, alone=300, several=200)
    steps(1, alone=300, several=10**9)
    assert set(steps(20, alone=300, several=200)) == {4}
    for _ in range(10):
        steps(1, alone=300, several=4000)
        steps(19, alone=300, several=200)
    assert set(steps(20, alone=300, several=200)) == {1}


def test_the_first_steps_of_a_trial_do_not_count(steps):
    """A core that was idle is slow for a while."""
    assert set(steps(399, alone=200, several=300)) == {4}
    assert set(steps(48, alone=10**6, several=300)) == {1}
    steps(48, alone=200, several=300)
    assert set(steps(500, alone=200, several=300)) == {1}


def test_one_thread_is_all_there_may_be():
    assert {Pace(1, 0.0).begin() for _ in range(600)} == {1}
