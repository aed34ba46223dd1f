"""Measure false and missed loop closures and relocalisations in worlds whose places look alike.

The lidar has a short range and the wheels have large errors, so that the robot returns to known places with more drift
than data association tolerates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation

from ...errors import MapError
from ...loop_closure.loop_status import LoopStatus
from ...pipeline import Slam
from .loop_scoring import LoopScorer, ScoredDecision

WORLDS = (
    "large_loop",
    "equal_doors",
    "equal_offices",
    "square",
    "symmetric_room",
    "bare_corridor",
    "mirrored_wing",
    "moved_furniture",
)
MAX_ERROR, MAX_ANGLE_ERROR = 0.5, np.radians(10.0)  # metres, radians; a closure with a larger error is wrong
MISPLACED = 1.0  # metres; a relocalisation with a larger error, or a run that ends with one, is in a wrong place
MIN_NEEDED_DRIFT = 0.5  # metres of drift at a revisited place: more than data association tolerates
MAX_JOINED_ERROR = 0.3  # metres between two visits of one place that are joined in the final map
MIN_JOINED_SHARE = 0.9  # of all revisits


@dataclass(frozen=True, slots=True)
class LookalikeRun:
    """Result of one simulated drive through a world.

    decisions              all loop decisions
    drift                  largest error of a keyframe at a revisited place, relative to the earlier visit, metres
    joined                 True if the final map has joined the visits of each place
    doubled                number of walls that the final map contains more than once
    ate                    RMS position error of the keyframes after alignment, metres
    relocalisation_errors  of each relocalisation relative to the nearest keyframe, metres
    last_error             position error of the last keyframe relative to the first, metres
    failed                 reason if there is no final map
    """

    world: str
    seed: int
    decisions: tuple[ScoredDecision, ...]
    drift: float
    joined: bool
    doubled: int
    ate: float
    relocalisation_errors: tuple[float, ...] = ()
    last_error: float = 0.0
    failed: str = ""

    @property
    def needed(self) -> bool:
        """True if a consistent map required a loop closure."""
        return self.drift > MIN_NEEDED_DRIFT

    @property
    def accepted(self) -> list[ScoredDecision]:
        """Accepted loops."""
        return [decided for decided in self.decisions if decided.status == LoopStatus.ACCEPTED]

    @property
    def wrong(self) -> list[ScoredDecision]:
        """Accepted loops to a wrong place."""
        return [
            decided for decided in self.accepted if decided.error > MAX_ERROR or decided.angle_error > MAX_ANGLE_ERROR
        ]

    @property
    def misplaced(self) -> int:
        """Number of relocalisations in a wrong place."""
        return sum(error > MISPLACED for error in self.relocalisation_errors)


@dataclass(frozen=True, slots=True)
class WorldStatistics:
    """Counts over all runs in one world; drift and ate are medians in metres.

    needed, found  runs whose consistent map required a loop closure, and those of them with a consistent map
    relocated      relocalisations, `misplaced` of them in a wrong place
    ended_off      runs that ended more than MISPLACED from the true position, relative to their start: because of a
                   wrong closure or relocalisation, or of drift that no loop corrected
    failed         runs without a final map
    reasons        counts of the reasons of rejection, without the figures in them
    """

    world: str
    drives: int
    proposed: int
    rejected: int
    pending: int
    accepted: int
    wrong: int
    drift: float
    needed: int
    found: int
    doubled: int
    ate: float
    relocated: int
    misplaced: int
    ended_off: int
    failed: int
    reasons: dict[str, int]


def run_worlds(
    worlds: Sequence[str] = WORLDS, seeds: Sequence[int] = range(20), processes: int = 1
) -> Iterator[LookalikeRun]:
    """Simulate each world once with each seed, and yield the runs in that order."""
    jobs = [(world, seed) for world in worlds for seed in seeds]
    if processes == 1:
        yield from (run_world(*job) for job in jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_world, *zip(*jobs, strict=True))


def run_world(world: str, seed: int) -> LookalikeRun:
    """Run SLAM in a simulated world and score it against ground truth."""
    simulation = Simulation(world, seed=seed, lidar=LIDAR_MODELS["short"], wheels=WHEEL_MODELS["bad"])
    scorer = LoopScorer(simulation)
    slam = Slam(sinks=[scorer])
    try:
        for message in simulation:
            slam.add(message)
        finished = slam.finish()
    except MapError as error:
        errors = tuple(scorer.relocalisation_errors)
        return LookalikeRun(
            world, seed, tuple(scorer.decisions), scorer.drift, False, 0, np.nan, errors, failed=str(error)
        )
    return LookalikeRun(
        world,
        seed,
        tuple(scorer.decisions),
        drift=scorer.drift,
        joined=scorer.joined_share(finished, MAX_JOINED_ERROR) >= MIN_JOINED_SHARE,
        doubled=scorer.doubled_walls(finished.walls),
        ate=scorer.ate(finished),
        relocalisation_errors=tuple(scorer.relocalisation_errors),
        last_error=scorer.last_error(finished),
    )


def summarise_worlds(runs: Sequence[LookalikeRun]) -> list[WorldStatistics]:
    """Return the statistics of each world, in the order of first appearance."""
    return [_statistics(world, [r for r in runs if r.world == world]) for world in dict.fromkeys(r.world for r in runs)]


def _statistics(world: str, runs: list[LookalikeRun]) -> WorldStatistics:
    decided = [decided for run in runs for decided in run.decisions]
    statuses = Counter(d.status for d in decided)
    needed = [run for run in runs if run.needed]
    return WorldStatistics(
        world=world,
        drives=len(runs),
        proposed=len(decided),
        rejected=statuses[LoopStatus.REJECTED],
        pending=statuses[LoopStatus.PENDING],
        accepted=statuses[LoopStatus.ACCEPTED],
        wrong=sum(len(run.wrong) for run in runs),
        drift=float(np.median([run.drift for run in runs])),
        needed=len(needed),
        found=sum(run.joined for run in needed),
        doubled=sum(run.doubled for run in runs),
        ate=float(np.median([run.ate for run in runs if not run.failed] or [np.nan])),
        relocated=sum(len(run.relocalisation_errors) for run in runs),
        misplaced=sum(run.misplaced for run in runs),
        ended_off=sum(run.last_error > MISPLACED for run in runs),
        failed=sum(bool(run.failed) for run in runs),
        reasons=dict(
            Counter(_without_figures(d.reason) for d in decided if d.status == LoopStatus.REJECTED).most_common()
        ),
    )


def _without_figures(reason: str) -> str:
    """Return a reason without the figures in it."""
    return " ".join(word for word in reason.split() if not any(letter.isdigit() for letter in word) and word != "<")
