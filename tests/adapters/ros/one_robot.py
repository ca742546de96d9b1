"""Process of one robot: examples/14_ros_node.py with measured ticks.

python one_robot.py WRITTEN --ros-args -r __ns:=/robot0
"""

import json
import runpy
import sys
import time
from pathlib import Path

from numba.core.event import install_recorder

ROOT = Path(__file__).parents[3]


def node_of():
    """Names in the node's program."""
    return runpy.run_path(str(ROOT / "examples/14_ros_node.py"), run_name="rendezvous_node")


def main(written):
    names, ticks = node_of(), []
    tick = names["RendezvousNode"].tick

    def timed(self):
        """Run a tick, and record its cost.

        The record holds wall-clock and processor time, s, and the number of compiled or loaded
        kernels.
        """
        with install_recorder("numba:compiler_lock") as compiled:
            began, worked = time.perf_counter(), time.process_time()
            tick(self)
            ended, work = time.perf_counter() - began, time.process_time() - worked
        ticks.append((ended, work, len(compiled.buffer)))

    names["RendezvousNode"].tick = timed
    names["main"]()
    written.write_text(json.dumps(ticks), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
