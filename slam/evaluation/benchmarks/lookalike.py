"""Places that look alike: whether a wrong loop closure is ever accepted, how often a needed one is found, and whether a
robot that gets lost is found where it is.

The robot is short-sighted and its wheels are worn, so that it comes back to places it has seen with more drift than
association bridges.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from drivers.simulation.simulator import DRIVES, LIDARS, Simulation

from ...errors import MapError
from ...pipeline import Slam
from .witness import Decided, Witness

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
WRONG, WRONG_TURN = 0.5, np.radians(10.0)  # by which a closure misses the true motion when it is called wrong
MISPLACED = 1.0  # metres: found so far off, the robot is in another place; ending so far off, the map is another one
NEEDED = 0.5  # metres of drift at a place that is visited again: more than association bridges
JOINED = 0.3  # metres that may be left between two visits to a place of which the final map has made one
JOINED_SHARE = 0.9  # of all visits that must be joined


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive through a world.

    drift    metres by which the robot was off at most, relative to its earlier visit, when it came back to a place
    joined   whether the final map has one place where there is one
    doubled  walls that the final map has more than once
    ate      metres, root mean square of the keyframes' errors after alignment
    found    metres, for each time that the robot was lost and found: how far off, as seen from the keyframes around
    last     metres by which the last keyframe is off, as seen from the first
    failed   why there is no final map, where there is none
    """

    world: str
    seed: int
    decided: tuple[Decided, ...]
    drift: float
    joined: bool
    doubled: int
    ate: float
    found: tuple[float, ...] = ()
    last: float = 0.0
    failed: str = ""

    @property
    def needed(self) -> bool:
        """Whether the map could be made one only by closing a loop."""
        return self.drift > NEEDED

    @property
    def accepted(self) -> list[Decided]:
        """The closures that were made."""
        return [decided for decided in self.decided if decided.status == "accepted"]

    @property
    def wrong(self) -> list[Decided]:
        """Those that lead to another place than the one where the robot was."""
        return [decided for decided in self.accepted if decided.error > WRONG or decided.turn > WRONG_TURN]

    @property
    def misplaced(self) -> int:
        """How often the robot was found in another place than the one where it was."""
        return sum(error > MISPLACED for error in self.found)


@dataclass(frozen=True, slots=True)
class Row:
    """All drives through one world: counts; drift and ate are medians in metres.

    needed, found  drives of which the map could be made one only by closing a loop, and those in which it was
    relocated      how often a robot that was lost was found, `misplaced` of them in another place
    ended_off      drives that ended more than MISPLACED from the truth, as seen from where they began: because of a
                   wrong closure or place, or of drift that no loop took out
    failed         drives that came to no map
    reasons        why candidates were rejected, how often, without the figures
    """

    world: str
    drives: int
    proposed: int
    rejected: int
    held: int
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


def run(worlds: Sequence[str] = WORLDS, seeds: Sequence[int] = range(20), processes: int = 1) -> Iterator[Drive]:
    """Drive through each world once with each seed; the drives come in that order, however many processes there are."""
    jobs = [(world, seed) for world in worlds for seed in seeds]
    if processes == 1:
        yield from (drive(*job) for job in jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(drive, *zip(*jobs, strict=True))


def drive(world: str, seed: int) -> Drive:
    """Map a world with the truth looking on."""
    simulation = Simulation(world, seed=seed, lidar=LIDARS["short"], drive=DRIVES["bad"])
    witness = Witness(simulation)
    slam = Slam(sinks=[witness])
    try:
        for message in simulation:
            slam.add(message)
        finished = slam.finish()
    except MapError as error:
        found = tuple(witness.misplaced)
        return Drive(world, seed, tuple(witness.decided), witness.drift, False, 0, np.nan, found, failed=str(error))
    return Drive(
        world,
        seed,
        tuple(witness.decided),
        drift=witness.drift,
        joined=witness.joined(finished, JOINED) >= JOINED_SHARE,
        doubled=witness.doubled(finished.lines),
        ate=witness.ate(finished),
        found=tuple(witness.misplaced),
        last=witness.last_error(finished),
    )


def condense(drives: Sequence[Drive]) -> list[Row]:
    """A row for each world, in the order in which they come."""
    return [_row(world, [d for d in drives if d.world == world]) for world in dict.fromkeys(d.world for d in drives)]


def _row(world: str, drives: list[Drive]) -> Row:
    decided = [decided for drive in drives for decided in drive.decided]
    statuses = Counter(d.status for d in decided)
    needed = [drive for drive in drives if drive.needed]
    return Row(
        world=world,
        drives=len(drives),
        proposed=len(decided),
        rejected=statuses["rejected"],
        held=statuses["held"],
        accepted=statuses["accepted"],
        wrong=sum(len(drive.wrong) for drive in drives),
        drift=float(np.median([drive.drift for drive in drives])),
        needed=len(needed),
        found=sum(drive.joined for drive in needed),
        doubled=sum(drive.doubled for drive in drives),
        ate=float(np.median([drive.ate for drive in drives if not drive.failed] or [np.nan])),
        relocated=sum(len(drive.found) for drive in drives),
        misplaced=sum(drive.misplaced for drive in drives),
        ended_off=sum(drive.last > MISPLACED for drive in drives),
        failed=sum(bool(drive.failed) for drive in drives),
        reasons=dict(Counter(_kind(d.reason) for d in decided if d.status == "rejected").most_common()),
    )


def _kind(reason: str) -> str:
    """A reason without its figures."""
    return " ".join(word for word in reason.split() if not any(letter.isdigit() for letter in word) and word != "<")
