"""Measure accuracy, time and memory of SLAM on whole recordings and simulated drives (`wclm bench slam`).

Recordings are scored by their relations (mean and median translation error), simulated drives by ground truth (RMS and
median position error). Times are processor times, also relative to a reference computation timed during the run
(`reference_work`), so that a slower or busier machine affects both.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import drivers
from drivers.messages import GroundTruth, Message, Scan
from drivers.simulation import Simulation

from ...errors import MapError
from ...events import Finished
from ...io.host import peak_memory
from ...io.tum import Trajectory
from ...loop_closure.loop_status import LoopStatus
from ...pipeline import Slam
from ...warmup import warm_up
from ..metrics import read_relations, score_reference, score_relations
from .reference_work import ReferenceWork

RECORDINGS = ("intel", "fr079", "csail")
"""Names of the benchmark recordings: NAME/NAME.clf and NAME/NAME.relations in the datasets folder."""
WORLDS = ("office", "room", "corridor", "columns", "square", "large_loop")
"""Built-in simulated worlds."""
QUICK_WORLDS, QUICK_SECONDS = ("office", "room"), 20.0
REFERENCE_INTERVAL = 10
"""Scans between timings of the reference computation."""


@dataclass(frozen=True, slots=True)
class RunSpec:
    """One run: a simulated world by name, or a recording in a datasets `folder`; its first `seconds`, or all of it."""

    name: str
    folder: Path | None = None
    seed: int = 0
    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class RunFigures:
    """Figures of one run.

    scored_by        kind of the errors: "relations" or "true path"
    travelled        distance, metres
    error, median    metres: mean over the relations, or RMS over the path; and the median
    rotation         degrees: mean, or RMS
    scan_ms          processor time per scan, milliseconds, including everything else
    by_reference     the same relative to the mean time of the reference: a busy machine slows down both alike
    memory           peak of the process, MiB
    closures         accepted loops
    """

    name: str
    seed: int
    scored_by: str
    scans: int
    duration: float
    travelled: float
    error: float
    median: float
    rotation: float
    scan_ms: float
    by_reference: float
    memory: float
    walls: int
    corners: int
    keyframes: int
    closures: int


def list_runs(folder: Path | None, *, quick: bool = False, seed: int = 0) -> list[RunSpec]:
    """Return the recordings present in `folder` and all simulated worlds; if `quick`, short runs of a few worlds."""
    if quick:
        return [RunSpec(name, seed=seed, seconds=QUICK_SECONDS) for name in QUICK_WORLDS]
    present = [
        name
        for name in RECORDINGS
        if folder is not None and all((folder / name / f"{name}.{suffix}").exists() for suffix in ("clf", "relations"))
    ]
    return [RunSpec(name, folder) for name in present] + [RunSpec(name, seed=seed) for name in WORLDS]


def run_all(specs: Sequence[RunSpec]) -> Iterator[RunFigures]:
    """Yield the results of the runs, one after the other, each in a separate process to measure its memory."""
    context = get_context("spawn")
    for spec in specs:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(run_once, spec).result()


def run_once(spec: RunSpec) -> RunFigures:
    """Run SLAM once and score it. Raises RecordingError, MapError."""
    warm_up()
    slam, timer = Slam(), MessageTimer()
    truth: list[GroundTruth] = []
    stamps: list[float] = []
    scans = 0
    for message in _messages(spec):
        if isinstance(message, GroundTruth):
            truth.append(message)
            continue
        stamps.append(message.stamp)
        scans += isinstance(message, Scan)
        with timer:
            slam.add(message)
        if scans % REFERENCE_INTERVAL == 0 and isinstance(message, Scan):
            timer.time_reference()
    with timer:
        finished = slam.finish()
    path = Trajectory(finished.stamps, finished.poses)
    scored_by, error, median, rotation = _score(spec, path, truth)
    return RunFigures(
        name=spec.name,
        seed=spec.seed,
        scored_by=scored_by,
        scans=scans,
        duration=stamps[-1] - stamps[0],
        travelled=path.length,
        error=error,
        median=median,
        rotation=rotation,
        scan_ms=1e3 * timer.total / scans,
        by_reference=timer.total / scans / timer.reference,
        memory=peak_memory(),
        walls=len(finished.walls),
        corners=len(finished.corners),
        keyframes=len(finished.keyframes),
        closures=_closures(finished),
    )


class MessageTimer:
    """Processor times: `total` of all messages, and those of the reference computation between them; seconds."""

    def __init__(self) -> None:
        self.total = 0.0
        self._reference_times: list[float] = []
        self._started = 0.0
        self._reference = ReferenceWork()

    def __enter__(self) -> None:
        self._started = time.process_time()

    def __exit__(self, *_: object) -> None:
        self.total += time.process_time() - self._started

    def time_reference(self) -> None:
        """Time the reference computation once."""
        self._reference_times.append(self._reference.time_once())

    @property
    def reference(self) -> float:
        """Mean time of the reference computation, seconds."""
        return float(np.mean(self._reference_times))


def _messages(spec: RunSpec) -> Iterator[Message]:
    if spec.folder is None:
        yield from Simulation(spec.name, seed=spec.seed, duration=spec.seconds)
    else:
        yield from drivers.open(spec.folder / spec.name / f"{spec.name}.clf")


def _score(spec: RunSpec, path: Trajectory, truth: Sequence[GroundTruth]) -> tuple[str, float, float, float]:
    """Return the kind of the errors, error and median (metres), and rotation error (degrees)."""
    if spec.folder is not None:
        relations = read_relations(spec.folder / spec.name / f"{spec.name}.relations")
        figures = score_relations(path, relations).figures()
        return "relations", figures["trans_mean"], figures["trans_median"], figures["rot_mean"]
    if not truth:
        raise MapError(f"{spec.name}: there is no ground truth")
    true_path = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    figures = score_reference(path, true_path).figures()
    return "true path", figures["ate_rmse"], figures["ate_median"], figures["heading_rmse"]


def _closures(finished: Finished) -> int:
    loops: Any = finished.summary.get("loops", {})
    return int(loops.get(LoopStatus.ACCEPTED, 0))


def result_table(results: Sequence[RunFigures]) -> Iterator[str]:
    """Yield the lines of a table."""
    yield (
        "run          scored by   scans  time s  dist m  error m  median  rotation deg  ms a scan  by reference  "
        "memory MiB  walls  corners  keyframes  closures"
    )
    for row in results:
        yield (
            f"{row.name:<12} {row.scored_by:<10} {row.scans:6d} {row.duration:7.0f} {row.travelled:7.0f} "
            f"{row.error:8.4f} {row.median:7.4f} {row.rotation:13.3f} {row.scan_ms:10.3f} {row.by_reference:13.2f} "
            f"{row.memory:11.0f} {row.walls:6d} {row.corners:8d} {row.keyframes:10d} {row.closures:9d}"
        )


def results_as_data(results: Sequence[RunFigures]) -> list[dict[str, Any]]:
    """Return the results as plain data for JSON."""
    return [asdict(result) for result in results]
