"""Open a source of messages from a path or a specification string."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from .arguments import path_of
from .devices.device_spec import is_device_spec, parse_devices
from .errors import RecordingError
from .messages import Source
from .recordings.reader import RecordingReader
from .recordings.replay import Replay
from .recordings.two_lidars import TwoLidarRecording

if TYPE_CHECKING:
    from .timing.beam_times import BeamOrder

SUPPORTED = (
    "CARMEN logs (.clf, .log, .carmen, .txt, .gz, .bz2), MCAP files (.mcap), "
    "ROS 1 bags (.bag, .bag.active), ROS 2 bags (directory or .db3), simulations (sim:WORLD), "
    "recordings replayed in real time (replay:FILE), devices (rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1)"
)
CARMEN_SUFFIXES = (".clf", ".log", ".carmen", ".gz", ".bz2", ".txt")
BAG_SUFFIXES = (".bag", ".active", ".db3")
"""Of ROS bags; that of a ROS 1 bag is `.bag.active` until its recorder closes it."""
RECORDING_SUFFIXES = (".clf", ".carmen", ".mcap", *BAG_SUFFIXES)
"""Suffixes of files that contain nothing but recordings."""
METADATA = "metadata.yaml"
"""File of a ROS 2 bag that names the others."""
REINDEX = ", which `ros2 bag reindex` writes"
"""What helps if the recorder of a bag in several files was killed."""
MAX_NAMED = 5
"""Recordings of a directory that an error names."""


@dataclass(frozen=True, slots=True)
class LidarSelection:
    """Lidar of a recording.

    topic       of its scans or point clouds in a ROS recording; empty: the best one
    beam_order  order in which its beams were measured: as stated (forward), reversed, or with auto reversed if its
                scans fit together significantly better then
    cut_height, cut_thickness  layer of point clouds that is a scan, metres; see `HeightCut`
    turn_period seconds in which it turns once, 0 if it measures all beams at once; None: as stated, or with auto as its
                scans show
    """

    topic: str = ""
    beam_order: BeamOrder = "auto"
    cut_height: float | None = None
    cut_thickness: float = 0.2
    turn_period: float | None = None


def open(
    spec: str | Path,
    lidar: LidarSelection | BeamOrder = "auto",
    second_lidar: LidarSelection | None = None,
    odometry_topic: str = "",
) -> Source:
    """Return the source that a path, `sim:WORLD?seed=3&duration=60`, `replay:FILE?speed=2` or a device list specifies.

    lidar         which scans of a recording are read, and how; or only the order of their beams. Simulations and
                  devices need none
    second_lidar  the same for the scans of a second lidar, whose topic must be named; None: there is none
    odometry_topic  of a ROS recording; empty: the one with the most messages

    Raises RecordingError if the path does not exist, its format is not supported, or topics are named that it cannot
    have; the content is read when the source is iterated. Only the libraries of the format in question are imported.
    Devices (see `devices.device_spec`) are started when the source is iterated, which is possible once; raises
    SpecError, a DriverError, if their specification is invalid.
    """
    first = lidar if isinstance(lidar, LidarSelection) else LidarSelection(beam_order=lidar)
    source = _open(spec)
    _select(spec, recording_of(source), first)
    _select_odometry(spec, recording_of(source), odometry_topic)
    if second_lidar is None:
        return source
    second = recording_of(_open(spec))
    _select(spec, second, second_lidar)
    reader = recording_of(source)
    assert reader is not None
    assert second is not None
    both = TwoLidarRecording(reader, second)
    return Replay(both, source.speed) if isinstance(source, Replay) else both


def _select(spec: str | Path, reader: RecordingReader | None, lidar: LidarSelection) -> None:
    """Set which scans a reader reads, and how; raises RecordingError if a topic is named that it cannot have."""
    from .timing.beam_times import set_beam_times

    if reader is not None:
        reader.set_beam_times = set_beam_times(lidar.beam_order, lidar.turn_period)
        reader.select_scans(lidar.topic, lidar.cut_height, lidar.cut_thickness)
    elif lidar.topic:
        raise RecordingError(spec, None, f"has no topics, so none is named {lidar.topic}")


def _select_odometry(spec: str | Path, reader: RecordingReader | None, topic: str) -> None:
    """Set which odometry a reader reads, if a topic is named; raises RecordingError if it cannot have any."""
    if topic and reader is not None:
        reader.select_odometry(topic)
    elif topic:
        raise RecordingError(spec, None, f"has no topics, so none is named {topic}")


def recording_of(source: Source) -> RecordingReader | None:
    """Return the reader of a recording, also if it is replayed; None for a simulation or devices.

    With two lidars it is the reader of the first one.
    """
    source = source.source if isinstance(source, Replay) else source
    source = source.first if isinstance(source, TwoLidarRecording) else source
    return source if isinstance(source, RecordingReader) else None


def second_recording_of(source: Source) -> RecordingReader | None:
    """Return the reader of a second lidar's scans; None without a second lidar."""
    source = source.source if isinstance(source, Replay) else source
    return source.second if isinstance(source, TwoLidarRecording) else None


def _open(spec: str | Path) -> Source:
    if str(spec).startswith("sim:"):
        return _simulation(str(spec))
    if str(spec).startswith("replay:"):
        return _replay(str(spec))
    if is_device_spec(str(spec)):
        from .devices.device_source import DeviceSource

        return DeviceSource(parse_devices(str(spec)))
    path = path_of("spec", spec)
    suffix = path.suffix.lower()
    if not path.exists():
        raise RecordingError(path, None, "no such file or directory")
    if path.is_dir():
        return _directory(path)
    if path.name == METADATA:
        return _directory(path.parent)
    if suffix in (".mcap", *BAG_SUFFIXES) and not path.stat().st_size:
        raise RecordingError(path, None, "is empty")
    if suffix == ".zstd":
        raise RecordingError(path, None, "is compressed as a whole; name the directory of its bag, or `zstd -d` it")
    if suffix in CARMEN_SUFFIXES:
        from .recordings.carmen import CarmenReader

        return CarmenReader(path)
    if suffix == ".mcap":
        from .recordings.mcap import McapReader

        return McapReader(path)
    if suffix in BAG_SUFFIXES:
        from .recordings.rosbag import BagReader

        return BagReader(path)
    kind = f"the extension {path.suffix}" if path.suffix else "a file without extension"
    raise RecordingError(path, None, f"{kind} is not supported; supported: {SUPPORTED}")


def _directory(path: Path) -> Source:
    """Return the reader of a ROS 2 bag; if it has no metadata, because the recorder was killed, of its only file."""
    from .recordings.rosbag import BagReader

    if (path / METADATA).exists():
        return BagReader(path)
    files = sorted(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))
    if len(files) == 1:
        return _open(files[0])
    reason = f"the directory is not a ROS 2 bag: it has no {METADATA}{REINDEX if files else ''}; {_contents(path)}"
    raise RecordingError(path, None, reason)


def _contents(path: Path) -> str:
    """Return the recordings in a directory, of which one can be read, or what is supported, as text."""
    names = sorted(file.name for file in path.iterdir() if file.suffix in RECORDING_SUFFIXES)
    if not names:
        return f"supported: {SUPPORTED}"
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return f"name one of the recordings in it: {', '.join(names[:MAX_NAMED])}{more}"


def _replay(spec: str) -> Source:
    path, _, query = spec.removeprefix("replay:").partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    speed = _number(spec, "speed", options.pop("speed", "1"))
    if options or not 0.0 < speed < math.inf:
        raise RecordingError(spec, None, "the only option is speed, a positive number")
    return Replay(_open(path), speed)


def _simulation(spec: str) -> Source:
    from .simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation

    world, _, query = spec.removeprefix("sim:").partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    seed = _whole_number(spec, "seed", options.pop("seed", "0"))
    duration = _number(spec, "duration", options.pop("duration")) if "duration" in options else None
    mount = _numbers(spec, "mount", options.pop("mount", "0.1,0,0"))
    second_mount = _numbers(spec, "second_mount", options.pop("second_mount")) if "second_mount" in options else None
    lidar, wheels = options.pop("lidar", "long"), options.pop("odometry", "good")
    if lidar not in LIDAR_MODELS:
        raise RecordingError(spec, None, f"no lidar {lidar!r}; choose one of {', '.join(LIDAR_MODELS)}")
    if wheels not in WHEEL_MODELS:
        raise RecordingError(spec, None, f"no odometry {wheels!r}; choose one of {', '.join(WHEEL_MODELS)}")
    if options:
        known = "seed, duration, lidar, odometry, mount=x,y,heading and second_mount=x,y,heading"
        raise RecordingError(spec, None, f"unknown option {', '.join(options)}; known are {known}")
    return Simulation(world or "office", seed, duration, LIDAR_MODELS[lidar], WHEEL_MODELS[wheels], mount, second_mount)


def _numbers(spec: str, option: str, text: str) -> list[float]:
    """Return the numbers that an option of a source lists, between commas. Raises RecordingError."""
    return [_number(spec, option, part) for part in text.split(",")]


def _number(spec: str, option: str, text: str) -> float:
    """Return the value of an option of a source. Raises RecordingError if it is not a number."""
    try:
        return float(text)
    except ValueError as error:
        raise RecordingError(spec, None, f"{option} must be a number, not {text!r}") from error


def _whole_number(spec: str, option: str, text: str) -> int:
    """Return the value of an option of a source. Raises RecordingError if it is not a whole number."""
    try:
        return int(text)
    except ValueError as error:
        raise RecordingError(spec, None, f"{option} must be a whole number, not {text!r}") from error
