"""Four robots and a world, a process each: runs, counted.

    python team.py [RUNS] [differential_drive]

prints how many met, how many met without a contact, and what a tick took.
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

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
SECONDS = 90.0  # for a run; what takes longer hangs


def run(seed, folder, *parameters):
    """One run: how it ended, and the ticks of all robots, (wall, work) in s.

    Parameters are those of the node that are true.

    Raises:
        subprocess.TimeoutExpired: for a process that hangs.
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
    node = [sys.executable, HERE / "one_robot.py"]
    given = [word for name in parameters for word in ("-p", f"{name}:=true")]
    robots = [
        subprocess.Popen(
            [*node, files[i], "--ros-args", "-r", f"__ns:=/robot{i}", *given],
            env=environment,
            # where a shell runs this in the background, nobody hears a Ctrl-C
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
        )
        for i in range(4)
    ]
    try:
        done = subprocess.run(
            [sys.executable, HERE / "world.py", str(seed), str(SECONDS)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=SECONDS + 60.0,
            check=True,
        )
        for robot in robots:
            robot.send_signal(signal.SIGINT)
        assert [robot.wait(timeout=30.0) for robot in robots] == [0] * 4
    finally:
        for robot in robots:
            robot.kill()
            robot.wait()
    ticks = [tick for file in files for tick in json.loads(file.read_text(encoding="utf-8"))]
    return json.loads(done.stdout.splitlines()[-1]), ticks


def percentile(values, share):
    """The value below which this share lies; NaN of none, where every run hung."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)] if values else math.nan


def main(runs, *parameters):
    found, ticks, hangs = [], [], 0
    for seed in range(runs):
        with TemporaryDirectory() as folder:
            try:
                ended, took = run(seed, Path(folder), *parameters)
            except subprocess.TimeoutExpired:
                hangs += 1
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
