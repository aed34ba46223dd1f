"""The common form of the measurements of every lidar."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..immutable import immutable
from ..messages import Floats

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
StructuredArray = NDArray[Any]
"""A structured array; its fields are stated where it is used."""

NO_QUALITY = -1
"""Quality of a measurement whose format contains none."""

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

angle    radians in the lidar's frame, counter-clockwise from the device's direction zero, in [-pi, pi]. Lidars that
         turn clockwise (all RPLIDARs, LD06) give decreasing angles
range    metres; NaN if the beam returned nothing valid
quality  as reported by the device, higher is better; NO_QUALITY if it reports none
start    the first of a revolution
offset   seconds from the packet's arrival, when its last byte was received, to the measurement; negative
packet   row in the packets of the same `Measurements`
"""

PACKET = np.dtype([("end", np.int64), ("device_time", np.float64), ("continuous", np.bool_)])
"""The packet that carried the measurements.

end          bytes fed to the decoder up to the packet's last one, from which its arrival time follows
device_time  seconds on the device's clock, unwrapped; NaN if the packet carries none
continuous   True if nothing has been lost between the previous packet and this one
"""


@immutable
class Measurements:
    """Measurements that a chunk of bytes completed: `samples` (n,) of SAMPLE in measuring order, `packets` (m,) of
    PACKET.
    """

    samples: StructuredArray
    packets: StructuredArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def stamps(self, arrivals: Floats) -> Floats:
        """Return the stamps (n,) of the samples in seconds, from the arrival times (m,) of the packets."""
        return np.asarray(arrivals[self.samples["packet"]] + self.samples["offset"])


NO_MEASUREMENTS = Measurements(np.empty(0, SAMPLE), np.empty(0, PACKET))
"""Empty measurements."""


@dataclass(slots=True)
class DecoderCounters:
    """Counts of a decoder since it was created. Everything that is dropped is counted here.

    bytes              fed
    packets            found undamaged: nodes, capsules, blocks
    samples            returned
    bytes_skipped      not part of any accepted packet
    checksum_failures  times that a packet was due and its marks or checksum were wrong, or it could not follow the
                       previous one
    discarded          undamaged packets without samples: their successor was lost, or the device reports a reset of its
                       angle
    implausible        samples of undamaged packets discarded because no lidar's head turns like that
    """

    bytes: int = 0
    packets: int = 0
    samples: int = 0
    bytes_skipped: int = 0
    checksum_failures: int = 0
    discarded: int = 0
    implausible: int = 0

    def as_dict(self) -> dict[str, int]:
        """Return all counts by name."""
        return asdict(self)


class Decoder(Protocol):
    """Conversion of bytes to measurements.

    It accepts any bytes in any chunks, never raises, and never holds more than a few packets. The samples do not depend
    on the chunks.
    """

    counters: DecoderCounters

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        ...


def to_counter_clockwise(clockwise: Floats) -> Floats:
    """Convert angles that count clockwise to REP-103 angles; radians, wrapped to [-pi, pi]."""
    return np.asarray(np.mod(np.pi - clockwise, 2.0 * np.pi) - np.pi)
