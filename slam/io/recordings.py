"""Open the recordings that a run was made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import drivers
from drivers import se2
from drivers.messages import Message, Odometry, Scan, Source, SourceReport
from drivers.source_factory import LidarSelection, recording_of

from ..config import Config, LidarConfig
from ..errors import ConfigurationError, MapError

if TYPE_CHECKING:
    from .run_results import RunResults

SIMULATION = "sim:"
"""Prefix of a recording that is simulated when it is opened."""
REPLAY = "replay:"
"""Prefix of a recording that is played with its timing."""


def absolute_recording(recording: str) -> str:
    """Return the argument of `drivers.open` that opens the same recording from any working directory."""
    return recording if recording.startswith(SIMULATION) else str(Path(recording).resolve())


def recording_to_reopen(recording: str) -> str:
    """Return `absolute_recording` of what was mapped: the messages of a replay are those of its recording."""
    if recording.startswith(REPLAY):
        recording = recording.removeprefix(REPLAY).partition("?")[0]
    return absolute_recording(recording)


def open_to_map(recording: str | Path, config: Config) -> tuple[Source, str | None]:
    """Open a recording that is to be mapped; return also why it is mapped by the scans alone, as text, if it is.

    Raises RecordingError if it cannot be read or has no scans that can be used, and errors of `open_source`.
    """
    source = open_source(recording, config)
    reader = recording_of(source)
    if reader is not None:
        reader.check_scans()
    return source, None if config.odometry.source == "none" else reason_without_odometry(source)


def reason_without_odometry(source: Source) -> str | None:
    """Return why a recording is mapped by the scans alone, as text; None if it has odometry that can be used.

    Raises RecordingError if it cannot be read.
    """
    reader = recording_of(source)
    if not (any(isinstance(message, Odometry) for message in source) if reader is None else reader.has_odometry):
        return "no odometry in it"
    if reader is not None and reader.odometry_never_moves:
        return "odometry never moves in it, though the scans change"
    if reader is None:
        return None
    of_turns = reader.doubt_of_odometry_turns if reader.gyroscope_scale is None else None  # which replaces the turns
    return reader.doubt_of_odometry_unit or of_turns


def open_source(recording: str | Path, config: Config) -> Source:
    """Open a recording, an argument of `drivers.open`, with the lidars that the settings name.

    Raises RecordingError, or ConfigurationError if the settings do not say which scans are those of which lidar.
    """
    first, second = config.lidar, config.second_lidar
    if not second.topic:
        return drivers.open(recording, lidar_selection(first), odometry_topic=config.odometry.topic)
    if first.topic in ("", second.topic):
        raise ConfigurationError("second_lidar.topic: lidar.topic must name another topic, that of the first lidar")
    return drivers.open(recording, lidar_selection(first), lidar_selection(second), config.odometry.topic)


def lidar_selection(lidar: LidarConfig) -> LidarSelection:
    """Return which scans of a recording are those of a lidar with these settings, and how they are read."""
    cut = lidar.cut_height, lidar.cut_thickness
    return LidarSelection(lidar.topic, lidar.beam_order, *cut, lidar.turn_period)


def has_recording(results: RunResults) -> bool:
    """Return True if the summary of a run names the file of each of its recordings."""
    summary = results.summary
    recordings = summary.get("recordings") or [{"path": summary.get("recording_path")}]
    return all(isinstance(recording.get("path"), str) for recording in recordings)


def open_recording(results: RunResults, override: str | None = None) -> Source:
    """Open the recording of a run, or `override`, an argument of `drivers.open`.

    The recordings of a continued or merged session are opened as one source. Scans state the mounts with which they
    were mapped, those of `override` that of the first recording; see `RunResults.config_as_used`. Raises MapError if
    the summary does not name the recording or the recording does not exist any more, RecordingError if `override`
    cannot be opened.
    """
    config, summary = results.config(), results.summary
    single = {"name": summary.get("recording", ""), "path": summary.get("recording_path")}
    recordings = summary.get("recordings") or [single]
    if override is not None:
        mounts = _mounts(results, recordings[0].get("mounts") or [])
        return ConcatenatedSource([open_source(override, config)], [0.0], [mounts])
    sources = [_open(results, recording.get("name", ""), recording.get("path"), config) for recording in recordings]
    shifts = [float(recording.get("shift", 0.0)) for recording in recordings]
    return ConcatenatedSource(
        sources, shifts, [_mounts(results, recording.get("mounts") or []) for recording in recordings]
    )


def _mounts(results: RunResults, stated: Any) -> list[se2.Pose | None]:
    """Return the mounts of a recording's lidars from the summary. Raises MapError if they are invalid."""
    try:
        mounts = [None if mount is None else np.array(mount, dtype=np.float64) for mount in stated]
    except (TypeError, ValueError):
        mounts = [np.zeros(0)]
    if not all(mount is None or (mount.shape == (3,) and np.isfinite(mount).all()) for mount in mounts):
        raise MapError(f"{results.path}: mounts of a recording in its summary must have x, y and heading of each")
    return mounts


def _open(results: RunResults, name: str, path: object, config: Config) -> Source:
    if not isinstance(path, str):
        raise MapError(f"{results.path}: does not say where its recording {name} is; name it with --recording FILE")
    if not path.startswith(SIMULATION) and not Path(path).exists():
        raise MapError(f"{results.path}: its recording {path} does not exist any more; name it with --recording FILE")
    # A foreign summary must not open devices: an absolute path is never read as the specification of one.
    return open_source(absolute_recording(path), config)


class ConcatenatedSource:
    """Several sources one after the other as one source.

    shifts  seconds that are added to the stamps of each
    mounts  of the lidars of each, by number, which their scans state then; None or missing: as they are
    """

    def __init__(
        self, sources: Sequence[Source], shifts: Sequence[float], mounts: Sequence[Sequence[se2.Pose | None]]
    ) -> None:
        self.name = ", ".join(source.name for source in sources)
        self.report = SourceReport()
        self._sources, self._shifts, self._mounts = sources, shifts, mounts

    def __len__(self) -> int:
        return sum(len(source) for source in self._sources)

    def __iter__(self) -> Iterator[Message]:
        self.report = SourceReport()
        for source, shift, mounts in zip(self._sources, self._shifts, self._mounts, strict=True):
            for message in source:
                if isinstance(message, Scan) and message.lidar < len(mounts):
                    mount = mounts[message.lidar]
                    message = message if mount is None else replace(message, mount=mount)
                yield replace(message, stamp=message.stamp + shift) if shift else message
            self._add_to_report(source.report)

    def _add_to_report(self, part: SourceReport) -> None:
        report = self.report
        report.messages, report.skipped = report.messages + part.messages, report.skipped + part.skipped
        report.first = report.first or part.first
        report.interpretations += part.interpretations
        report.doubts += part.doubts
        for total, counts in ((report.reasons, part.reasons), (report.corrected, part.corrected)):
            for reason, count in counts.items():
                total[reason] = total.get(reason, 0) + count
