"""How many threads a step takes: as many as it may, or one where that has been quicker of late."""

import math
import time

_PERIOD, _TRIALS, _FIRST, _BEFORE = 2048, 96, 48, 400
"""Of so many steps the last few are made the other way, to see how long that takes now. The first
of these do not count: a core that was idle is slow for a while. The first trial comes after 400."""
_USUAL, _TRIED = 1 / 128, 1 / 16  # weight of a step among those before it, and of a trial
_LONGEST = 20.0  # times as long as those before may a step count: a process may be stopped


class Pace:
    """Chooses between one thread and ``most``: where other processes keep the other cores busy, a
    second thread waits for its turn there, and the step for the thread. ``ahead`` is the share of
    the work that the caller does while others wake up.
    """

    def __init__(self, most: int, ahead: float) -> None:
        self.most, self.ahead = most, ahead
        self._steps, self._began, self._weight = _PERIOD - _TRIALS - _BEFORE, 0, 0.0
        self._alone = False
        # of steps by several threads, and by one: ns of recent ones, and how many there were
        self._mean, self._count = [math.nan, math.nan], [0, 0]

    def begin(self) -> int:
        """Threads for the step that begins now."""
        self._steps += 1
        several, alone = self._mean
        self._alone, self._weight = several > alone, _USUAL  # several before there has been a trial
        if (trial := self._steps % _PERIOD - (_PERIOD - _TRIALS)) >= 0:
            self._alone, self._weight = not self._alone, _TRIED if trial >= _FIRST else 0.0
        self._began = time.perf_counter_ns()
        return 1 if self._alone else self.most

    def end(self) -> None:
        """Learn how long the step took that was begun last."""
        took, which = time.perf_counter_ns() - self._began, self._alone
        if self._weight > 0.0:
            self._count[which] += 1
            mean = self._mean[which] if self._count[which] > 1 else took
            weight = max(self._weight, 1.0 / self._count[which])
            self._mean[which] = mean + weight * (min(took, _LONGEST * mean) - mean)
