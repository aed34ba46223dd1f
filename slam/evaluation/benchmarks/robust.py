"""Measure how reliably drives are mapped that nobody tuned for (`wclm bench robust`), compared with raw odometry.

Where there is a reference, errors are compared with it: relations, or a trajectory after rigid alignment. Without a
reference, the agreement of the scans along the path shows how well the drive was mapped. Both are computed in the same
way for the path of raw odometry: SLAM should never be worse than that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

import drivers
from drivers.messages import Message, Odometry, Scan, Source

from ...config import Config
from ...errors import SlamError
from ...events import Finished
from ...geometry.segments import Floats
from ...io.recorded_stamps import as_recorded
from ...io.tum import Trajectory, read_tum
from ...pipeline import Slam
from ...warmup import warm_up
from ..metrics import MIN_ALIGNED_PAIRS, read_relations, score_reference, score_relations
from ..scan_agreement import BeamTable, ScanAgreement
from .robust_drives import RELATIONS, VARIANTS, WORLDS, DriveVariant, RecordedDrive
from .scenarios.log_variants import play_backwards

Prepare: TypeAlias = Callable[[Source], Config]
"""Returns the settings with what a recording's source determines itself, such as the lidar's delay."""

WORSE = 1.05
"""Factor to odometry's value from which on a result is worse. Results of one drive scatter by some per cent if anything
changes."""


class Job(NamedTuple):
    """A drive to be mapped: a recording or a variant of it, or a simulated world by name with a seed."""

    recording: RecordedDrive | None
    world: str = ""
    seed: int = 0
    variant: str = ""

    @property
    def name(self) -> str:
        """Name of the drive."""
        if self.recording is None:
            return f"{self.world} {self.seed}"
        seed = [str(self.seed)] if self.variant and VARIANTS[self.variant].drawn else []
        return " ".join([self.recording.name, *[self.variant][: bool(self.variant)], *seed])


@dataclass(frozen=True, slots=True)
class PathScore:
    """Scores of one path.

    error      metres: mean of the relations, or RMS after alignment with a trajectory; NaN without a reference
    max_error  metres, largest error
    entropy, conflict  of the scans along the path, see `ScanAgreement`
    """

    error: float
    max_error: float
    entropy: float
    conflict: float


NO_SCORE = PathScore(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class RobustResult:
    """Result of one drive.

    reference  origin of the reference: "relations", "gmapping", "truth", etc.; empty without one
    slam, odometry  scores of the path of SLAM and of raw odometry
    placed     share of the scans that have a pose
    lost       share of the scans taken while the robot was LOST
    suspects   sentences of the suspects
    cpu        processor time of the run, seconds, with reading or simulating
    failed     reason if there is no map
    """

    name: str
    reference: str = ""
    scans: int = 0
    duration: float = 0.0
    travelled: float = 0.0
    slam: PathScore = NO_SCORE
    odometry: PathScore = NO_SCORE
    placed: float = 0.0
    lost: float = 0.0
    closures: int = 0
    suspects: tuple[str, ...] = field(default=())
    cpu: float = 0.0
    failed: str = ""

    @property
    def worse(self) -> tuple[str, ...]:
        """Names of the scores that are worse than those of raw odometry by the factor WORSE."""
        names = ("error", "entropy", "conflict")
        return tuple(n for n in names if getattr(self.slam, n) > WORSE * getattr(self.odometry, n))

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return asdict(self) | {"worse_than_odometry": self.worse}


def run_jobs(jobs: Sequence[Job], prepare: Prepare, processes: int = 1) -> Iterator[RobustResult]:
    """Yield the results of the jobs in their order."""
    if processes == 1:
        yield from (run_job(job, prepare) for job in jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=warm_up) as pool:
        yield from pool.map(partial(run_job, prepare=prepare), jobs)


def run_job(job: Job, prepare: Prepare) -> RobustResult:
    """Map one drive and score it. Any failure is a result: the other drives are to be measured anyway."""
    try:
        return _run_world(job, prepare) if job.recording is None else _run_recording(job, job.recording, prepare)
    except Exception as error:
        kind = "" if isinstance(error, SlamError) else f"internal error, {type(error).__name__}: "
        return RobustResult(job.name, failed=f"{kind}{' '.join(str(error).split())}")


def _run_recording(job: Job, drive: RecordedDrive, prepare: Prepare) -> RobustResult:
    source = drivers.open(drive.path)
    config = prepare(source)
    messages, mirror = _changed(source, VARIANTS.get(job.variant, DriveVariant()), job.seed)
    if mirror is not None and config.lidar.delay:
        config = config.model_copy(update={"lidar": config.lidar.model_copy(update={"delay": -config.lidar.delay})})
    run = _Run(messages, config)
    read = {"recordings": [{"recorded_stamps": source.report.recorded_stamps}]}
    paths = [(run.finished.stamps, run.finished.poses), run.odometry_path()]
    if mirror is not None:
        paths = [(mirror - stamps[::-1], poses[::-1]) for stamps, poses in paths]
    paths = [(as_recorded(stamps, read), poses) for stamps, poses in paths]
    origin, errors = "", [(math.nan, math.nan)] * 2
    if drive.reference is not None:
        origin = drive.reference.name.removeprefix(drive.path.stem).removesuffix(drive.reference.suffix).strip(".")
        origin = origin or "relations"
        errors = [reference_errors(Trajectory.sorted(*path), drive.reference) for path in paths]
    return run.result(job.name, origin, errors)


def _changed(source: Source, variant: DriveVariant, seed: int) -> tuple[Iterable[Message], float | None]:
    """Return the messages of a variant; also the sum of the old and the new stamps if it is played backwards."""
    messages: Iterable[Message] = source
    mirror = None
    if variant.backwards:
        messages, mirror = play_backwards(source)
    return (messages if variant.log is None else variant.log(messages, np.random.default_rng(seed))), mirror


def reference_errors(path: Trajectory, reference: Path) -> tuple[float, float]:
    """Return the error of a path, and the largest one, against relations or a reference trajectory in a file, metres.

    `path` has the recording's own stamps. The error is the mean over relations, or the RMS over a trajectory.
    """
    if reference.suffix == RELATIONS:
        translation = score_relations(path, read_relations(reference)).errors.translation
        return float(translation.mean()), float(translation.max())
    return _trajectory_errors(path, read_tum(reference))


def _trajectory_errors(path: Trajectory, reference: Trajectory) -> tuple[float, float]:
    """Return the RMS and the largest position error at the reference's stamps after rigid alignment, metres."""
    at = path.at(reference.stamps)
    if at.covered.sum() < MIN_ALIGNED_PAIRS:
        return math.nan, math.nan
    stamps = reference.stamps[at.covered]
    score = score_reference(Trajectory(stamps, at.poses[at.covered]), Trajectory(stamps, reference.poses[at.covered]))
    figures = score.figures()
    return figures["ate_rmse"], figures["ate_max"]


def _run_world(job: Job, prepare: Prepare) -> RobustResult:
    world = WORLDS[job.world]
    simulation = world.simulation(job.seed)
    with world.messages(simulation) as messages:
        config = prepare(messages) if isinstance(messages, Source) else Config()
        run = _Run(messages, config)
    delay = config.lidar.delay or 0.0  # the path is on the lidar's clock, the truth on that of odometry
    errors = []
    for (stamps, poses), late in (((run.finished.stamps, run.finished.poses), delay), (run.odometry_path(), 0.0)):
        truth = Trajectory(stamps, simulation.trajectory.poses_at(stamps - late))
        errors.append(_trajectory_errors(Trajectory(stamps, poses), truth))
    return run.result(job.name, "truth", errors)


class _Run:
    """One run of SLAM, with what is needed to score its path and that of odometry."""

    def __init__(self, messages: Iterable[Message], config: Config) -> None:
        """Map all messages. Raises RecordingError or MapError."""
        slam, self._beams = Slam(config), BeamTable()
        readings: list[Odometry] = []
        started = time.process_time()
        for message in messages:
            slam.add(message)
            if isinstance(message, Scan):
                self._beams.add(message)
            elif isinstance(message, Odometry):
                readings.append(message)
        self.finished: Finished = slam.finish()
        self._cpu = time.process_time() - started
        self._odometry = np.array([r.stamp for r in readings]), np.array([r.pose for r in readings])
        state = slam.slam_state
        self._placed = len(state.trajectory.at_scans(state.mapper.keyframe_poses)[0])

    def odometry_path(self) -> tuple[Floats, Floats]:
        """Return stamps (n,) and poses (n, 3) of raw odometry."""
        return self._odometry

    def result(self, name: str, reference: str, errors: Sequence[tuple[float, float]]) -> RobustResult:
        """Return the result, given the errors of the path and of odometry."""
        summary: dict[str, Any] = self.finished.summary
        path = Trajectory.sorted(self.finished.stamps, self.finished.poses)
        odometry = Trajectory.sorted(*self._odometry)
        agreements = [self._beams.agreement(path), self._beams.agreement(odometry)]
        slam, raw = (_score(*pair) for pair in zip(errors, agreements, strict=True))
        return RobustResult(
            name=name,
            reference=reference,
            scans=self._beams.scans,
            duration=path.duration,
            travelled=path.length,
            slam=slam,
            odometry=raw,
            placed=self._placed / max(self._beams.scans, 1),
            lost=summary["health"]["lost"] / max(self._beams.scans, 1),
            closures=summary["loops"]["accepted"],
            suspects=tuple(suspect["sentence"] for suspect in summary["suspects"]),
            cpu=self._cpu,
        )


def _score(errors: tuple[float, float], agreement: ScanAgreement) -> PathScore:
    return PathScore(*errors, agreement.entropy, agreement.conflict)


def select_jobs(
    recordings: Sequence[RecordedDrive],
    conditions: Sequence[str],
    seeds: Sequence[int],
    variants: Sequence[str],
) -> list[Job]:
    """Return the jobs of the recordings and of the worlds, with all seeds, whose names are among `conditions`.

    With `variants`, the recordings are mapped in these variants instead of as they are.
    """
    chosen = [drive for drive in recordings if drive.name in conditions]
    jobs = [
        Job(drive, seed=seed, variant=variant)
        for drive in chosen
        for variant in variants or ("",)
        for seed in (seeds if variant and VARIANTS[variant].drawn else seeds[:1])
    ]
    return jobs + [Job(None, world, seed) for world in WORLDS if world in conditions for seed in seeds]
