"""Tasks of tests of workers, in a module that is loaded soon: each worker loads it."""

import os
import signal
import time

from train.checks import UserError


def where(task):
    """Who does it, with how many threads, and on how many cores."""
    from rendezvous_env.engine.threads import available_cores

    time.sleep(0.05)
    return task, os.getpid(), os.environ.get("NUMBA_NUM_THREADS"), available_cores()


def dies_once(task):
    """Ends its process, unless somebody has done so before."""
    number, folder = task
    if number == 3 and not (folder / "died").exists():
        (folder / "died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def dies(task):
    os.kill(os.getpid(), signal.SIGKILL)


def refuses(task):
    raise UserError(f"task {task} cannot be")


def product(task):
    """A product of matrices as a network has it, as bytes."""
    import numpy as np

    random = np.random.default_rng(task)
    shapes = (4000, 128), (128, 128), (128, 14)
    rows, *weights = (random.normal(size=shape).astype(np.float32) for shape in shapes)
    return (rows @ weights[0] @ weights[1]).tobytes()


def torch_product(task):
    """A product as torch has it, of as few rows as a team, as bytes."""
    import numpy as np
    import torch

    random = np.random.default_rng(task)
    rows, weights = (torch.tensor(random.normal(size=shape)) for shape in ((7, 512), (512, 512)))
    return (rows.float() @ weights.float()).numpy().tobytes()
