"""Repeated runs of four robots and a world, each in a separate process.

    python team.py [RUNS] [differential_drive]

Prints the numbers of rendezvous and of collision-free rendezvous, and the duration of a tick.
"""

import json
import math
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from world import READY

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
SECONDS = 90.0  # for a run, from when all robots are there
LIMIT = 2 * READY + SECONDS  # of a world's process, which may compile for as long as robots do


def run(seed, folder, *parameters, recording=None):
    """One run: how it ended, and the ticks of all robots, (wall, work) in s and kernels compiled.

    Parameters are those of the node that are true. A recording is a folder to write.

    Raises:
        subprocess.TimeoutExpired: for a process that hangs; it says where.
        subprocess.CalledProcessError: for one that ends otherwise than it should.
    """
    apart = {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder),
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "OPENBLAS_NUM_THREADS": "1",
    }
    environment = os.environ | apart
    files = [folder / f"robot{i}.json" for i in range(4)]
    python = [sys.executable, "-X", "faulthandler"]
    given = [word for name in parameters for word in ("-p", f"{name}:=true")]
    started = []

    def start(*command, **options):
        started.append(subprocess.Popen([*map(str, command)], env=environment, **options))
        return started[-1]

    try:
        robots = [
            start(
                *(*python, HERE / "one_robot.py", files[i]),
                *("--ros-args", "-r", f"__ns:=/robot{i}", *given),
                # where a shell runs this in the background, nobody hears a Ctrl-C
                preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
            )
            for i in range(4)
        ]
        if recording is not None:
            names = [f"robot{i}" for i in range(4)]
            recorder = start(
                *(*python, ROOT / "examples/17_ros_recorder.py", recording, *names),
                preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
            )
            robots.append(recorder)
        world = start(*python, HERE / "world.py", seed, SECONDS, stdout=subprocess.PIPE, text=True)
        said, _ = world.communicate(timeout=LIMIT)
        for robot in robots:
            robot.send_signal(signal.SIGINT)
        for process in started:
            if code := process.wait(timeout=30.0):
                raise subprocess.CalledProcessError(code, process.args)
    finally:
        for process in started:
            process.send_signal(signal.SIGABRT)  # who hangs says where; who has ended, nothing
            process.wait()
    ticks = [tick for file in files for tick in json.loads(file.read_text(encoding="utf-8"))]
    return json.loads(said.splitlines()[-1]), ticks


def percentile(values, share):
    """Quantile of the values for this fraction; NaN without values, if every run hung."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)] if values else math.nan


def main(runs, *parameters):
    found, ticks, hangs = [], [], 0
    for seed in range(runs):
        with TemporaryDirectory() as folder:
            try:
                ended, took = run(seed, Path(folder), *parameters)
            except subprocess.SubprocessError as error:
                hangs += isinstance(error, subprocess.TimeoutExpired)
                print(seed, error, flush=True)
                continue
        found.append(ended)
        ticks += took
        print(seed, ended, flush=True)
    met = [one for one in found if one["met"]]
    wall, work = ([1e3 * tick[k] for tick in ticks] for k in (0, 1))
    print(
        f"{runs} runs, {hangs} hangs: {len(met)} met, "
        f"{sum(one['contacts'] == 0 for one in met)} without a contact; {len(ticks)} ticks: "
        f"p99 {percentile(wall, 0.99):.2f} ms by the clock, {percentile(work, 0.99):.2f} ms of work"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, *sys.argv[2:])
