"""Execution of independent tasks: sequentially, on all cores (joblib) or on a Ray cluster."""

import os
import pickle
import queue
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any, Literal, TypeVar

from threadpoolctl import ThreadpoolController
from tyro.conf import arg

from .checks import Bounds, Flags, UserError, check_installed, check_unused

Task = TypeVar("Task")
Result = TypeVar("Result")

_ALONE = 2.0
"""Time before worker processes are started, s; shorter work stays in this process."""
_TRIES = 3
"""Maximum number of consecutive worker losses without a finished task."""
_ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
"""Environment variables of a worker."""
NAME = "rendezvous"
"""Process name of a busy Ray worker: ``ray::rendezvous``."""
_AHEAD = 4
"""Number of tasks submitted per cluster core, so that no core idles."""
_ANSWER = 10.0
"""Timeout of a cluster connection, s."""
_MODE = "RAY_AUTH_MODE"
"""Environment variable with the authentication mode of a cluster."""


@dataclass(frozen=True, kw_only=True)
class Workers(Flags):
    """Flags of the workers of a command."""

    jobs: Annotated[int | None, Bounds(1, 2**12)] = None
    """Number of parallel processes. Default: one per core, or all of a cluster. Results do not
    depend on it, bitwise."""
    on: Annotated[Literal["here", "ray"], arg(name="backend", aliases=("--on",))] = "here"
    """Backend: this machine or a Ray cluster."""
    address: str | None = None
    """Address of the Ray cluster. Default: start one on this machine."""

    def __post_init__(self) -> None:
        """Validate the flags, including the cluster address."""
        super().__post_init__()
        if self.on == "here":
            check_unused(self, {"address": "only --backend ray has one"})
        if self.on == "ray":
            check_installed("--backend ray", "ray", "ray")

    @property
    def worker_count(self) -> int:
        """Number of parallel processes on this machine."""
        from rendezvous_env.engine.threads import available_cores  # not imported by each worker

        return self.jobs or available_cores()


def parallel_map(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: Workers,
    here: Callable[[Task], bool] = lambda task: False,
    *,
    long: bool = False,
) -> Generator[tuple[int, Result], None, None]:
    """Iterate over (task index, result) in order of completion; results do not depend on workers.

    Workers are processes, since most of a step is Python code under the GIL. The tasks of a lost
    worker (killed or out of memory) are repeated. Workers end when the iterator is closed; callers
    that may be interrupted must close it.

    Args:
        work: function of a task; work, tasks and results are pickled.
        tasks: inputs of ``work``.
        workers: backend and number of workers.
        here: (task) → whether it must run in this process.
        long: whether to start workers at once, or only after some seconds.

    Raises:
        UserError: if workers are lost repeatedly, or the cluster is not available.
        Exception: the error of a task.
    """
    left = dict(enumerate(tasks))
    alone = workers.on == "here" and workers.worker_count == 1
    began, matrices = time.monotonic(), ThreadpoolController().select(user_api="blas")
    for number, task in enumerate(tasks):
        at_first = workers.on == "here" and not long and time.monotonic() - began < _ALONE
        if alone or at_first or here(task):
            with _one_thread(matrices):
                result = work(left.pop(number))
            yield number, result
    if not left:
        return
    if workers.on == "ray":
        found = _on_cluster(work, left, workers)
    else:
        found = _on_cores(work, left, workers.worker_count)
    with closing(found):
        yield from found


@contextmanager
def _one_thread(matrices: Any) -> Iterator[None]:
    """Limit BLAS and torch to one thread as in workers, since rounding depends on the number."""
    torch: Any = sys.modules.get("torch")
    threads = None if torch is None else torch.get_num_threads()
    try:
        if torch is not None:
            torch.set_num_threads(1)
        with matrices.limit(limits=1):
            yield
    finally:
        if torch is not None:
            torch.set_num_threads(threads)


def _on_cores(
    work: Callable[[Task], Result], left: dict[int, Task], count: int
) -> Generator[tuple[int, Result], None, None]:
    """Results from worker processes, which are restarted if one is lost."""
    from joblib.externals.loky.process_executor import BrokenProcessPool

    lost = 0
    while left:
        executor = _executor(min(count, len(left)))
        try:
            numbers = {executor.submit(work, task): number for number, task in left.items()}
            for done in as_completed(numbers):
                result, number, lost = done.result(), numbers.pop(done), 0
                del left[number]
                yield number, result
        except BrokenProcessPool as error:
            lost += 1
            if lost == _TRIES:
                raise UserError(
                    f"workers ended {_TRIES} times before any task was done ({error}); memory may "
                    f"be short: try fewer than --jobs {count}"
                ) from error
        finally:
            # the executor's thread would otherwise look for discarded tasks
            with suppress(queue.Empty):
                while True:
                    executor._work_ids.get_nowait()
            executor.shutdown(kill_workers=True)


def _executor(count: int) -> Any:
    """Single-threaded worker processes that end with this process.

    They ignore Ctrl-C, which a terminal sends to all processes; this process ends them.
    """
    from joblib.externals.loky.process_executor import ProcessPoolExecutor

    # compilation makes a worker's memory grow, for which joblib would start another one
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
    executor = ProcessPoolExecutor(
        count, initializer=_end_with, initargs=(os.getpid(),), env=_ONE_THREAD
    )
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        executor._ensure_executor_running()  # processes and threads inherit the mask
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return executor


def _end_with(parent: int) -> None:
    """End this worker when its parent process has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _on_cluster(
    work: Callable[[Task], Result], tasks: dict[int, Task], workers: Workers
) -> Generator[tuple[int, Result], None, None]:
    """Results from a Ray cluster, one Ray task each.

    Ray's joblib backend would return all results together, and none if a worker is lost.
    """
    import ray
    from ray.exceptions import OwnerDiedError, RayError, RayTaskError

    with _joined(workers.address, workers.worker_count):
        cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
        ahead = workers.jobs or _AHEAD * cores
        options = {"num_cpus": 1, "max_retries": _TRIES - 1, "name": NAME}
        do = ray.remote(_do).options(**options, scheduling_strategy="SPREAD")
        left, flying = iter(tasks.items()), dict[Any, int]()
        while True:
            for number, task in islice(left, ahead - len(flying)):
                flying[do.remote(os.getcwd(), work, task)] = number
            if not flying:
                return
            (found,), _ = ray.wait(list(flying))
            number = flying.pop(found)
            try:
                result = pickle.loads(ray.get(found))
            except RayTaskError as error:
                raise error.cause from None
            except OwnerDiedError as error:  # this process, which is alive
                raise UserError(
                    f"the cluster did not reach this process to fetch a result: {_mode()}, and no "
                    "firewall may block the connection"
                ) from error
            except RayError as error:
                raise UserError(
                    f"workers of the cluster ended {_TRIES} times at one task ({error}); memory "
                    "may be short: try fewer --jobs"
                ) from error
            yield number, result


@contextmanager
def _joined(address: str | None, cores: int) -> Iterator[None]:
    """Connect this process to the cluster as a driver."""
    import ray
    from ray.exceptions import RayError

    host, _, port = (address or "").rpartition("://")[2].rpartition(":")
    if host and port.isdigit():  # otherwise "auto", or an address that Ray rejects at once
        try:  # without a listener, Ray itself would retry for many minutes
            socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER).close()
        except (OSError, OverflowError) as error:
            raise UserError(
                f"--address {address}: no cluster answers there ({error}); `ray start --head` "
                "prints the address of one"
            ) from error
    try:
        ray.init(
            address or "local",
            num_cpus=None if address else cores,
            runtime_env={"env_vars": _ONE_THREAD},
            log_to_driver=False,
            include_dashboard=None if address else False,
        )
    except ValueError as error:
        raise UserError(f"--address {address}: {error}") from error
    except (ConnectionError, RayError) as error:
        raise UserError(f"--address {address}: {error}; {_mode()}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _mode() -> str:
    return f"{_MODE} is {os.environ.get(_MODE, 'not set')} here and must be that of the cluster"


def _do(folder: str, work: Callable[[Any], Any], task: Any) -> bytes:
    """Run a task, in the caller's working folder if it exists on the worker.

    The result is pickled, since arrays returned by Ray are read-only.
    """
    with suppress(OSError):
        os.chdir(folder)
    return pickle.dumps(work(task))
