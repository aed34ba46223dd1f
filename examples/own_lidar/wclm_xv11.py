"""Driver of the lidar of the Neato XV-11 vacuum cleaner, as a package of its own: `wclm live --lidar xv11:PORT`.

It sends packets of 22 bytes as long as its head turns, five turns a second, and accepts no commands. It was written
from public descriptions of the protocol, and tried on an emulated port only.
"""

import numpy as np

from drivers.devices.device import await_response
from drivers.devices.lidar import LidarDevice, LidarStream
from drivers.errors import NoResponseError
from drivers.lidars.framing import PacketFramer, PacketLayout
from drivers.lidars.measurements import PACKET, SAMPLE, DecoderCounters, Measurements
from drivers.transport import Transport

BAUD = 115200  # bits per second; a byte has 10 bits
LAYOUT = np.dtype(
    [("start", "u1"), ("index", "u1"), ("speed", "<u2"), ("readings", [("range", "<u2"), ("strength", "<u2")], 4),
     ("checksum", "<u2")]
)  # fmt: skip
START, FIRST_INDEX, PACKETS, READINGS = 0xFA, 0xA0, 90, 4  # a turn has 90 packets of 4 readings, one for each degree
NO_RETURN, MILLIMETRES = 0x8000, 0x3FFF  # bits of `range`: the reading is invalid; its value
SPEED_UNIT = 64.0  # of `speed`, per revolution a minute
TURN_DURATION = 0.2  # seconds, as usual; the clock is fitted to the real one
LIMITS = 0.06, 5.0  # metres


def checksums(packets: np.ndarray) -> np.ndarray:
    """Return the checksums (m,) of packets (m, 22) of bytes."""
    total = np.zeros(len(packets), np.int64)
    for word in np.ascontiguousarray(packets[:, :20]).view("<u2").T:
        total = (total << 1) + word
    return ((total & 0x7FFF) + (total >> 15)) & 0x7FFF


def is_packet(packets: np.ndarray) -> np.ndarray:
    """Return which packets (m, 22) of bytes that start rightly have a possible index and a right checksum."""
    index, stated = packets[:, 1].astype(int) - FIRST_INDEX, packets.view(LAYOUT)[:, 0]["checksum"]
    return (index >= 0) & (index < PACKETS) & (stated == checksums(packets))


class Xv11Decoder:
    """From bytes to measurements, see `drivers.lidars.measurements.Decoder`."""

    def __init__(self) -> None:
        self.counters = DecoderCounters()
        self._framer = PacketFramer(PacketLayout(LAYOUT.itemsize, ((0xFF, START),), is_packet), self.counters)

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        batch = self._framer.feed(data)
        packets = batch.data.view(LAYOUT)[:, 0]
        count, degree = len(packets), TURN_DURATION / 360.0
        angles = (packets["index"].astype(int) - FIRST_INDEX)[:, None] * READINGS + np.arange(READINGS)
        ranges = packets["readings"]["range"]
        samples = np.empty((count, READINGS), SAMPLE)
        samples["angle"] = np.radians((angles + 180) % 360 - 180)  # the head turns counter-clockwise
        samples["range"] = np.where(ranges & NO_RETURN, np.nan, (ranges & MILLIMETRES) / 1e3)
        samples["quality"] = np.minimum(packets["readings"]["strength"], 32767)
        samples["start"] = angles == 0
        # Seconds from the arrival of the packet's last byte: its transmission, and the readings after this one.
        samples["offset"] = -(LAYOUT.itemsize * 10.0 / BAUD + np.arange(READINGS - 1, -1, -1) * degree)
        samples["packet"] = np.arange(count)[:, None]
        carriers = np.empty(count, PACKET)
        carriers["end"], carriers["continuous"], carriers["device_time"] = batch.ends, batch.continuous, np.nan
        self.counters.samples += samples.size
        return Measurements(samples.ravel(), carriers)


class Xv11Device(LidarDevice):
    """The lidar at a port."""

    bauds = (BAUD,)

    def identify(self, transport: Transport, baud: int) -> None:
        """Listen for packets for a second; raises NoResponseError if there are none."""
        decoder = Xv11Decoder()

        def parse(data: bytes) -> bool | None:
            return True if len(decoder.feed(data)) else None

        if await_response(transport, parse, 1.0) is None:
            raise NoResponseError(transport.name, "no lidar of an XV-11 sends here; does its head turn?")
        self.identity = "Neato XV-11"

    def start_stream(self, transport: Transport, baud: int) -> LidarStream:
        """Read from now on; the lidar sends anyway."""
        return LidarStream(Xv11Decoder(), TURN_DURATION / PACKETS, LAYOUT.itemsize, LIMITS)

    def halt(self, transport: Transport) -> None:
        """Do nothing: the lidar accepts no commands."""
