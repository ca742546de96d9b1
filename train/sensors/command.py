"""``rendezvous sensor``: fits a sensor model to a log, or replays a log through policies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from rendezvous_env.calibration import LogError, SensorLog, fit_sensor

from ..checks import Bounds, Flags, UserError, check_unused
from ..console import Console
from ..results import prepare_file, write_json
from . import figures, replay, report
from .reading import read_log

EXAMPLES = (
    "fit logs/mrclam6 --out camera.toml --figures camera.pdf",
    "replay logs/mrclam6 --policy bearing-only --figures replay.pdf",
)
FLAG_GROUPS = {
    "Flags of fit": ("out", "per_robot", "seed"),
    "Flags of replay": ("policy", "robot_model"),
}
_ENDINGS = (".pdf", ".png")


@dataclass(frozen=True)
class Config(Flags):
    """Fit a sensor model to a log of bearings with ground truth, or replay the log.

    PATH is a folder of MRCLAM files, or of tables bearings and poses (.csv or .parquet). It may
    also be a rosbag2 or MCAP recording, or WSR result files (.json).

    fit estimates the fields of Sensing with 99 % intervals. replay passes the logged bearings to
    policies, and reports the share of time in which their motion would have decreased V.
    """

    action: Positional[Literal["fit", "replay"]]
    """The action: fit a sensor model, or replay the log through policies, open-loop."""
    path: Positional[Path]
    """File or folder of the log."""
    out: Path | None = None
    """TOML file to write: a scenario with the fitted sensor."""
    per_robot: bool = False
    """Fit one noise level for each robot."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of the bootstrap."""
    policy: tuple[str, ...] = replay.POLICIES
    """Policies to replay: names, or headings and tank for random choices under these filters."""
    robot_model: Literal["single_integrator", "unicycle"] = "single_integrator"
    """Robot model that the policies command."""
    json: Path | None = None
    """JSON file to write with the report."""
    figures: Path | None = None
    """Page of figures to write, .pdf or .png."""
    clock_offset: float = 0.0
    """Seconds to add to the times of bearings, if their clock differs from that of the poses."""


def run(config: Config) -> int:
    """Fit or replay."""
    _check(config)
    console = Console()
    with console.status("reading the log …"):
        log = read_log(config.path, config.clock_offset)
    console.print(report.about(log), soft_wrap=True)
    try:
        if config.action == "fit":
            return _fit(config, log, console)
        return _replay(config, log, console)
    except LogError as error:
        raise UserError(str(error)) from None


def _check(config: Config) -> None:
    """Validate flags that depend on others, and the files to write."""
    if config.action == "fit":
        check_unused(config, dict.fromkeys(("policy", "robot_model"), "only replay uses it"))
    else:
        check_unused(config, dict.fromkeys(("out", "per_robot", "seed"), "only fit uses it"))
    if config.figures is not None and config.figures.suffix.lower() not in _ENDINGS:
        known = " or ".join(_ENDINGS)
        raise UserError(f"--figures {config.figures}: its ending must be {known}")
    if config.out is not None and config.out.suffix.lower() != ".toml":
        raise UserError(f"--out {config.out}: its ending must be .toml")
    for name in ("out", "json", "figures"):
        if (path := getattr(config, name)) is not None:
            prepare_file(path, f"--{name}")


def _fit(config: Config, log: SensorLog, console: Console) -> int:
    with console.status("fitting; intervals are by bootstrap …"):
        fit = fit_sensor(log, per_robot=config.per_robot, seed=config.seed)
        plain = report.to_plain(fit)
    report.show(fit, plain, console)
    if config.out is not None:
        report.write_toml(config.out, fit)
    if config.json is not None:
        write_json(config.json, plain)
    if config.figures is not None:
        figures.write_fit(config.figures, fit)
    _written(config, console)
    return 0


def _replay(config: Config, log: SensorLog, console: Console) -> int:
    replayed = []
    with console.status("replaying; the first use on a machine compiles …"):
        for name in config.policy:
            replayed.append(replay.replay(log, name, config.robot_model))
    rows = [replay.summary(one) for one in replayed]
    report.show_replay(rows, console)
    if config.json is not None:
        write_json(config.json, {"source": log.source, "policies": rows})
    if config.figures is not None:
        figures.write_replay(config.figures, replayed)
    _written(config, console)
    return 0


def _written(config: Config, console: Console) -> None:
    files = [str(path) for path in (config.out, config.json, config.figures) if path is not None]
    if files:
        console.print(", ".join(files), soft_wrap=True)
