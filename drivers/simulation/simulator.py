"""A robot with a turning lidar and two wheels in a made-up building, as a source of measurements with the
truth beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from ..clock import NANOSECONDS, to_nanoseconds, to_seconds
from ..errors import RecordingError
from ..messages import Floats, GroundTruth, Message, Odometry, Scan, SourceReport
from ..se2 import Pose
from .driving import Biases, Drive, Path, draw_biases, drive_path, odometry
from .raycast import sweep
from .world import World, load_world

FIRST_SCAN = 13_000_000
"""Nanoseconds after the start: a lidar's revolutions do not begin when odometry is read."""
EDGE = 0.1
"""Metres. Where neighbouring beams differ by so much more than the beams around them, a beam may hit both surfaces."""
STEEPER = 1.5
"""How much more a step of range grows from beam to beam at an edge than along a wall seen at grazing incidence."""

__all__ = ["Biases", "Drive", "Lidar", "Simulation", "warm_up"]


@dataclass(frozen=True, slots=True)
class Lidar:
    """A turning lidar and its noise; the defaults are those of an RPLIDAR S1.

    beams          a revolution; the first looks backwards, and they go round counter-clockwise
    rate           revolutions a second
    range_min, range_max  metres; nearer and farther returns are invalid
    sigma_range    standard deviation of the white noise on each range, metres
    sigma_bearing  standard deviation of the white noise on each beam's direction, radians
    range_bias     metres by which all ranges come out long
    dropouts       share of the beams that return nothing
    mixed          share of the beams beside an edge that return something between the two surfaces
    """

    beams: int = 920
    rate: float = 10.0
    range_min: float = 0.1
    range_max: float = 40.0
    sigma_range: float = 0.01
    sigma_bearing: float = float(np.radians(0.05))
    range_bias: float = 0.0
    dropouts: float = 0.01
    mixed: float = 0.3


LIDARS = {"long": Lidar(), "short": Lidar(beams=360, rate=5.5, range_max=6.0, sigma_range=0.015)}
"""Lidars by name: one that sees a whole hall, and a cheap one that sees a room."""
DRIVES = {
    "good": Drive(),
    "bad": Drive(slip=0.02, encoder=0.0005, scale_bias=0.04, difference_bias=0.004, wheelbase_bias=0.05),
}
"""Drives by name: well calibrated wheels, and worn ones whose drift no scan corrects where there is nothing to see."""


class Simulation:
    """A drive through a world, as a `Source`: the same arguments give the same messages bit for bit.

    world     the name of a world that comes with the package, a TOML file (see `world`), or a World
    seed      of all that is random
    duration  seconds; None drives the world's path once (see `driving.drive_path`)
    lidar, drive  the instruments and their noise
    mount     [x, y, heading] of the lidar on the robot, metres and radians

    At each stamp the GroundTruth comes first, in the world's frame, then Odometry, which starts at [0, 0, 0], then a
    Scan. What floats of 32 bits hold in recordings (ranges, limits, increments of angle and time) is rounded to 32 bits
    here, so that a simulation is the same when it is read back from one. Raises RecordingError where the world cannot
    be had or an argument is impossible.
    """

    def __init__(
        self,
        world: str | FilePath | World = "office",
        seed: int = 0,
        duration: float | None = None,
        lidar: Lidar | None = None,
        drive: Drive | None = None,
        mount: Sequence[float] | Pose = (0.1, 0.0, 0.0),
    ) -> None:
        self.world = world if isinstance(world, World) else load_world(world)
        self.seed, self.duration = seed, duration
        self.lidar, self.drive = lidar or Lidar(), drive or Drive()
        self.mount = np.array(mount, dtype=np.float64)
        self.mount.flags.writeable = False
        self.name = f"sim:{self.world.name}"
        self.report = SourceReport()
        self._check()

    def _check(self) -> None:
        lidar, drive = self.lidar, self.drive
        if self.mount.shape != (3,) or not np.all(np.isfinite(self.mount)):
            raise RecordingError(self.name, None, "the lidar's mount must be x, y and heading")
        if self.duration is not None and not 0.0 < self.duration <= 1e6:
            raise RecordingError(self.name, None, "the duration must be positive, and below a million seconds")
        if self.seed < 0:
            raise RecordingError(self.name, None, "the seed must not be negative")
        if lidar.beams < 1 or not lidar.rate > 0 or not drive.rate > 0 or not drive.wheelbase > 0:
            raise RecordingError(self.name, None, "beams, rates and wheelbase must be positive")
        if not all(0.0 <= share <= 1.0 for share in (lidar.dropouts, lidar.mixed)):
            raise RecordingError(self.name, None, "shares of beams must be between 0 and 1")
        biases = (drive.scale_bias, drive.difference_bias, drive.wheelbase_bias)
        if not all(
            0.0 <= s < 1.0 for s in (lidar.sigma_range, lidar.sigma_bearing, drive.slip, drive.encoder, *biases)
        ):
            raise RecordingError(self.name, None, "noise and biases must be between 0 and 1")

    @property
    def parameters(self) -> dict[str, object]:
        """All that the messages follow from, the drawn biases included, as plain values."""
        return {
            "world": self.world.name,
            "seed": self.seed,
            "duration": self.duration,
            "lidar": asdict(self.lidar),
            "drive": asdict(self.drive),
            "mount": self.mount.tolist(),
            "biases": asdict(self.biases),
        }

    @property
    def biases(self) -> Biases:
        """What is wrong with this seed's wheels."""
        return draw_biases(self.drive, self._random()[0])

    @cached_property
    def path(self) -> Path:
        """The true motion."""
        return drive_path(self.world.path, self.world.speed, self.duration)

    def __len__(self) -> int:
        """The number of messages."""
        odometry_stamps, scan_stamps = self._stamps()
        return 2 * (len(odometry_stamps) + len(scan_stamps)) - len(set(odometry_stamps) & set(scan_stamps))

    def __iter__(self) -> Iterator[Message]:
        """The messages, from the beginning, stamps never decreasing."""
        self.report = report = SourceReport()
        wheels, beams = self._random()
        biases = draw_biases(self.drive, wheels)
        odometry_stamps, scan_stamps = self._stamps()
        odometry_times = np.array([to_seconds(stamp) for stamp in odometry_stamps])
        told = dict(zip(odometry_stamps, odometry(self.path, odometry_times, self.drive, biases, wheels), strict=True))
        measured = set(scan_stamps)
        stamps = sorted(measured.union(told))
        truth = self.path.at(np.array([to_seconds(stamp) for stamp in stamps]))
        for nanoseconds, true_pose in zip(stamps, truth, strict=True):
            stamp = to_seconds(nanoseconds)
            messages: list[Message] = [GroundTruth(stamp, true_pose)]
            if nanoseconds in told:
                messages.append(Odometry(stamp, told[nanoseconds]))
            if nanoseconds in measured:
                messages.append(self._scan(stamp, beams))
            report.messages += len(messages)
            yield from messages

    def _random(self) -> list[np.random.Generator]:
        """One stream for the wheels and one for the beams, so that changing one does not change the other."""
        return [np.random.default_rng(child) for child in np.random.SeedSequence(self.seed).spawn(2)]

    def _stamps(self) -> tuple[list[int], list[int]]:
        """The stamps of odometry and of whole revolutions, nanoseconds."""
        end = to_nanoseconds(self.path.duration)
        turn = NANOSECONDS / self.lidar.rate
        readings = int(end * self.drive.rate // NANOSECONDS) + 1
        scans = max(0, int((end - FIRST_SCAN) // turn))
        odometry_stamps = [round(i * NANOSECONDS / self.drive.rate) for i in range(readings)]
        return odometry_stamps, [FIRST_SCAN + round(i * turn) for i in range(scans)]

    @cached_property
    def _beams(self) -> tuple[Floats, Floats]:
        """Angles and time offsets of the beams, both (n,)."""
        count = self.lidar.beams
        index = np.arange(count, dtype=np.float64)
        angles = float(np.float32(-np.pi)) + index * float(np.float32(2 * np.pi / count))
        offsets = index * float(np.float32(1.0 / (self.lidar.rate * count)))
        angles.flags.writeable = offsets.flags.writeable = False
        return angles, offsets

    def _scan(self, stamp: float, random: np.random.Generator) -> Scan:
        lidar = self.lidar
        angles, offsets = self._beams
        bearing_noise, range_noise = random.standard_normal((2, lidar.beams))
        dropped, is_mixed, share = random.random((3, lidar.beams))
        bearings = angles + lidar.sigma_bearing * bearing_noise
        world, path = self.world, self.path
        segments, circles = world.at(stamp)
        ranges = sweep(stamp + offsets, bearings, self.mount, path.poses, path.twists, segments, circles)
        step = steps(ranges)
        mixed = at_edge(step) & (is_mixed < lidar.mixed)
        ranges[mixed] += share[mixed] * step[mixed]
        ranges = (ranges + lidar.range_bias + lidar.sigma_range * range_noise).astype(np.float32).astype(np.float64)
        low, high = float(np.float32(lidar.range_min)), float(np.float32(lidar.range_max))
        ranges[~((ranges >= low) & (ranges < high)) | (dropped < lidar.dropouts)] = np.nan
        return Scan(stamp, ranges, angles, offsets, low, high, self.mount)


def steps(ranges: Floats) -> Floats:
    """(n,) by how much each beam of a revolution is shorter than the next, metres; zero where one does not return."""
    with np.errstate(invalid="ignore"):  # infinite minus infinite, where neither returns
        step = np.roll(ranges, -1) - ranges
    return np.where(np.isfinite(step), step, 0.0)


def at_edge(step: Floats) -> NDArray[np.bool_]:
    """(n,) whether a beam and the next lie on surfaces apart, by the `steps` of range of a whole revolution.

    Along a wall at grazing incidence the steps are large too, but grow slowly from beam to beam.
    """
    size = np.abs(step)
    around = np.maximum(np.roll(size, 1), np.roll(size, -1))
    return np.asarray(size > EDGE + STEEPER * around)


def warm_up() -> None:
    """Compile what the simulator runs, or load it from the cache; the first message comes quickly afterwards."""
    square = np.array([[-1.0, -1.0, 1.0, -1.0], [1.0, -1.0, 1.0, 1.0]])
    path = np.array([[0.0, 0.0], [1.0, 0.0]])
    world = World("warm-up", "warm-up", square, np.zeros((0, 3)), path, 0.5)
    for _ in Simulation(world, duration=0.2):
        pass
