"""How many threads a step takes: as many as it may, or one where that has been quicker of late."""

import math
import time

_PERIOD, _TRIALS = 256, 4
"""Of so many steps the last few are made the other way, to see how long that takes now."""
_WEIGHT = 0.125  # of a step among those before it
_MOST = 2.0  # times as long as those before is the most that counts: a step may be held up


class Pace:
    """Chooses between one thread and ``most``: where other processes keep the other cores busy, a
    second thread waits for its turn there, and the step for the thread. ``ahead`` is the share of
    the work that the caller does while others wake up.
    """

    def __init__(self, most: int, ahead: float) -> None:
        self.most, self.ahead = most, ahead
        self._steps, self._began = 0, 0
        self._alone = False
        self._mean = [math.nan, math.nan]  # ns, of recent steps by several threads, and by one

    def begin(self) -> int:
        """Threads for the step that begins now."""
        self._steps += 1
        several, alone = self._mean
        self._alone = several > alone  # not before there has been a trial
        if self._steps % _PERIOD >= _PERIOD - _TRIALS:
            self._alone = not self._alone
        self._began = time.perf_counter_ns()
        return 1 if self._alone else self.most

    def end(self) -> None:
        """Learn how long the step took that was begun last."""
        took, mean = time.perf_counter_ns() - self._began, self._mean[self._alone]
        if math.isnan(mean):
            self._mean[self._alone] = took
        else:
            self._mean[self._alone] += _WEIGHT * (min(took, _MOST * mean) - mean)
