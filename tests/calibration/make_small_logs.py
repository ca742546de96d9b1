"""Writes tests/data/sensor_logs: a log of three simulated robots in each format.

python tests/calibration/make_small_logs.py
"""

import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from log_files import WRITERS  # noqa: E402
from simulated_logs import simulate  # noqa: E402

FOLDER = ROOT / "tests/data/sensor_logs"
SECONDS, ROBOTS = 90.0, 3


def main() -> None:
    """Write all formats; poses are those of every third step."""
    ((bearings, poses),) = simulate(seeds=(5,), duration=SECONDS, n_robots=ROBOTS)
    poses = poses.reshape(-1, ROBOTS, 5)[::3].reshape(-1, 5)
    for name, write in WRITERS.items():
        shutil.rmtree(FOLDER / name, ignore_errors=True)
        FOLDER.mkdir(parents=True, exist_ok=True)
        write(FOLDER / name, bearings.round(5), poses.round(5))


if __name__ == "__main__":
    main()
