"""Measure false and missed loop closures and relocalisations in worlds whose places look alike.

The lidar has a short range and the wheels have large errors, so that the robot returns to known places with more drift
than data association tolerates.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from drivers.messages import Message
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, Simulation, load_world

from ...errors import MapError
from ...loop_closure.loop_status import LoopStatus
from ...pipeline import Slam
from ..rates import upper_limit
from .loop_scoring import LoopScorer, ScoredDecision
from .scenarios.log_variants import chain, crop, scatter_no_returns, thin
from .scenarios.recorded import recorded
from .scenarios.world_variants import mirror

WORLDS = {
    "large_loop": math.inf,
    "equal_doors": 3.0,
    "equal_offices": 4.5,
    "square": 4.05,
    "symmetric_room": 10.0,
    "bare_corridor": 0.0,
    "mirrored_wing": math.inf,
    "moved_furniture": 1.03,
}
"""Worlds, and the distance in metres between a place and the nearest one that looks the same, from the plan: the
spacing of equal doors and rooms, the length of the symmetric room, the displacement of the furniture; infinite if no
place can be moved onto another, zero if nothing shows the position."""
MAX_ERROR, MAX_ANGLE_ERROR = 0.5, np.radians(10.0)  # metres, radians; with a larger error a closure is wrong
MISPLACED = 1.0  # metres; a relocalisation with a larger error, or a run that ends with one, is in a wrong place
MIN_NEEDED_DRIFT = 0.5  # metres of drift at a revisited place: more than data association tolerates
MAX_JOINED_ERROR = 0.3  # metres between two visits of one place that are joined in the final map
MIN_JOINED_SHARE = 0.9  # of all revisits
HALF_CIRCLE = LidarModel(beams=360, range_max=8.0, sigma_range=0.02)  # of which 181 beams remain
STANDARD = "standard"
VARIANTS = {
    STANDARD: "as it is",
    "mirrored": "the world mirrored",
    "half-circle": "181 beams over 180 degrees, 8 m of range and 2 cm of noise",
    "sparse": "a recording with one scan for each 1 m or 30 degrees, in which readings for a no-return scatter",
}
"""Variants of a drive: descriptions by name."""


@dataclass(frozen=True, slots=True)
class LookalikeRun:
    """Result of one simulated drive through a world.

    variant                one of VARIANTS
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
    variant: str = STANDARD

    @property
    def condition(self) -> str:
        """Name of world and variant."""
        return self.world if self.variant == STANDARD else f"{self.world}, {self.variant}"

    @property
    def unambiguous(self) -> bool:
        """True if a loop closure was required and the right place is the nearest one that looks like it.

        It is if the robot has drifted by less than half the distance between places that look the same.
        """
        return self.needed and self.drift < WORLDS[self.world] / 2

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
        """Accepted loops to a wrong place, and those at which the final map is wrong."""
        return [
            decided for decided in self.accepted if decided.error > MAX_ERROR or decided.angle_error > MAX_ANGLE_ERROR
        ]

    @property
    def misplaced(self) -> int:
        """Number of relocalisations in a wrong place."""
        return sum(error > MISPLACED for error in self.relocalisation_errors)


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """Counts and rates over several runs; drift and ate are medians in metres.

    condition     world and variant, or "total"
    wrong         wrong closures, or accepted ones at which the final map is wrong; `wrong_drives` runs with one or more
    wrong_rate    share of runs with a wrong closure
    wrong_limit   upper 95 % confidence limit of the probability of a wrong closure in a drive
    wrong_of_accepted_limit  the same of the probability that an accepted closure is wrong
    needed, found  runs whose consistent map required a loop closure, and those of them with a consistent map
    unambiguous, unambiguous_found  the same for runs in which the right place was the nearest that looks like it
    joined_share  unambiguous_found relative to unambiguous; NaN if there are none
    relocated     relocalisations, `misplaced` of them in a wrong place
    ended_off     runs that ended more than MISPLACED from the true position, relative to their start: because of a
                  wrong closure or relocalisation, or of drift that no loop corrected
    failed        runs without a final map
    reasons       counts of the reasons of rejection, without the figures in them
    """

    condition: str
    drives: int
    proposed: int
    rejected: int
    accepted: int
    wrong: int
    wrong_drives: int
    wrong_rate: float
    wrong_limit: float
    wrong_of_accepted_limit: float
    drift: float
    needed: int
    found: int
    unambiguous: int
    unambiguous_found: int
    joined_share: float
    doubled: int
    ate: float
    relocated: int
    misplaced: int
    ended_off: int
    failed: int
    reasons: dict[str, int]


def choose(conditions: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the worlds and variants among `conditions`: all worlds without one, the standard variant without one."""
    worlds = tuple(name for name in WORLDS if name in conditions)
    return worlds or tuple(WORLDS), tuple(name for name in VARIANTS if name in conditions) or (STANDARD,)


def run_worlds(
    worlds: Sequence[str] = tuple(WORLDS),
    seeds: Sequence[int] = range(20),
    processes: int = 1,
    variants: Sequence[str] = (STANDARD,),
) -> Iterator[LookalikeRun]:
    """Simulate each world in each variant once with each seed, and yield the runs in that order."""
    jobs = [(world, seed, variant) for variant in variants for world in worlds for seed in seeds]
    if processes == 1:
        yield from (run_world(*job) for job in jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_world, *zip(*jobs, strict=True))


def run_world(world: str, seed: int, variant: str = STANDARD) -> LookalikeRun:
    """Run SLAM in a simulated world and score it against ground truth."""
    simulation = simulation_of(world, seed, variant)
    scorer = LoopScorer(simulation)
    slam = Slam(sinks=[scorer])
    try:
        with messages_of(simulation, variant) as messages:
            for message in messages:
                slam.add(message)
        finished = slam.finish()
    except MapError as error:
        errors = tuple(scorer.relocalisation_errors)
        return LookalikeRun(
            world,
            seed,
            tuple(scorer.decisions),
            scorer.drift,
            False,
            0,
            np.nan,
            errors,
            failed=str(error),
            variant=variant,
        )
    scorer.score_closed(finished.keyframes.poses)
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
        variant=variant,
    )


def simulation_of(world: str, seed: int, variant: str) -> Simulation:
    """Return the simulation of a drive."""
    building = mirror(load_world(world)) if variant == "mirrored" else world
    lidar = HALF_CIRCLE if variant == "half-circle" else LIDAR_MODELS["short"]
    return Simulation(building, seed=seed, lidar=lidar, wheels=WHEEL_MODELS["bad"])


@contextmanager
def messages_of(simulation: Simulation, variant: str) -> Iterator[Iterable[Message]]:
    """Provide the messages of a drive; those of a recording are written to a file and read again."""
    random = np.random.default_rng(simulation.seed)
    if variant == "half-circle":
        yield crop(math.pi / 2)(simulation, random)
    elif variant == "sparse":
        with recorded(chain(thin(), scatter_no_returns())(simulation, random)) as reader:
            yield reader
    else:
        yield simulation


def summarise_worlds(runs: Sequence[LookalikeRun]) -> list[LoopStatistics]:
    """Return the statistics of each world and variant, in the order of first appearance."""
    conditions = dict.fromkeys(run.condition for run in runs)
    return [summarise(name, [run for run in runs if run.condition == name]) for name in conditions]


def summarise(condition: str, runs: Sequence[LookalikeRun]) -> LoopStatistics:
    """Return the statistics of some runs under a name."""
    decided = [decided for run in runs for decided in run.decisions]
    statuses = Counter(d.status for d in decided)
    needed, unambiguous = [run for run in runs if run.needed], [run for run in runs if run.unambiguous]
    wrong, accepted = sum(len(run.wrong) for run in runs), statuses[LoopStatus.ACCEPTED]
    wrong_drives, joined = sum(bool(run.wrong) for run in runs), sum(run.joined for run in unambiguous)
    return LoopStatistics(
        condition=condition,
        drives=len(runs),
        proposed=len(decided),
        rejected=statuses[LoopStatus.REJECTED],
        accepted=accepted,
        wrong=wrong,
        wrong_drives=wrong_drives,
        wrong_rate=wrong_drives / len(runs),
        wrong_of_accepted_limit=upper_limit(wrong, accepted),
        wrong_limit=upper_limit(wrong_drives, len(runs)),
        drift=float(np.median([run.drift for run in runs])),
        needed=len(needed),
        found=sum(run.joined for run in needed),
        unambiguous=len(unambiguous),
        unambiguous_found=joined,
        joined_share=joined / len(unambiguous) if unambiguous else math.nan,
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
    """Return a reason with "..." in place of the figures in it."""
    return re.sub(r"\d+(\.\d+)?", "...", reason)
