"""Simulated robot with a rotating lidar and wheel encoders in a building: a source with ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..messages import Floats, GroundTruth, Message, Odometry, Scan, SourceReport
from ..se2 import Pose
from ..timestamps import NANOSECONDS, to_nanoseconds, to_seconds
from .lidar_model import LidarModel, add_mixed_pixels
from .raycast import cast_beams
from .trajectory import ArcTrajectory, follow_waypoints
from .wheel_model import WheelBiases, WheelModel, draw_biases, simulate_odometry
from .world import World, load_world

FIRST_SCAN = 13_000_000
"""Stamp of the first scan, nanoseconds after the start: scans and odometry are not synchronised."""


class Simulation:
    """Simulated drive through a world, as a `Source`: equal arguments give messages that are equal bit for bit.

    world     name of a world that comes with the package, a TOML file (see `world`), or a World
    seed      seed of all random numbers
    duration  seconds; None follows the world's way points once (see `trajectory.follow_waypoints`)
    lidar     parameters of the lidar and its noise
    wheels    parameters of the wheels and their errors
    mount     [x, y, heading] of the lidar on the robot, metres and radians
    second_mount  the same of a second lidar with the same parameters; None: there is one lidar

    The messages of one stamp are ordered GroundTruth (in the world's frame), Odometry (starting at [0, 0, 0]), Scan,
    Scan of the second lidar. Ranges, range limits, and the increments of angle and time are rounded to 32-bit floats,
    as recordings store them, so that a recorded simulation is read back bit for bit. Raises RecordingError if the world
    cannot be loaded or an argument is invalid.
    """

    def __init__(
        self,
        world: str | Path | World = "office",
        seed: int = 0,
        duration: float | None = None,
        lidar: LidarModel | None = None,
        wheels: WheelModel | None = None,
        mount: Sequence[float] | Pose = (0.1, 0.0, 0.0),
        second_mount: Sequence[float] | Pose | None = None,
    ) -> None:
        self.world = world if isinstance(world, World) else load_world(world)
        self.seed, self.duration = seed, duration
        self.lidar, self.wheels = lidar or LidarModel(), wheels or WheelModel()
        self.mount = _mount(mount)
        self.second_mount = None if second_mount is None else _mount(second_mount)
        self.name = f"sim:{self.world.name}"
        self.report = SourceReport()
        self._check()

    def _check(self) -> None:
        lidar, wheels = self.lidar, self.wheels
        for mount in self._mounts:
            if mount.shape != (3,) or not np.all(np.isfinite(mount)):
                raise RecordingError(self.name, None, "the lidar's mount must be three finite numbers: x, y, heading")
        if not 0.0 < lidar.field_of_view <= 2 * np.pi:
            raise RecordingError(self.name, None, "the field of view must be positive and at most a full turn")
        if self.duration is not None and not 0.0 < self.duration <= 1e6:
            raise RecordingError(self.name, None, "the duration must be positive and at most 1e6 seconds")
        if self.seed < 0:
            raise RecordingError(self.name, None, "the seed must not be negative")
        if lidar.beams < 1 or not lidar.rate > 0 or not wheels.rate > 0 or not wheels.wheelbase > 0:
            raise RecordingError(self.name, None, "beams, rates and wheelbase must be positive")
        if not all(0.0 <= share <= 1.0 for share in (lidar.dropouts, lidar.mixed)):
            raise RecordingError(self.name, None, "shares of beams must be between 0 and 1")
        biases = (wheels.scale_bias, wheels.difference_bias, wheels.wheelbase_bias)
        if not all(
            0.0 <= s < 1.0 for s in (lidar.sigma_range, lidar.sigma_bearing, wheels.slip, wheels.encoder, *biases)
        ):
            raise RecordingError(self.name, None, "noise and biases must be between 0 and 1")

    @property
    def parameters(self) -> dict[str, object]:
        """All parameters of the simulation, including the drawn biases, as plain values."""
        return {
            "world": self.world.name,
            "seed": self.seed,
            "duration": self.duration,
            "lidar": asdict(self.lidar),
            "wheels": asdict(self.wheels),
            "mount": self.mount.tolist(),
            **({} if self.second_mount is None else {"second_mount": self.second_mount.tolist()}),
            "biases": asdict(self.biases),
        }

    @property
    def biases(self) -> WheelBiases:
        """Systematic errors of this seed's wheels."""
        return draw_biases(self.wheels, self._random()[0])

    @cached_property
    def trajectory(self) -> ArcTrajectory:
        """True trajectory."""
        return follow_waypoints(self.world.waypoints, self.world.speed, self.duration)

    def __len__(self) -> int:
        """Return the number of messages."""
        odometry_stamps, scan_stamps = self._stamps()
        of_scans = (1 + len(self._mounts)) * len(scan_stamps)
        return 2 * len(odometry_stamps) + of_scans - len(set(odometry_stamps) & set(scan_stamps))

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning, with non-decreasing stamps."""
        self.report = report = SourceReport()
        wheel_random, *beam_random = self._random()
        biases = draw_biases(self.wheels, wheel_random)
        odometry_stamps, scan_stamps = self._stamps()
        odometry_times = np.array([to_seconds(stamp) for stamp in odometry_stamps])
        poses = simulate_odometry(self.trajectory, odometry_times, self.wheels, biases, wheel_random)
        odometry = dict(zip(odometry_stamps, poses, strict=True))
        has_scan = set(scan_stamps)
        stamps = sorted(has_scan.union(odometry))
        truth = self.trajectory.poses_at(np.array([to_seconds(stamp) for stamp in stamps]))
        for nanoseconds, true_pose in zip(stamps, truth, strict=True):
            stamp = to_seconds(nanoseconds)
            messages: list[Message] = [GroundTruth(stamp, true_pose)]
            if nanoseconds in odometry:
                messages.append(Odometry(stamp, odometry[nanoseconds]))
            if nanoseconds in has_scan:
                messages += [self._scan(stamp, number, random) for number, random in enumerate(beam_random)]
            report.messages += len(messages)
            yield from messages

    @property
    def _mounts(self) -> list[Pose]:
        """Mounts of the lidars."""
        return [self.mount] if self.second_mount is None else [self.mount, self.second_mount]

    def _random(self) -> list[np.random.Generator]:
        """Return separate generators for wheels and each lidar, so that the noise of one does not depend on another."""
        count = 1 + len(self._mounts)
        return [np.random.default_rng(child) for child in np.random.SeedSequence(self.seed).spawn(count)]

    def _stamps(self) -> tuple[list[int], list[int]]:
        """Return the stamps of the odometry and of the complete revolutions, nanoseconds."""
        end = to_nanoseconds(self.trajectory.duration)
        period = NANOSECONDS / self.lidar.rate
        readings = int(end * self.wheels.rate // NANOSECONDS) + 1
        scans = max(0, int((end - FIRST_SCAN) // period))
        odometry_stamps = [round(i * NANOSECONDS / self.wheels.rate) for i in range(readings)]
        return odometry_stamps, [FIRST_SCAN + round(i * period) for i in range(scans)]

    @cached_property
    def _beams(self) -> tuple[Floats, Floats]:
        """Angles (radians) and time offsets (seconds) of the beams, both (n,)."""
        count, view = self.lidar.beams, self.lidar.field_of_view
        index = np.arange(max(1, round(count * view / (2 * np.pi))), dtype=np.float64)
        angles = float(np.float32(-0.5 * view)) + index * float(np.float32(2 * np.pi / count))
        offsets = index * float(np.float32(1.0 / (self.lidar.rate * count)))
        angles.flags.writeable = offsets.flags.writeable = False
        return angles, offsets

    def _scan(self, stamp: float, number: int, random: np.random.Generator) -> Scan:
        """Simulate one scan of a lidar. The world is that of the stamp, the robot moves during the sweep."""
        lidar, mount = self.lidar, self._mounts[number]
        angles, offsets = self._beams
        bearing_noise, range_noise = random.standard_normal((2, len(angles)))
        dropped, mixed, share = random.random((3, len(angles)))
        bearings = angles + lidar.sigma_bearing * bearing_noise
        segments, circles = self.world.shapes_at(stamp)
        poses, twists = self.trajectory.poses, self.trajectory.twists
        ranges = cast_beams(stamp + offsets, bearings, mount, poses, twists, segments, circles)
        at_edge = mixed < lidar.mixed
        at_edge[-1] &= lidar.field_of_view == 2 * np.pi  # the last beam is no neighbour of the first otherwise
        add_mixed_pixels(ranges, at_edge, share)
        ranges = (ranges + lidar.range_bias + lidar.sigma_range * range_noise).astype(np.float32).astype(np.float64)
        low, high = float(np.float32(lidar.range_min)), float(np.float32(lidar.range_max))
        ranges[~((ranges >= low) & (ranges < high)) | (dropped < lidar.dropouts)] = np.nan
        return Scan(stamp, ranges, angles, offsets, low, high, mount, number)


def _mount(values: Sequence[float] | Pose) -> Pose:
    mount = np.array(values, dtype=np.float64)
    mount.flags.writeable = False
    return mount


def warm_up() -> None:
    """Compile the simulator's functions, or load them from the cache, so that the first message is not delayed."""
    square = np.array([[-1.0, -1.0, 1.0, -1.0], [1.0, -1.0, 1.0, 1.0]])
    waypoints = np.array([[0.0, 0.0], [1.0, 0.0]])
    world = World("warm-up", "warm-up", square, np.zeros((0, 3)), waypoints, 0.5)
    for _ in Simulation(world, duration=0.2):
        pass
