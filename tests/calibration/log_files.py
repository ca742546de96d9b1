"""Writers of the formats that rendezvous sensor reads."""

import numpy as np

BARCODES = {1: 63, 2: 14, 3: 41, 4: 25, 5: 72}
LANDMARKS = {6: (5.0, 0.0), 7: (-5.0, 1.0), 8: (0.0, 5.5), 20: (1.0, -5.0)}
HEADER = "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n# Time [s]\n"
CLOCK = 1248272272.841  # s, at which such logs begin


def write_csv(folder, bearings, poses):
    folder.mkdir(parents=True, exist_ok=True)
    _write_csv(folder / "bearings.csv", "time,observer,target,bearing", bearings, 3)
    _write_csv(folder / "poses.csv", "time,robot,x,y,heading", poses, 2)
    return folder


def _write_csv(path, header, rows, numbers):
    lines = []
    for row in rows:
        cells = [f"{row[0]:.3f}", *(f"robot{int(one)}" for one in row[1:numbers])]
        lines.append(",".join([*cells, *(f"{one:.5f}" for one in row[numbers:])]))
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def write_parquet(folder, bearings, poses):
    import pyarrow
    from pyarrow import parquet

    folder.mkdir(parents=True, exist_ok=True)
    for name, table, columns in (
        ("bearings", bearings, ("time", "observer", "target", "bearing")),
        ("poses", poses, ("time", "robot", "x", "y", "heading")),
    ):
        data = dict(zip(columns, table.T, strict=True))
        for key in ("observer", "target", "robot"):
            if key in data:
                data[key] = data[key].astype(np.int64)
        parquet.write_table(pyarrow.table(data), folder / f"{name}.parquet")
    return folder


def write_mrclam(folder, bearings, poses, barcodes=BARCODES, fixed=True):
    """Robots 0 to n − 1 of the tables are 1 to n; every tenth frame shows a landmark, too."""
    folder.mkdir(parents=True, exist_ok=True)
    robots = np.unique(poses[:, 1]).astype(int)
    codes = {**{number: 100 + number for number in LANDMARKS}, **barcodes}
    lines = "".join(f" {number} \t {code}\n" for number, code in codes.items())
    (folder / "Barcodes.dat").write_text(HEADER + lines, encoding="utf-8")
    lines = "".join(f" {k} \t {x} {y} 0.0001 0.0002\n" for k, (x, y) in LANDMARKS.items())
    if fixed:
        (folder / "Landmark_Groundtruth.dat").write_text(HEADER + lines, encoding="utf-8")
    for robot in robots:
        own = poses[poses[:, 1] == robot]
        seen = [(t, codes[int(j) + 1], b) for t, i, j, b in bearings if i == robot]
        if fixed:
            seen += _landmark_rows(own, codes)
        seen.sort()
        truth = (f"{CLOCK + t:.3f} \t {x:.6f} {y:.6f} {_wrapped(h):.4f}" for t, _, x, y, h in own)
        rows = (f"{CLOCK + t:.3f} \t {code} 1.0 {b:.5f}" for t, code, b in seen)
        for kind, told in (("Groundtruth", truth), ("Measurement", rows)):
            text = HEADER + "\n".join(told) + "\n# end of file\n"
            (folder / f"Robot{robot + 1}_{kind}.dat").write_text(text, encoding="utf-8")
    return folder


def _landmark_rows(own, codes):
    """Exact bearings of landmarks ahead."""
    rows = []
    for t, _, x, y, heading in own[::50]:
        for number, (u, v) in LANDMARKS.items():
            bearing = _wrapped(np.arctan2(v - y, u - x) - heading)
            if abs(bearing) < 0.7:
                rows.append((t, codes[number], bearing))
    return rows


def _wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def write_recording(folder, bearings, poses):
    """Bearings of a frame of all robots that have any, and empty messages of the others."""
    from train.sensors.recorder import Recorder

    with Recorder(folder) as recorder:
        for time, robot, x, y, heading in poses:
            recorder.write_pose(f"robot{int(robot)}", 1.0 + time, (x, y, 0.0), heading)
        robots = np.unique(poses[:, 1])
        for time in np.unique(bearings[:, 0]):
            now = bearings[bearings[:, 0] == time]
            for robot in robots:
                angles = now[now[:, 1] == robot, 3]
                recorder.write_bearings(f"robot{int(robot)}", 1.0 + time, angles)
    return folder


WRITERS = {
    "csv": write_csv,
    "parquet": write_parquet,
    "mrclam": write_mrclam,
    "mcap": write_recording,
}
