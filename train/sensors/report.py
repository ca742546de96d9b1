"""Report of a fitted sensor: terminal, JSON, and TOML for scenarios."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from rendezvous_env.calibration import SensorFit, SensorLog
from rendezvous_env.calibration.blocks import CONFIDENCE
from rendezvous_env.calibration.measures import measures, unexpressed
from rendezvous_env.checks import counted
from rendezvous_env.sensors.sensing import Sensing

from ..console import Console
from ..results import write_text

FORMAT = 1
"""Version of the JSON report."""
_UNITS = {
    "noise": "rad", "bias": "rad", "observer_bias": "rad", "field_of_view": "rad",
    "view_falloff": "rad", "noise_correlation": "s", "persistence": "s", "sample_period": "s",
    "delay_time": "s", "min_range": "m",
}  # fmt: skip


def about(log: SensorLog) -> str:
    """Size of a log, and notes from reading it."""
    robots = int(log.robot_rows().sum())
    landmarks = int((log.target >= log.n_robots).sum())
    others = f" and {landmarks} of landmarks" if landmarks else ""
    lines = [
        f"{log.source}: {log.n_robots} robots, {counted(robots, 'bearing')} of robots{others}, "
        f"{log.duration:.0f} s",
        *(f"note: {note}" for note in log.notes),
    ]
    return "\n".join(lines)


def to_plain(fit: SensorFit) -> dict[str, Any]:
    """The report as plain data; numbers that are not finite are None."""
    found = fit.estimates
    sensing = Sensing(**fit.fields)
    scan = found.scan
    content = {
        "format": FORMAT,
        "source": found.log.source,
        "robots": list(found.log.names[: found.log.n_robots]),
        "notes": list(fit.notes),
        "confidence": CONFIDENCE,
        "parameters": {
            name: {"value": one.value, "low": one.low, "high": one.high, "unit": _unit(name)}
            for name, one in fit.parameters.items()
        },
        "outlier_kind": found.outliers.kind,
        "noise_of_observers": {
            found.log.names[robot]: list(one) for robot, one in found.noise.observers.items()
        },
        "bias_of_observers": {
            found.log.names[robot]: one for robot, one in found.constant.observers.items()
        },
        "measures": measures(fit),
        "autocorrelation": [found.correlation.lags, found.correlation.values],
        "delay_scan": [] if scan is None else [scan.delay, scan.spread],
        "held_out": fit.held_out,
        "not_expressed": unexpressed(fit),
        "sensing": sensing.to_plain(),
    }
    return dict(_plain(content))


def _plain(value: Any) -> Any:
    """Lists, dictionaries and Python numbers."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _unit(name: str) -> str:
    return _UNITS.get(name, "")


def show(fit: SensorFit, plain: Mapping[str, Any], console: Console) -> None:
    """Print estimates, prediction and effects outside the model."""
    table = Table("field", "value", f"{CONFIDENCE:.0%} interval", "unit", box=None)
    for name, one in fit.parameters.items():
        interval = f"{one.low:.4g} … {one.high:.4g}"
        table.add_row(name, f"{one.value:.4g}", interval, _unit(name))
    console.print(table)
    held = fit.held_out
    if held:
        console.print(
            f"held-out half: errors {held['error']:.4g} rad, predicted "
            f"{held['predicted_error']:.4g} rad, {held['within_95']:.1%} within 1.96 noise levels; "
            f"detection Brier score {held['detection_brier']:.3f}, of a constant "
            f"{held['detection_brier_constant']:.3f}",
            soft_wrap=True,
        )
    else:
        console.print("held-out half: too few bearings in a half of the log")
    for note in fit.estimates.notes:
        console.print(f"note: {note}", soft_wrap=True)
    console.print("not expressed by the model:")
    for sentence in plain["not_expressed"]:
        console.print(f"  {sentence}", soft_wrap=True)


def write_toml(path: Path, fit: SensorFit) -> None:
    """Write a scenario with the fitted sensor; intervals are comments."""
    import tomli_w

    log = fit.estimates.log
    heading = f"Sensor fitted by rendezvous sensor fit to {log.source}"
    lines = [f"# {heading}; {CONFIDENCE:.0%} intervals:".replace("\n", " ")]
    lines += [
        f"# {name} = {one.value:.4g} in {one.low:.4g} … {one.high:.4g} {_unit(name)}".rstrip()
        for name, one in fit.parameters.items()
    ]
    sensing = Sensing(**fit.fields).to_plain()
    own = {name: value for name, value in sensing.items() if name in fit.fields}
    content = tomli_w.dumps({"name": path.stem, "n_robots": log.n_robots, "sensing": own})
    write_text(path, "\n".join(lines) + "\n\n" + content)


def show_replay(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the table of a replay."""
    table = Table(
        "policy", "V falls", "V rises", "rests", "falls when moving", "margin, 5 … 95 %",
        "V of team falls", box=None,
    )  # fmt: skip
    for row in rows:
        low, middle, high = row["margin_quantiles"]
        shares = [row[key] for key in ("decreases", "increases", "rests", "decreases_when_moving")]
        table.add_row(
            row["policy"], *(f"{share:.1%}" for share in shares),
            f"{middle:.2f} ({low:.2f} … {high:.2f})", f"{row['team_decreases']:.1%}",
        )  # fmt: skip
    console.print(table)
    console.print("shares of time; margin: cosine between command and net bearing")
