"""Tasks for tests of workers, in a module that loads quickly in each worker."""

import os
import signal
import time

from train.checks import UserError


def where(task):
    """Process of the task, its number of threads, and its number of cores."""
    from rendezvous_env.engine.threads import available_cores

    time.sleep(0.05)
    return task, os.getpid(), os.environ.get("NUMBA_NUM_THREADS"), available_cores()


def dies_once(task):
    """End the process, unless another one has done so before."""
    number, folder = task
    if number == 3 and not (folder / "died").exists():
        (folder / "died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def dies(task):
    os.kill(os.getpid(), signal.SIGKILL)


def refuses(task):
    raise UserError(f"task {task} cannot be")


def threads(task):
    """Numbers of threads of matrix products in NumPy and torch in the task's process."""
    import numpy  # noqa: F401, which must be there to be asked
    import torch
    from threadpoolctl import threadpool_info

    pools = threadpool_info()
    found = [pool["num_threads"] for pool in pools if pool["user_api"] == "blas"]
    return torch.get_num_threads(), *found
