"""Tasks on the workers of a Ray cluster.

Each is a task of Ray's own, and not one of its joblib backend: that one keeps a pool whose results
come all together, and of which nothing is left when a worker is lost.
"""

from __future__ import annotations

import os
import pickle
import socket
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any, TypeVar

from .checks import UserError

Task = TypeVar("Task")
Result = TypeVar("Result")

NAME = "rendezvous"
"""Of a worker's process while it is at a task: ``ray::rendezvous``."""
_AHEAD = 4
"""Tasks that each core of a cluster is given at a time: some wait, so that none of them idles."""
_ANSWER = 10.0
"""s that a cluster has to answer."""
_MODE = "RAY_AUTH_MODE"
"""Where Ray reads whether a cluster asks for a token. Each process reads it for itself; Ray sets it
in one that starts a cluster of its own."""
ALONE = {name: "1" for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
"""Environment of a worker: one thread each."""


def spread(
    work: Callable[[Task], Result],
    tasks: Sequence[tuple[int, Task]],
    *,
    tries: int,
    jobs: int | None,
    address: str | None,
    cores: int,
) -> Generator[tuple[int, Result], None, None]:
    """Do tasks on a cluster. A worker or a machine that is lost costs what it was at.

    Args:
        work: what to do with a task. A worker stands in the same folder as this process, where it
            has that folder, so that relative paths mean the same.
        tasks: their numbers, and what is to be done.
        tries: how often a task may lose its worker.
        jobs: how many are done at once; None is one on each core of the cluster.
        address: of the cluster; None starts one on this machine.
        cores: of the one that is started.

    Yields:
        Number of a task and what it gave, as they end.

    Raises:
        UserError: if there is no cluster, it does not reach this process, or a task has lost its
            worker too often.
        Exception: what a task raised.
    """
    import ray
    from ray.exceptions import OwnerDiedError, RayError, RayTaskError

    with _joined(address, cores):
        ahead = jobs or _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        options = {"num_cpus": 1, "max_retries": tries - 1, "name": NAME}
        do = ray.remote(_do).options(**options, scheduling_strategy="SPREAD")
        left, flying = iter(tasks), dict[Any, int]()
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
            except OwnerDiedError as error:  # this process, which lives
                raise UserError(
                    f"the cluster did not reach this process to fetch a result: {_mode()}, and no "
                    "firewall may stand between"
                ) from error
            except RayError as error:
                raise UserError(
                    f"workers of the cluster ended {tries} times at one task ({error}); memory "
                    "may be short: try fewer --jobs"
                ) from error
            yield number, result


@contextmanager
def _joined(address: str | None, cores: int) -> Iterator[None]:
    """This process is a driver of the cluster."""
    import ray
    from ray.exceptions import RayError

    if address:
        _check_answers(address)
    try:
        ray.init(
            address or "local",
            num_cpus=None if address else cores,
            runtime_env={"env_vars": ALONE},
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
    """What two processes must have in common, in words."""
    return f"{_MODE} is {os.environ.get(_MODE, 'not set')} here and must be that of the cluster"


def _check_answers(address: str) -> None:
    """Refuse a machine where nobody listens: Ray itself would ask for many minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not (host and port.isdigit()):
        return  # "auto", or one that Ray refuses at once
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER).close()
    except (OSError, OverflowError) as error:
        raise UserError(
            f"--address {address}: no cluster answers there ({error}); "
            "`ray start --head` says the address of one"
        ) from error


def _do(folder: str, work: Callable[[Any], Any], task: Any) -> bytes:
    """Do a task and pickle what it gives: arrays that Ray itself brings back are read-only."""
    with suppress(OSError):
        os.chdir(folder)
    return pickle.dumps(work(task))
