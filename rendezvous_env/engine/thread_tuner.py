"""Number of threads of a step: the maximum, or one where that is faster."""

import math
import time

_PERIOD, _TRIALS, _DISCARDED, _FIRST_TRIAL = 2048, 96, 48, 400
"""Trial schedule. Of every 2048 steps the last 96 use the other number of threads, to measure
it. The first 48 of these are discarded, since an idle core is slow at first. The first trial is
at step 400."""
_WEIGHT, _TRIAL_WEIGHT = 1 / 128, 1 / 16  # of one step in the running mean
_MAX_RATIO = 20.0  # a step counts as at most this many times the mean: a process may be suspended


class ThreadTuner:
    """Chooses between one thread and ``max_threads``.

    If other processes keep the cores busy, a second thread waits for a core and delays the step.
    ``head_start`` is the share of the work that the caller does while the other threads wake up.
    """

    def __init__(self, max_threads: int, head_start: float) -> None:
        self.max_threads, self.head_start = max_threads, head_start
        self._steps, self._began, self._weight = _PERIOD - _TRIALS - _FIRST_TRIAL, 0, 0.0
        self._single = False
        # with several threads, with one: mean time of a step, ns, and the number of steps
        self._mean, self._count = [math.nan, math.nan], [0, 0]

    def begin(self) -> int:
        """Number of threads for the step that begins."""
        self._steps += 1
        several, one = self._mean
        self._single, self._weight = several > one, _WEIGHT  # False before the first trial
        if (trial := self._steps % _PERIOD - (_PERIOD - _TRIALS)) >= 0:
            self._single = not self._single
            self._weight = _TRIAL_WEIGHT if trial >= _DISCARDED else 0.0
        self._began = time.perf_counter_ns()
        return 1 if self._single else self.max_threads

    def end(self) -> None:
        """Record the duration of the last step that began."""
        took, which = time.perf_counter_ns() - self._began, self._single
        if self._weight > 0.0:
            self._count[which] += 1
            mean = self._mean[which] if self._count[which] > 1 else took
            weight = max(self._weight, 1.0 / self._count[which])
            self._mean[which] = mean + weight * (min(took, _MAX_RATIO * mean) - mean)
