"""What all lidars have in common: bytes to measurements, to stamps, to scans, and the counts of all that."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

from ..lidars.records import Decoder
from ..lidars.revolutions import RevolutionAssembler
from ..messages import Message
from ..transport import Received, Transport
from .device import Device
from .stamping import Onward, PacketStamper


class Stream(NamedTuple):
    """How a lidar that was started is understood.

    decoder  of its format
    period, size  of its packets: seconds and bytes
    limits   metres: the nearest and the farthest range it states
    whole_packets  whether a packet is a scan
    rest     bytes of the stream that came with the answer that began it
    """

    decoder: Decoder
    period: float
    size: int
    limits: tuple[float, float]
    whole_packets: bool = False
    rest: Received = Received(b"", 0.0)


class Lidar(Device):
    """A lidar with the options of a spec (see `specs`)."""

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__()
        self.wanted_serial = options.get("serial", "")
        self._options = options
        self._past: Counter[str] = Counter()  # of earlier connections
        self._onward = Onward()
        self._stream: Stream | None = None
        self._rest: Received | None = None

    @property
    def units(self) -> int:
        """Samples of undamaged packets."""
        return self._past["samples"] + (self._stream.decoder.counters.samples if self._stream else 0)

    def start(self, transport: Transport, baud: int) -> None:
        """Identify it, make it measure, and begin a new stream."""
        self._past = Counter(self.counters())
        self._stream = None
        self.identify(transport, baud)
        stream = self._begin(transport, baud)
        range_min, range_max = stream.limits
        self._assembler = RevolutionAssembler(
            self._options.get("range_min", range_min),
            self._options.get("range_max", range_max),
            self._options.get("mount"),
            self._options.get("upside_down", False),
            stream.whole_packets,
        )
        self._stamper = PacketStamper(stream.period, stream.size)
        self._stream, self._rest = stream, stream.rest

    def feed(self, received: Received) -> list[Message]:
        """The scans that bytes complete."""
        assert self._stream is not None
        rest, self._rest = self._rest, None
        messages = self.feed(rest) if rest is not None and rest.data else []
        if received.data:
            self._stamper.note(received)
            measurements = self._stream.decoder.feed(received.data)
            stamps = self._onward.stamps(self._stamper.stamps(measurements))
            messages += self._assembler.add(measurements, stamps)
        return messages

    def counters(self) -> dict[str, int]:
        """Of the decoders, the revolutions and the clocks."""
        counts = Counter(self._past)
        if self._stream is not None:
            counts.update(self._stream.decoder.counters.as_dict())
            del counts["bytes"]  # the session counts them
            counts.update(
                revolutions=self._assembler.counters.complete,
                incomplete_revolutions=self._assembler.counters.incomplete,
            )
            counts.update(self._stamper.counters())
        return dict(counts)

    @abstractmethod
    def _begin(self, transport: Transport, baud: int) -> Stream:
        """Make the identified lidar measure."""
