"""Open the recordings that a run was made from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drivers
from drivers.messages import Message, Odometry, Source, SourceReport
from drivers.source_factory import LidarSelection, recording_of

from ..config import Config, LidarConfig
from ..errors import ConfigurationError, MapError
from .scan_settings import as_used

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
    return all(isinstance(recording.get("path"), str) for recording in results.recordings())


def open_recording(results: RunResults, override: str | None = None) -> Source:
    """Open the recording of a run, or `override`, an argument of `drivers.open`.

    The recordings of a continued or merged session are opened as one source, and `override` takes the place of the one
    that does not exist any more. Scans are as they were used (see `scan_settings`). Raises MapError if a recording is
    missing, or `override` could be several ones, RecordingError if one cannot be opened.
    """
    recordings = results.recordings()
    missing = [one for one in recordings if not _exists(one.get("path"))]
    replaced = (missing if len(recordings) > 1 else recordings) if override is not None else []
    if override is not None and len(replaced) != 1:
        lost = "none" if not missing else str(len(missing))
        raise MapError(
            f"{results.path}: --recording FILE takes the place of one missing recording, but {lost} of its "
            f"{len(recordings)} recordings {'is' if len(missing) < 2 else 'are'} missing"
        )
    opened, configs = [], [results.settings_as_used(one) for one in recordings]
    for one, config in zip(recordings, configs, strict=True):
        opened.append(open_source(override, config) if override and one in replaced else _open(results, one, config))
    return ConcatenatedSource(opened, [float(one.get("shift", 0.0)) for one in recordings], configs)


def _exists(path: object) -> bool:
    return isinstance(path, str) and (path.startswith(SIMULATION) or Path(path).exists())


def _open(results: RunResults, recording: Mapping[str, Any], config: Config) -> Source:
    path = recording.get("path")
    if not isinstance(path, str):
        name = recording.get("name", "")
        raise MapError(f"{results.path}: does not say where its recording {name} is; name it with --recording FILE")
    if not _exists(path):
        raise MapError(f"{results.path}: its recording {path} does not exist any more; name it with --recording FILE")
    # A foreign summary must not open devices: an absolute path is never read as the specification of one.
    return open_source(absolute_recording(path), config)


class ConcatenatedSource:
    """Several sources one after the other as one source.

    shifts   seconds that are added to the stamps of each
    configs  settings of the lidars with which the scans of each were used
    """

    def __init__(self, sources: Sequence[Source], shifts: Sequence[float], configs: Sequence[Config]) -> None:
        self.name = ", ".join(source.name for source in sources)
        self.report = SourceReport()
        self._sources, self._shifts, self._configs = sources, shifts, configs

    def __len__(self) -> int:
        return sum(len(source) for source in self._sources)

    def __iter__(self) -> Iterator[Message]:
        self.report = SourceReport()
        for source, shift, config in zip(self._sources, self._shifts, self._configs, strict=True):
            for read in source:
                message = as_used(read, config)
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
