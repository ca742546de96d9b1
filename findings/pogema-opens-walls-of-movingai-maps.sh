#!/usr/bin/env bash
# POGEMA reads the walls of a MovingAI map, "@", as free cells in which agents start.
#
# Versions: pogema 1.4.0, gymnasium 0.28.1, pydantic 1.9.1, numpy 1.26.4, Python 3.11.
# Input: the rows of a map in MovingAI's format ("." free, "@" wall) as GridConfig.map; four agents.
# Guess: "@" is an obstacle, or an unsupported symbol, which GridConfig rejects for other characters.
# Seen: no cell is an obstacle. POGEMA marks a permitted start with "@", so agents start inside walls
#   and may pass them. The map with "#" for "@" is as expected. MovingAI's other obstacles ("T", "O",
#   "W") stand for targets here and raise an error, so only maps of plain walls open silently.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pogema==1.4.0 gymnasium==0.28.1 pydantic==1.9.1 numpy==1.26.4
"$folder/venv/bin/python" - <<'PYTHON'
from pogema import GridConfig, pogema_v0

FILE = """type octile
height 5
width 6
map
@@@@@@
@....@
@.@@.@
@....@
@@@@@@
"""
rows = FILE.splitlines()[4:]
walls = sum(row.count("@") for row in rows)


def read(lines):
    """Number of obstacles, and agents in walls of the file for each of ten seeds."""
    inside = []
    for seed in range(10):
        grid = pogema_v0(GridConfig(map="\n".join(lines), num_agents=4, obs_radius=2, seed=seed))
        grid.reset()
        grid = grid.unwrapped.grid
        places = grid.get_agents_xy(ignore_borders=True)
        inside.append(sum(rows[int(row)][int(column)] == "@" for row, column in places))
    return int(grid.get_obstacles(ignore_borders=True).sum()), inside


try:
    trees = GridConfig(map=".T.\n...").map
except ValueError as error:
    trees = type(error).__name__
file, translated = read(rows), read([row.replace("@", "#") for row in rows])
print("walls in the file:", walls, "· obstacles read from @:", file[0], "· from #:", translated[0])
print("agents that start in walls, by seed: @", file[1], "· #", translated[1], "· map with T:", trees)
assert translated == (walls, [0] * 10)
assert trees == "ValidationError", "T is read now"
assert file[0] == 0 and sum(file[1]) > 10, "@ is a wall now"
PYTHON
