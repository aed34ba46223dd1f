"""A run's directory, read back; and the recording that it was made of."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drivers
from drivers.messages import Message, Source, SourceReport

from ...config import Config, load_config
from ...errors import MapError
from ...events import MapCorners, MapWalls
from ..keyframes_csv import Keyframes, read_keyframes
from ..map_json import read_map
from ..output_dir import CONFIG, KEYFRAMES, MAP, SUMMARY, TRAJECTORY
from ..tum import Trajectory, read_tum


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """What a run left in the directory `path`. `keyframes` is None where an older version ran."""

    path: Path
    lines: MapWalls
    corners: MapCorners
    trajectory: Trajectory
    summary: dict[str, Any]
    keyframes: Keyframes | None

    def config(self) -> Config:
        """The settings of the run. Raises ConfigurationError where they cannot be read."""
        return load_config(self.path / CONFIG)


def read_session(path: Path) -> Session:
    """Read the results of a run. Raises MapError naming what is not there or cannot be read."""
    if not path.is_dir():
        raise MapError(f"{path}: is not a directory; a session is what `wclm run --out DIR` leaves")
    for name in (MAP, TRAJECTORY, SUMMARY):
        if not (path / name).is_file():
            raise MapError(f"{path}: holds no {name}; a session is what `wclm run --out DIR` leaves")
    walls_and_corners = read_map(path / MAP)
    return Session(
        path,
        walls_and_corners.lines,
        walls_and_corners.corners,
        read_tum(path / TRAJECTORY),
        _read_summary(path / SUMMARY),
        read_keyframes(path / KEYFRAMES) if (path / KEYFRAMES).is_file() else None,
    )


def open_recording(session: Session, override: str | None = None) -> Source:
    """The recording that a session was made of, or `override`, as `drivers.open` takes it; of a session that was gone
    on with, all of them, one after the other.

    Raises MapError where the summary does not tell, or what it tells of is gone; RecordingError for an `override` that
    cannot be opened.
    """
    if override is not None:
        return drivers.open(override)
    summary = session.summary
    told = summary.get("recordings") or [{"name": summary.get("recording", ""), "path": summary.get("recording_path")}]
    sources = [_opened(session, recording.get("name", ""), recording.get("path")) for recording in told]
    shifts = [float(recording.get("shift", 0.0)) for recording in told]
    return sources[0] if len(sources) == 1 and not shifts[0] else Chain(sources, shifts)


def _opened(session: Session, name: str, path: object) -> Source:
    if not isinstance(path, str):
        raise MapError(f"{session.path}: does not say where its recording {name} is; name it: --recording FILE")
    if not path.startswith("sim:") and not Path(path).exists():
        raise MapError(f"{session.path}: its recording {path} is not there any more; name it: --recording FILE")
    return drivers.open(path)


class Chain:
    """Several sources as one, with seconds (`shifts`) added to the stamps of each."""

    def __init__(self, sources: Sequence[Source], shifts: Sequence[float]) -> None:
        self.name = ", ".join(source.name for source in sources)
        self.report = SourceReport()
        self._sources, self._shifts = sources, shifts

    def __len__(self) -> int:
        return sum(len(source) for source in self._sources)

    def __iter__(self) -> Iterator[Message]:
        self.report = SourceReport()
        for source, shift in zip(self._sources, self._shifts, strict=True):
            for message in source:
                yield replace(message, stamp=message.stamp + shift) if shift else message
            told = self.report
            told.messages, told.skipped = told.messages + source.report.messages, told.skipped + source.report.skipped
            told.first = told.first or source.report.first
            for reason, count in source.report.reasons.items():
                told.reasons[reason] = told.reasons.get(reason, 0) + count


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MapError(f"{path}: is not JSON: {error}") from error
    if not isinstance(summary, dict):
        raise MapError(f"{path}: is not the summary of a run")
    return summary
