"""Drives of the robustness benchmark: recordings in a folder, their variants, and simulated worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from drivers.messages import Message, Source
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, Simulation, WheelModel, World, load_world

from ...errors import MapError
from .scenarios.buildings import random_building, turning_path, wide_hall
from .scenarios.later_drives import PATROL_SECONDS, small_stranger
from .scenarios.log_variants import (
    LogVariant,
    carry,
    crop,
    drift,
    fail_odometry,
    jitter,
    lose_scans,
    reverse_times,
    shorten,
    stamp_late,
    thin,
)
from .scenarios.recorded import recorded
from .scenarios.strangers import stranger
from .scenarios.world_variants import add_crowd

LaterMode: TypeAlias = Literal["localize", "continue"]
"""What a drive on another day does with the map of an earlier one."""

SUFFIXES = (".clf", ".log", ".carmen", ".mcap", ".bag", ".db3")
"""Of recordings in one file; a folder with metadata.yaml is a ROS 2 bag."""
COMPRESSED = (".gz", ".bz2")
"""Suffixes that may follow one of these."""
RELATIONS, TRAJECTORY = ".relations", ".tum"
"""Suffixes of references: `NAME.relations`, `NAME.ORIGIN.tum`."""
PREFERRED = ("truth", "gmapping", "lama")
"""Origins of reference trajectories, the preferred one first; others follow in alphabetical order."""
PEOPLE = 10
"""In the crowd around the robot."""
LATE = 0.4
"""Seconds by which the scans of the late lidar are stamped late: more than its period."""
NARROW_HALF_ANGLE = float(np.radians(45.0))
"""Radians to both sides of ahead that a narrow lidar, or a depth camera, sees."""


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A recording, and its reference: relations or a trajectory; None without one."""

    name: str
    path: Path
    reference: Path | None

    @property
    def origin(self) -> str:
        """Origin of the reference: "relations", or what made the trajectory, such as "lama"; empty without one."""
        if self.reference is None or self.reference.suffix == RELATIONS:
            return "" if self.reference is None else "relations"
        prefix = _as_uncompressed(self.path).stem
        return self.reference.name.removeprefix(prefix).removesuffix(self.reference.suffix).strip(".")


@dataclass(frozen=True, slots=True)
class DriveVariant:
    """A change of recorded drives.

    log        change of the messages; None for none
    backwards  True if the drive is played backwards
    drawn      True if it depends on the seed
    """

    log: LogVariant | None = None
    backwards: bool = False
    drawn: bool = False


VARIANTS: dict[str, DriveVariant] = {
    "backwards": DriveVariant(backwards=True),
    "drift": DriveVariant(drift(), drawn=True),
    "backwards-drift": DriveVariant(drift(), backwards=True, drawn=True),
    "failing-odometry": DriveVariant(fail_odometry(), drawn=True),
    "failing-lidar": DriveVariant(lose_scans(), drawn=True),
    "carried": DriveVariant(carry(), drawn=True),
    "jitter": DriveVariant(jitter(), drawn=True),
    "narrow": DriveVariant(crop(NARROW_HALF_ANGLE)),
    "short-range": DriveVariant(shorten()),
    "thinned": DriveVariant(thin()),
}
"""Variants of recorded drives by name."""


@dataclass(frozen=True, slots=True)
class SimulatedWorld:
    """A world of the benchmark.

    description  for tables
    world        function of the seed; a complete simulation if also lidar and wheels are drawn
    lidar, wheels  names of the simulator's models
    duration     seconds; None follows the way points once
    log          change of the messages
    recording    True if the messages are written to a recording and read again, so that its reader corrects them
    later        not None if a drive of the next day is scored, in the map of this one
    refurnished  True if it then is in the same building with other furniture
    """

    description: str
    world: Callable[[int], World | Simulation]
    lidar: str = "long"
    wheels: str = "good"
    duration: float | None = None
    log: LogVariant | None = None
    recording: bool = False
    later: LaterMode | None = None
    refurnished: bool = False

    def simulation(self, seed: int) -> Simulation:
        """Return the simulation of one drive."""
        world = self.world(seed)
        if isinstance(world, Simulation):
            return world
        lidar: LidarModel = LIDAR_MODELS[self.lidar]
        wheels: WheelModel = WHEEL_MODELS[self.wheels]
        return Simulation(world, seed, self.duration, lidar, wheels)

    @contextmanager
    def messages(self, simulation: Simulation) -> Iterator[Iterable[Message] | Source]:
        """Provide the messages of a drive."""
        random = np.random.default_rng(simulation.seed)
        messages = simulation if self.log is None else self.log(simulation, random)
        if not self.recording:
            yield messages
            return
        with recorded(messages) as reader:
            yield reader


def _crowded(seed: int) -> World:
    return add_crowd(load_world("office"), PEOPLE, np.random.default_rng(seed), 60.0)


WORLDS: dict[str, SimulatedWorld] = {
    "crowd": SimulatedWorld("an office, ten people around the robot", _crowded, duration=60.0),
    "turns": SimulatedWorld(
        "turns on the spot, one scan for each 1 m or 30 degrees", lambda _: turning_path(), "short", "bad", log=thin()
    ),
    "reversed-beams": SimulatedWorld(
        "an office, beams in the opposite of the stated order",
        lambda _: load_world("office"),
        "short",
        duration=60.0,
        log=reverse_times(),
        recording=True,
    ),
    "late-lidar": SimulatedWorld(
        "an office, scans stamped 0.4 s late",
        lambda _: load_world("office"),
        duration=60.0,
        log=stamp_late(LATE),
        recording=True,
    ),
    "wide-hall": SimulatedWorld("a hall wider than the lidar's range", lambda _: wide_hall(), "short", "bad"),
    "columns": SimulatedWorld("a hall with round columns", lambda _: load_world("columns"), "short", "bad", 100.0),
    "buildings": SimulatedWorld("long corridors and rooms, others for each seed", random_building, "short", "bad"),
    "failing-odometry": SimulatedWorld(
        "buildings as above, odometry stands still or is missing for up to 40 s",
        random_building,
        log=fail_odometry(),
        recording=True,
    ),
    "strangers": SimulatedWorld("building, lidar, mount, wheels and people drawn from the seed", stranger),
    "patrol": SimulatedWorld(
        "strangers with a small lidar that repeat their tour for ten minutes",
        lambda seed: small_stranger(seed, PATROL_SECONDS),
    ),
    "known-map": SimulatedWorld(
        "strangers on another day, localised in the map of their first drive", small_stranger, later="localize"
    ),
    "refurnished-map": SimulatedWorld(
        "as known-map, with other furniture than on the first day", small_stranger, later="localize", refurnished=True
    ),
    "continued-map": SimulatedWorld(
        "strangers on another day, who continue the map of their first drive", small_stranger, later="continue"
    ),
}
"""Simulated worlds by name."""


def find_recordings(folder: Path) -> list[RecordedDrive]:
    """Return all recordings in a folder and its subfolders, in alphabetical order, with their references.

    The name of a recording is its path in the folder without suffix, or that of its own folder if both are equal.
    References are files beside it: `NAME.relations`, or a trajectory such as `NAME.gmapping.tum`. Raises MapError if
    the folder does not exist or has no recordings.
    """
    if not folder.is_dir():
        raise MapError(f"{folder}: no such directory")
    files = {file for file in folder.rglob("*") if file.is_file() and _as_uncompressed(file).suffix.lower() in SUFFIXES}
    bags = {file.parent for file in folder.rglob("metadata.yaml")}
    found = sorted({file for file in files if file.parent not in bags} | bags)
    if not found:
        raise MapError(f"{folder}: contains no recordings ({', '.join(SUFFIXES)}, or ROS 2 bags)")
    return [RecordedDrive(_name(path, folder), path, _reference(path)) for path in found]


def _as_uncompressed(path: Path) -> Path:
    """Return the name of a file if it were not compressed."""
    return path.with_suffix("") if path.suffix.lower() in COMPRESSED else path


def _name(path: Path, folder: Path) -> str:
    relative = _as_uncompressed(path).relative_to(folder)
    relative = relative if path.is_dir() else relative.with_suffix("")
    own_folder = len(relative.parts) > 1 and relative.parts[-1] == relative.parts[-2]
    return (relative.parent if own_folder else relative).as_posix()


def _reference(path: Path) -> Path | None:
    """Return the reference of a recording."""
    path = _as_uncompressed(path)
    if (relations := path.with_suffix(RELATIONS)).exists():
        return relations
    ranks = {origin: rank for rank, origin in enumerate(PREFERRED)}
    prefix = f"{path.stem}."
    trajectories = [file for file in path.parent.glob(f"*{TRAJECTORY}") if file.name.startswith(prefix)]
    origins = {file: file.name.removeprefix(prefix).removesuffix(TRAJECTORY) for file in trajectories}
    return min(trajectories, key=lambda file: (ranks.get(origins[file], len(ranks)), origins[file]), default=None)
