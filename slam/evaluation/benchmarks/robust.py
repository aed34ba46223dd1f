"""Measure how reliably drives are mapped that nobody tuned for (`wclm bench robust`), compared with raw odometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple, TypeAlias

import numpy as np

import drivers
from drivers.messages import Message, Source
from drivers.simulation import Simulation

from ...config import Config
from ...errors import SlamError
from ...io.recorded_stamps import as_recorded
from ...io.tum import Trajectory
from ...pipeline import Slam
from ...warmup import warm_up
from .robust_drives import VARIANTS, WORLDS, DriveVariant, RecordedDrive, SimulatedWorld
from .robust_scores import RobustResult, ScoredRun, reference_errors, trajectory_errors, trajectory_errors_in_map
from .scenarios.later_drives import later_drive
from .scenarios.log_variants import play_backwards

Prepare: TypeAlias = Callable[[Source], Config]
"""Returns the settings with what a recording's source determines itself, such as the lidar's delay."""


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
    run = ScoredRun(Slam(config), messages)
    read = {"recordings": [{"recorded_stamps": source.report.recorded_stamps}]}
    paths = [run.path, run.odometry_path]
    if mirror is not None:
        paths = [(mirror - stamps[::-1], poses[::-1]) for stamps, poses in paths]
    paths = [(as_recorded(stamps, read), poses) for stamps, poses in paths]
    errors = [(math.nan, math.nan)] * 2
    if drive.reference is not None:
        errors = [
            reference_errors(Trajectory.sorted(*path), drive.reference) if len(path[0]) else (math.nan, math.nan)
            for path in paths
        ]
    return run.result(job.name, drive.origin, errors)


def _changed(source: Source, variant: DriveVariant, seed: int) -> tuple[Iterable[Message], float | None]:
    """Return the messages of a variant; also the sum of the old and the new stamps if it is played backwards."""
    messages: Iterable[Message] = source
    mirror = None
    if variant.backwards:
        messages, mirror = play_backwards(source)
    return (messages if variant.log is None else variant.log(messages, np.random.default_rng(seed))), mirror


def _run_world(job: Job, prepare: Prepare) -> RobustResult:
    world = WORLDS[job.world]
    simulation = world.simulation(job.seed)
    if world.later is not None:
        return _run_later(job.name, simulation, world)
    with world.messages(simulation) as messages:
        config = prepare(messages) if isinstance(messages, Source) else Config()
        run = ScoredRun(Slam(config), messages)
    delay = config.lidar.delay or 0.0  # the path is on the lidar's clock, the truth on that of odometry
    errors = []
    for (stamps, poses), late in ((run.path, delay), (run.odometry_path, 0.0)):
        truth = Trajectory(stamps, simulation.trajectory.poses_at(stamps - late))
        errors.append(trajectory_errors(Trajectory(stamps, poses), truth))
    return run.result(job.name, "truth", errors)


def _run_later(name: str, simulation: Simulation, world: SimulatedWorld) -> RobustResult:
    """Map a drive, and score another one in its map. Errors are those in the frame of the map."""
    slam = Slam()
    earlier = ScoredRun(slam, simulation)
    stamps, poses = earlier.path
    mapped = Trajectory(stamps, poses), Trajectory(stamps, simulation.trajectory.poses_at(stamps))
    later = later_drive(simulation, refurnished=world.refurnished)
    session = slam.session
    run = ScoredRun(Slam(resumed=session, frozen=world.later == "localize"), later, session.latest)
    stamps, poses = run.path
    path = Trajectory(stamps, poses), Trajectory(stamps, later.true_poses(stamps))
    stamps, poses = run.odometry_path
    odometry = Trajectory(stamps, poses), Trajectory(stamps, later.true_poses(stamps))
    return run.result(name, "truth", [trajectory_errors_in_map(*path, *mapped), trajectory_errors(*odometry)])


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
