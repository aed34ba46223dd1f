"""The one form in which the measurements of every lidar come out of its decoder."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..messages import Floats

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
StructuredArray = NDArray[Any]
"""A structured array; its fields are said where it is used."""

NO_QUALITY = -1
"""Quality of a measurement whose format tells none."""

SAMPLE = np.dtype(
    [
        ("angle", np.float64),
        ("range", np.float64),
        ("quality", np.int16),
        ("start", np.bool_),
        ("offset", np.float64),
        ("packet", np.int32),
    ]
)
"""One measurement.

angle    radians in the lidar's frame, counter-clockwise from the direction the device calls zero, in [-pi, pi]. What
         turns clockwise (all RPLIDARs, LD06) gives decreasing angles
range    metres; NaN where the beam returned nothing valid
quality  as the device tells it, higher is better; NO_QUALITY where it tells nothing
start    the first of a revolution
offset   seconds from the packet's arrival, when its last byte came in, to the measurement; negative
packet   row in the packets of the same `Measurements`
"""

PACKET = np.dtype([("end", np.int64), ("device_time", np.float64), ("continuous", np.bool_)])
"""What carried the measurements.

end          bytes fed to the decoder up to the packet's last one, so that its arrival follows from those of the chunks
device_time  seconds on the device's clock, unwrapped; NaN where the packet carries none
continuous   nothing has been lost between the packet before and this one
"""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """What a chunk of bytes completed: `samples` (n,) of SAMPLE in the order measured, `packets` (m,) of PACKET."""

    samples: StructuredArray
    packets: StructuredArray

    def __len__(self) -> int:
        """The number of samples."""
        return len(self.samples)

    def stamps(self, arrivals: Floats) -> Floats:
        """When the samples were measured (n,), in seconds, from when the packets (m,) arrived."""
        return np.asarray(arrivals[self.samples["packet"]] + self.samples["offset"])


NO_MEASUREMENTS = Measurements(np.empty(0, SAMPLE), np.empty(0, PACKET))
"""No measurements."""


@dataclass(slots=True)
class DecoderCounters:
    """What a decoder has seen since it was made. Nothing is dropped without being counted here.

    bytes              fed
    packets            found undamaged: nodes, capsules, blocks
    samples            given out
    bytes_skipped      that belong to no packet that was believed
    checksum_failures  times that a packet was due and its marks or checksum were wrong, or it could not follow the last
    discarded          undamaged packets that gave nothing: their successor was lost, or the device says that its angle
                       was reset
    implausible        samples of undamaged packets left out because no head of a lidar turns like that
    """

    bytes: int = 0
    packets: int = 0
    samples: int = 0
    bytes_skipped: int = 0
    checksum_failures: int = 0
    discarded: int = 0
    implausible: int = 0

    def as_dict(self) -> dict[str, int]:
        """All counts by name."""
        return asdict(self)


class Decoder(Protocol):
    """Bytes in, measurements out. Any bytes are taken, in any chunks; none make it raise, or hold more than a few
    packets. The samples are the same whatever the chunks.
    """

    counters: DecoderCounters

    def feed(self, data: bytes) -> Measurements:
        """The measurements that these bytes complete."""
        ...


def to_counter_clockwise(clockwise: Floats) -> Floats:
    """Angles that count clockwise as REP-103 angles; radians, wrapped to [-pi, pi]."""
    return np.asarray(np.mod(np.pi - clockwise, 2.0 * np.pi) - np.pi)
