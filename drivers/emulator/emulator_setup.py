"""Settings of the emulator, and the scheduled faults."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import DriverError
from ..simulation import LidarModel, WheelModel, World
from . import rplidar_variants, wheel_base
from .ld06 import LD06_VARIANTS
from .scip import SCIP_VARIANTS

DRIVES = ("path", "base", "keyboard")
"""Pilots: the world's path, the velocities sent to the base, the arrow keys."""
LASTING_FAULTS = ("unplug", "stall")
"""Kinds of faults that end after their duration; the others happen at one time."""
EVENT_PATTERN = re.compile(r"(lidar|base)@([0-9]+(?:\.[0-9]+)?)(?::([0-9]+(?:\.[0-9]+)?))?")
MAX_CLOCK_DRIFT = 10_000.0
"""Parts per million; ceramic resonators are within half of it."""


def lidar_names() -> list[str]:
    """Return the names of the lidars that can be emulated."""
    return [*rplidar_variants.RPLIDAR_VARIANTS, *LD06_VARIANTS, *SCIP_VARIANTS]


def base_names() -> list[str]:
    """Return the names of the wheel bases that can be emulated."""
    return list(wheel_base.BASE_VARIANTS)


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """Scheduled fault of a device.

    kind      unplug (the port disappears), stall (the device is silent), restart, or fail (until the device is reset)
    device    lidar or base
    time      from the start of the emulation, seconds
    duration  of unplug and stall, seconds
    """

    kind: str
    device: str
    time: float
    duration: float = 0.0

    @classmethod
    def parse(cls, kind: str, text: str) -> FaultEvent:
        """Parse DEVICE@SECONDS, followed by :SECONDS for the duration if the fault lasts. Raises DriverError if it is
        invalid.
        """
        match = EVENT_PATTERN.fullmatch(text)
        if match is None or (match[3] is not None) != (kind in LASTING_FAULTS):
            example = "lidar@20:3" if kind in LASTING_FAULTS else "lidar@20"
            raise DriverError(
                f"--{kind} {text}: expected the device (lidar or base) and seconds, for example {example}"
            )
        return cls(kind, match[1], float(match[2]), float(match[3] or 0.0))


@dataclass(frozen=True, slots=True)
class EmulatorSetup:
    """A robot in a world, and its faults.

    world         name of a world that comes with the package, a TOML file, or a World
    lidar, base   of `lidar_names` and `base_names`
    lidar_port, base_port  symbolic links to create
    drive         of DRIVES
    seed          of all random numbers
    mount         [x, y, heading] of the lidar on the robot
    noise         of the lidar's beams; rate, number of beams and limits of range are the lidar's own
    wheels        slip, noise and biases; rate and track are the base's own
    drop, insert, flip  probabilities of corruption for each byte from a device
    events        scheduled faults
    lidar_drift, base_drift  relative rate errors of the devices' clocks, parts per million; positive if fast
    truth         file for the true path in the TUM format, with wall-clock stamps
    report        file for the final report, as JSON

    Raises DriverError if a setting is invalid.
    """

    world: str | Path | World
    lidar: str = "rplidar-s1"
    base: str = "create2"
    lidar_port: Path = field(default_factory=lambda: default_ports() / "lidar")
    base_port: Path = field(default_factory=lambda: default_ports() / "base")
    drive: str = "path"
    seed: int = 0
    mount: tuple[float, float, float] = (0.1, 0.0, 0.0)
    noise: LidarModel = field(default_factory=LidarModel)
    wheels: WheelModel = field(default_factory=WheelModel)
    drop: float = 0.0
    insert: float = 0.0
    flip: float = 0.0
    events: tuple[FaultEvent, ...] = ()
    lidar_drift: float = 0.0
    base_drift: float = 0.0
    truth: Path | None = None
    report: Path | None = None

    def __post_init__(self) -> None:
        for what, name, names in (
            ("lidar", self.lidar, lidar_names()),
            ("base", self.base, base_names()),
            ("way to drive", self.drive, list(DRIVES)),
        ):
            if name not in names:
                raise DriverError(f"there is no {what} {name!r}; there are {', '.join(names)}")
        chances = (self.drop, self.insert, self.flip)
        if not all(0.0 <= chance <= 1.0 for chance in chances) or sum(chances) > 1.0:
            raise DriverError("the probabilities of corrupted bytes and their sum must lie between 0 and 1")
        if not all(abs(drift) <= MAX_CLOCK_DRIFT for drift in (self.lidar_drift, self.base_drift)):
            raise DriverError(f"clocks drift by at most {MAX_CLOCK_DRIFT:.0f} parts per million")
        if self.seed < 0:
            raise DriverError("the seed must not be negative")
        if any(
            event.kind == "fail" and not (event.device == "lidar" and "rplidar" in self.lidar) for event in self.events
        ):
            raise DriverError("only RPLIDARs have an internal error")
        if self.lidar_port.absolute() == self.base_port.absolute():
            raise DriverError(f"{self.lidar_port}: lidar and base must have different ports")


def default_ports() -> Path:
    """Return the default directory of the ports."""
    return Path(tempfile.gettempdir()) / "wclm-robot"
