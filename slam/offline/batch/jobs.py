"""Jobs of a batch: a directory for each recording, and the check if it is complete already."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.devices.device_spec import is_device_spec
from drivers.source_factory import BAG_SUFFIXES, CARMEN_SUFFIXES

from ...config import Config
from ...errors import OutputError, RecordingError
from ...io.output_dir import KEYFRAMES, MAP, PICTURE, REPORT, REVIEW, SESSION, SUMMARY, TRAJECTORY
from ...io.recordings import SIMULATION, absolute_recording
from .figures import has_figures

REPLAY = "replay:"
"""Prefix of a recording that is replayed in real time."""
FINGERPRINT = "fingerprint"
"""Key of the fingerprint in `summary.json`."""
LOGS = "logs"
"""Name of the directory of the logs, beside those of the results."""
RECORDING_SUFFIXES = (*CARMEN_SUFFIXES, ".mcap", *BAG_SUFFIXES)


@dataclass(frozen=True, slots=True)
class JobOptions:
    """Options of `wclm run` for every recording of a batch."""

    config: Config
    refine: bool = False
    review: bool = True
    picture: bool = False

    def results(self) -> tuple[str, ...]:
        """Return the names of the files in a complete directory."""
        optional = [name for name, wanted in ((REVIEW, self.review), (PICTURE, self.picture)) if wanted]
        return (TRAJECTORY, MAP, KEYFRAMES, SUMMARY, REPORT, SESSION, *optional)


@dataclass(frozen=True, slots=True)
class Job:
    """Recording to map.

    name       unique within the batch
    recording  argument of `drivers.open` that does not depend on the working directory
    directory  for the results; `log` is the file of its log
    overwrite  True to replace results of any recording
    """

    name: str
    recording: str
    directory: Path
    log: Path
    options: JobOptions
    overwrite: bool = False


def make_jobs(recordings: Sequence[str], out: Path, options: JobOptions, *, overwrite: bool = False) -> list[Job]:
    """Return a job for each recording, in the given order without duplicates.

    A directory has the recording's name; if several have the same, as much of their paths as makes them unique. Raises
    RecordingError for devices and replays, which cannot be read twice, and if two directories would have the same name.
    """
    out = out.resolve()
    specs = list(dict.fromkeys(_absolute(recording) for recording in recordings))
    return [
        Job(name, spec, out / name, out / LOGS / f"{name}.log", options, overwrite)
        for name, spec in zip(_names(specs), specs, strict=True)
    ]


def _absolute(recording: str) -> str:
    if recording.startswith(REPLAY) or is_device_spec(recording):
        raise RecordingError(recording, None, "is not a recording; a batch maps files, bags and simulations")
    return absolute_recording(recording)


def _names(specs: Sequence[str]) -> list[str]:
    """Return a unique name for each recording. Raises RecordingError if that is not possible."""
    names = [_directory_name(_stem(spec)) for spec in specs]
    ambiguous = [k for k, name in enumerate(names) if names.count(name) > 1 or name == LOGS]
    files = [k for k in ambiguous if not specs[k].startswith(SIMULATION)]
    if files:
        common = os.path.commonpath([str(Path(specs[k]).parent) for k in files])
        for k in files:
            names[k] = _directory_name(str(Path(specs[k]).relative_to(common)))
    for k, name in enumerate(names):
        if name in names[:k]:
            other = specs[names.index(name)]
            raise RecordingError(specs[k], None, f"would have the same directory, {name}, as {other}; rename one")
    return names


def _stem(spec: str) -> str:
    """Return the file name without the suffixes of recordings; a simulation unchanged."""
    if spec.startswith(SIMULATION):
        return spec
    name = Path(spec).name
    while Path(name).suffix.lower() in RECORDING_SUFFIXES:
        name = Path(name).stem
    return name


def _directory_name(text: str) -> str:
    """Return `text` as a name without characters that are special in a shell."""
    return re.sub(r"[^\w.=-]+", "-", text).strip("-.") or "recording"


def fingerprint(job: Job) -> str:
    """Return a hash of what the results depend on: recording (size and modification time of its files), settings,
    options, and version of this program.
    """
    data = {
        "recording": job.recording,
        "files": _files(job.recording),
        "config": job.options.config.model_dump(mode="json"),
        "options": [job.options.refine, job.options.review, job.options.picture],
        "version": metadata.version("wclm-slam"),
    }
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:32]


def _files(recording: str) -> list[tuple[str, int, int]]:
    """Return name, size and modification time of each file of a recording, or of a simulation's world file."""
    path = Path(recording.removeprefix(SIMULATION).partition("?")[0] if _is_simulation(recording) else recording)
    files = sorted(path.rglob("*")) if path.is_dir() and not _is_simulation(recording) else [path]
    return [
        (str(file.relative_to(path)), file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()
    ]


def _is_simulation(recording: str) -> bool:
    return recording.startswith(SIMULATION)


def read_completed_summary(job: Job) -> dict[str, Any] | None:
    """Return the summary of the results if they are complete and made by the same job; else None.

    Raises OutputError if the directory contains results of another recording.
    """
    try:
        summary = json.loads((job.directory / SUMMARY).read_text(encoding="utf-8"))
        recording, found = summary["recording_path"], summary.get(FINGERPRINT)
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return None  # not complete; the run refuses to overwrite other files
    if recording != job.recording:
        raise OutputError(
            f"{job.directory}: contains the results of {recording}; choose another --out or add --overwrite"
        )
    complete = all((job.directory / name).exists() for name in job.options.results())
    return summary if complete and found == fingerprint(job) and has_figures(summary) else None


def remove_leftovers(job: Job) -> None:
    """Remove the temporary directories of `OutputDirectory` (eight characters after the name) of killed workers."""
    temporary = re.compile(rf"\.{re.escape(job.directory.name)}-[a-z0-9_]{{8}}(-(old|new|aside))?")
    if job.directory.parent.is_dir():
        for entry in job.directory.parent.iterdir():
            if temporary.fullmatch(entry.name):
                shutil.rmtree(entry, ignore_errors=True)
