"""Whole drives: how accurate, how fast, how large. What `wclm bench slam` runs.

Recordings are judged by their relations (mean and median error of translation), simulated drives by the true path (root
mean square and median distance). Times are of the processor, in units of a reference besides: the paper's double sums,
timed all along the drive, so that a slower or busier machine makes both longer.
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
from drivers.simulation.simulator import Simulation
from features.arras_siegwart import direction_by_double_sums
from features.fit import rays_of

from ...errors import MapError
from ...events import Finished
from ...io.host import peak_memory
from ...io.tum import Trajectory
from ...pipeline import Slam
from ...warmup import warm_up
from ..metrics import read_relations, score_reference, score_relations

RECORDINGS = ("intel", "fr079", "csail")
"""Names of the benchmark's recordings: NAME/NAME.clf and NAME/NAME.relations in their folder."""
WORLDS = ("office", "room", "corridor", "columns", "square", "large_loop")
"""Simulated ones, which anybody has."""
QUICK_WORLDS, QUICK_SECONDS = ("office", "room"), 20.0
EVERY = 10
"""Scans after which the reference is timed again."""
REFERENCE_ANGLES = np.linspace(-0.6, 0.6, 230)


@dataclass(frozen=True, slots=True)
class Case:
    """One drive: a world by its name, or a recording in its folder; `seconds` of it, or all."""

    name: str
    folder: Path | None = None
    seed: int = 0
    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a drive.

    judge            what the errors are: "relations" or "true path"
    error, median    metres: the mean over relations, or the root mean square over the path, and the median
    rotation         degrees: mean, or root mean square
    scan_ms          milliseconds of processor for a scan, all else included
    by_reference     the same in units of the reference, by medians, which a busy machine changes least
    memory           MiB that the process had at most
    closures         loops closed
    """

    name: str
    seed: int
    judge: str
    scans: int
    duration: float
    way: float
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


def cases(folder: Path | None, *, quick: bool = False, seed: int = 0) -> list[Case]:
    """The recordings that `folder` holds, and simulated worlds, which anybody has; a few of these for a quick look."""
    if quick:
        return [Case(name, seed=seed, seconds=QUICK_SECONDS) for name in QUICK_WORLDS]
    present = [
        name
        for name in RECORDINGS
        if folder is not None and all((folder / name / f"{name}.{suffix}").exists() for suffix in ("clf", "relations"))
    ]
    return [Case(name, folder) for name in present] + [Case(name, seed=seed) for name in WORLDS]


def run(chosen: Sequence[Case]) -> Iterator[Result]:
    """One after the other, each in a process of its own, whose memory is the drive's."""
    context = get_context("spawn")
    for case in chosen:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(drive, case).result()


def drive(case: Case) -> Result:
    """Map one drive and judge it. Raises RecordingError, MapError."""
    return follow(case)[0]


def follow(case: Case) -> tuple[Result, Stopwatch]:
    """The same, with all the times that were taken."""
    warm_up()
    slam, stopwatch = Slam(), Stopwatch()
    truth: list[GroundTruth] = []
    stamps: list[float] = []
    scans = 0
    for message in _messages(case):
        if isinstance(message, GroundTruth):
            truth.append(message)
            continue
        stamps.append(message.stamp)
        scans += isinstance(message, Scan)
        with stopwatch:
            slam.add(message)
        if scans % EVERY == 0 and isinstance(message, Scan):
            stopwatch.time_reference()
    with stopwatch:
        finished = slam.finish()
    path = Trajectory(finished.stamps, finished.poses)
    judge, error, median, rotation = _judge(case, path, truth)
    result = Result(
        name=case.name,
        seed=case.seed,
        judge=judge,
        scans=scans,
        duration=stamps[-1] - stamps[0],
        way=float(path.travelled[-1]),
        error=error,
        median=median,
        rotation=rotation,
        scan_ms=1e3 * stopwatch.total / scans,
        by_reference=stopwatch.total / scans / stopwatch.reference,
        memory=peak_memory(),
        walls=len(finished.lines),
        corners=len(finished.corners),
        keyframes=len(finished.keyframes),
        closures=_closures(finished),
    )
    return result, stopwatch


class Stopwatch:
    """Seconds of processor of each message, in `laps`, and each time of the reference, in `references`."""

    def __init__(self) -> None:
        self.laps: list[float] = []
        self.references: list[float] = []
        self._started = 0.0
        self._line = rays_of(2.0 / np.cos(REFERENCE_ANGLES), REFERENCE_ANGLES)
        direction_by_double_sums(*self._line)

    def __enter__(self) -> None:
        self._started = time.process_time()

    def __exit__(self, *_: object) -> None:
        self.laps.append(time.process_time() - self._started)

    def time_reference(self) -> None:
        """Time the reference once more."""
        start = time.process_time()
        direction_by_double_sums(*self._line)
        self.references.append(time.process_time() - start)

    @property
    def total(self) -> float:
        """Of all messages."""
        return sum(self.laps)

    @property
    def reference(self) -> float:
        """Its median time."""
        return float(np.median(self.references))


def _messages(case: Case) -> Iterator[Message]:
    if case.folder is None:
        yield from Simulation(case.name, seed=case.seed, duration=case.seconds)
    else:
        yield from drivers.open(case.folder / case.name / f"{case.name}.clf")


def _judge(case: Case, path: Trajectory, truth: Sequence[GroundTruth]) -> tuple[str, float, float, float]:
    """By what it was judged; error and its median, metres; error of rotation, degrees."""
    if case.folder is not None:
        relations = read_relations(case.folder / case.name / f"{case.name}.relations")
        figures = score_relations(path, relations).figures()
        return "relations", figures["trans_mean"], figures["trans_median"], figures["rot_mean"]
    if not truth:
        raise MapError(f"{case.name}: there is no true path")
    true_path = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    figures = score_reference(path, true_path).figures()
    return "true path", figures["ate_rmse"], figures["ate_median"], figures["heading_rmse"]


def _closures(finished: Finished) -> int:
    loops: Any = finished.summary.get("loops", {})
    return int(loops.get("accepted", 0))


def rows(results: Sequence[Result]) -> Iterator[str]:
    """The table that a person reads."""
    yield (
        "drive        judged by   scans  time s   way m  error m  median  rotation deg  ms a scan  by reference  "
        "memory MiB  walls  corners  keyframes  closures"
    )
    for row in results:
        yield (
            f"{row.name:<12} {row.judge:<10} {row.scans:6d} {row.duration:7.0f} {row.way:7.0f} {row.error:8.4f} "
            f"{row.median:7.4f} {row.rotation:13.3f} {row.scan_ms:10.3f} {row.by_reference:13.1f} {row.memory:11.0f} "
            f"{row.walls:6d} {row.corners:8d} {row.keyframes:10d} {row.closures:9d}"
        )


def as_data(results: Sequence[Result]) -> list[dict[str, Any]]:
    """For JSON."""
    return [asdict(result) for result in results]
