"""What is to be done: a directory for each recording, and whether it holds just that already."""

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
from drivers.source_factory import CARMEN_SUFFIXES

from ...config import Config
from ...errors import OutputError, RecordingError
from ...io.output_dir import KEYFRAMES, MAP, PICTURE, REPORT, REVIEW, SESSION, SUMMARY, TRAJECTORY

SIMULATION, PLAYED = "sim:", "replay:"
FINGERPRINT = "fingerprint"
"""Key of the summary under which the fingerprint of what a directory was made of stands."""
LOGS = "logs"
"""Directory of the logs, beside those of the results."""
SUFFIXES = (*CARMEN_SUFFIXES, ".mcap", ".bag", ".db3")


@dataclass(frozen=True, slots=True)
class Request:
    """What is wanted of every recording, as options of `wclm run`."""

    config: Config
    refine: bool = False
    review: bool = True
    picture: bool = False

    def results(self) -> tuple[str, ...]:
        """What a complete directory holds at least."""
        asked = [name for name, wanted in ((REVIEW, self.review), (PICTURE, self.picture)) if wanted]
        return (TRAJECTORY, MAP, KEYFRAMES, SUMMARY, REPORT, SESSION, *asked)


@dataclass(frozen=True, slots=True)
class Job:
    """One recording, as `drivers.open` takes it from any directory, and where its results and its log go.

    `overwrite` asks to replace whatever results are there.
    """

    name: str
    recording: str
    directory: Path
    log: Path
    request: Request
    overwrite: bool = False


def jobs_for(recordings: Sequence[str], out: Path, request: Request, *, overwrite: bool = False) -> list[Job]:
    """A job for each recording, without those given twice, in the order given.

    A directory has the recording's name; where several have the same, as much of their paths as tells them apart.
    Raises RecordingError for what cannot be read twice, a device, and where no names tell recordings apart.
    """
    out = out.resolve()
    specs = list(dict.fromkeys(_lasting(recording) for recording in recordings))
    return [
        Job(name, spec, out / name, out / LOGS / f"{name}.log", request, overwrite)
        for name, spec in zip(_names(specs), specs, strict=True)
    ]


def _lasting(recording: str) -> str:
    """What opens the same recording from another directory, too."""
    if recording.startswith(PLAYED) or is_device_spec(recording):
        raise RecordingError(recording, None, "is no recording; a batch takes files, bags and simulations")
    return recording if recording.startswith(SIMULATION) else str(Path(recording).resolve())


def _names(specs: Sequence[str]) -> list[str]:
    names = [_plain(_stem(spec)) for spec in specs]
    alike = [k for k, name in enumerate(names) if names.count(name) > 1 or name == LOGS]
    files = [k for k in alike if not specs[k].startswith(SIMULATION)]
    if files:
        common = os.path.commonpath([str(Path(specs[k]).parent) for k in files])
        for k in files:
            names[k] = _plain(str(Path(specs[k]).relative_to(common)))
    for k, name in enumerate(names):
        if name in names[:k]:
            other = specs[names.index(name)]
            raise RecordingError(specs[k], None, f"would have the same directory, {name}, as {other}; rename one")
    return names


def _stem(spec: str) -> str:
    if spec.startswith(SIMULATION):
        return spec
    name = Path(spec).name
    while Path(name).suffix.lower() in SUFFIXES:
        name = Path(name).stem
    return name


def _plain(text: str) -> str:
    """`text` as the name of a directory that no shell minds."""
    return re.sub(r"[^\w.=-]+", "-", text).strip("-.") or "recording"


def fingerprint(job: Job) -> str:
    """What the results depend on in one number: the recording's files (by size and time of change), what is wanted, and
    the version of this program.
    """
    told = {
        "recording": job.recording,
        "files": _files(job.recording),
        "config": job.request.config.model_dump(mode="json"),
        "options": [job.request.refine, job.request.review, job.request.picture],
        "version": metadata.version("wclm-slam"),
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def _files(recording: str) -> list[tuple[str, int, int]]:
    """Name, size and time of change of each file; of a simulation, of its world if that is one."""
    path = Path(recording.removeprefix(SIMULATION).partition("?")[0] if _is_simulation(recording) else recording)
    files = sorted(path.rglob("*")) if path.is_dir() and not _is_simulation(recording) else [path]
    return [
        (str(file.relative_to(path)), file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()
    ]


def _is_simulation(recording: str) -> bool:
    return recording.startswith(SIMULATION)


def completed(job: Job) -> dict[str, Any] | None:
    """The summary of the results if they are there, complete, and of just this job; else None.

    Raises OutputError where results of another recording are in the way.
    """
    try:
        summary = json.loads((job.directory / SUMMARY).read_text(encoding="utf-8"))
        made_of, found = summary["recording_path"], summary.get(FINGERPRINT)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError):
        return None  # whatever it is, it is not complete; the run refuses what is not its own
    if made_of != job.recording:
        raise OutputError(f"{job.directory}: holds the results of {made_of}; choose another --out or add --overwrite")
    whole = all((job.directory / name).exists() for name in job.request.results())
    return summary if whole and found == fingerprint(job) else None


def remove_leftovers(job: Job) -> None:
    """Remove the unfinished directories that killed workers left, and only those: what `OutputDirectory` makes has
    eight characters after the name.
    """
    ours = re.compile(rf"\.{re.escape(job.directory.name)}-[a-z0-9_]{{8}}(-old)?")
    if job.directory.parent.is_dir():
        for entry in job.directory.parent.iterdir():
            if ours.fullmatch(entry.name):
                shutil.rmtree(entry, ignore_errors=True)
