"""From what a user types to a source of messages."""

from __future__ import annotations

import math
from pathlib import Path
from urllib.parse import parse_qsl

from .devices.device_spec import is_device_spec, parse_devices
from .errors import RecordingError
from .messages import Source

READABLE = (
    "CARMEN logs (.clf, .log, .carmen, .txt, .gz), MCAP files (.mcap), "
    "bags of ROS 1 (.bag) and ROS 2 (directory or .db3), simulations (sim:WORLD), recordings played with their timing "
    "(replay:FILE), devices (rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1)"
)
CARMEN_SUFFIXES = (".clf", ".log", ".carmen", ".gz", ".txt")


def open(spec: str | Path) -> Source:
    """The source that a path, `sim:WORLD?seed=3&duration=60`, `replay:FILE?speed=2` or devices stand for.

    Raises RecordingError where the path does not exist, or nothing is known that reads it; its content is
    looked at when the source is iterated. Libraries for other formats than the one asked for are not loaded.
    Devices (see `devices.device_spec`) are started when the source is iterated, which can be done once; raises SpecError,
    a DriverError, where they are asked for wrongly.
    """
    if str(spec).startswith("sim:"):
        return _simulation(str(spec))
    if str(spec).startswith("replay:"):
        return _replay(str(spec))
    if is_device_spec(str(spec)):
        from .devices.device_source import DeviceSource

        return DeviceSource(parse_devices(str(spec)))
    path = Path(spec)
    suffix = path.suffix.lower()
    if not path.exists():
        raise RecordingError(path, None, f"no such file or directory; what can be read: {READABLE}")
    if path.is_dir():
        return _directory(path)
    if suffix in CARMEN_SUFFIXES:
        from .recordings.carmen import Carmen

        return Carmen(path)
    if suffix == ".mcap":
        from .recordings.mcap import Mcap

        return Mcap(path)
    if suffix in (".bag", ".db3"):
        from .recordings.rosbag import Bag

        return Bag(path)
    kind = f"the extension {path.suffix}" if path.suffix else "a file without an extension"
    raise RecordingError(path, None, f"nothing reads {kind}; what can be read: {READABLE}")


def _directory(path: Path) -> Source:
    """A ROS 2 bag; without metadata, because the recorder was killed, its only file."""
    from .recordings.rosbag import Bag

    if (path / "metadata.yaml").exists():
        return Bag(path)
    files = sorted(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))
    if len(files) == 1:
        return open(files[0])
    raise RecordingError(
        path, None, f"the directory is not a ROS 2 bag, it has no metadata.yaml; what can be read: {READABLE}"
    )


def _replay(spec: str) -> Source:
    from .recordings.replay import Replay

    path, _, query = spec.removeprefix("replay:").partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    try:
        speed = float(options.pop("speed", "1"))
    except ValueError as error:
        raise RecordingError(spec, None, f"not a number: {error}") from error
    if options or not 0.0 < speed < math.inf:
        raise RecordingError(spec, None, "the one option is speed, a number above 0")
    return Replay(open(path), speed)


def _simulation(spec: str) -> Source:
    from .simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation

    world, _, query = spec.removeprefix("sim:").partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    try:
        seed = int(options.pop("seed", "0"))
        duration = float(options.pop("duration")) if "duration" in options else None
        mount = [float(value) for value in options.pop("mount", "0.1,0,0").split(",")]
    except ValueError as error:
        raise RecordingError(spec, None, f"not a number: {error}") from error
    lidar, wheels = options.pop("lidar", "long"), options.pop("odometry", "good")
    if lidar not in LIDAR_MODELS:
        raise RecordingError(spec, None, f"no lidar {lidar!r}; there are {', '.join(LIDAR_MODELS)}")
    if wheels not in WHEEL_MODELS:
        raise RecordingError(spec, None, f"no odometry {wheels!r}; there are {', '.join(WHEEL_MODELS)}")
    if options:
        there = "seed, duration, lidar, odometry and mount=x,y,heading"
        raise RecordingError(spec, None, f"unknown option {', '.join(options)}; there are {there}")
    return Simulation(world or "office", seed, duration, LIDAR_MODELS[lidar], WHEEL_MODELS[wheels], mount)
