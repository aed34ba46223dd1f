"""Common part of all lidars: from bytes to measurements, stamps and scans, with all counts."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from ..lidars.measurements import Decoder, Flags, StructuredArray
from ..lidars.revolutions import RevolutionAssembler
from ..messages import Message
from ..transport import Received, Transport
from .device import Device
from .packet_stamper import MonotonicStamps, PacketStamper

if TYPE_CHECKING:
    from .device_spec import Option


class LidarStream(NamedTuple):
    """The data stream of a started lidar.

    decoder        of its format
    period, size   of its packets: seconds and bytes
    limits         metres: minimum and maximum range stated by the device
    whole_packets  True if each packet is a scan
    find_strays    returns which samples of a revolution are no surface, if the lidar sends such
    remainder      bytes of the stream that arrived with the response that began it
    """

    decoder: Decoder
    period: float
    size: int
    limits: tuple[float, float]
    whole_packets: bool = False
    remainder: Received = Received(b"", 0.0)
    find_strays: Callable[[StructuredArray], Flags] | None = None


class LidarDevice(Device):
    """A lidar with the options of a device spec (see `device_spec`).

    A driver states `bauds`, and defines `identify`, `halt` and `start_stream`.

    own_options  options of a spec that only lidars of this kind have, of a driver in another package
    """

    own_options: ClassVar[Mapping[str, Option]] = {}

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__()
        if "baud" in options:
            self.bauds = (options["baud"],)
        self.required_serial = options.get("serial", "")
        self._options = options
        self._previous_counts: Counter[str] = Counter()  # counts of earlier connections
        self._monotonic = MonotonicStamps()
        self._stream: LidarStream | None = None
        self._remainder: Received | None = None

    @property
    def measurement_count(self) -> int:
        """Samples of undamaged packets."""
        return self._previous_counts["samples"] + (self._stream.decoder.counters.samples if self._stream else 0)

    def start(self, transport: Transport, baud: int) -> None:
        """Identify the lidar, make it measure, and begin a new stream."""
        self._previous_counts = Counter(self.counters())
        self._stream = None
        self.identify(transport, baud)
        stream = self.start_stream(transport, baud)
        range_min, range_max = stream.limits
        self._assembler = RevolutionAssembler(
            self._options.get("range_min", range_min),
            self._options.get("range_max", range_max),
            self._options.get("mount"),
            self._options.get("upside_down", False),
            stream.whole_packets,
            stream.find_strays if self._options.get("stray_filter", True) else None,
        )
        self._stamper = PacketStamper(stream.period, stream.size)
        self._stream, self._remainder = stream, stream.remainder

    def feed(self, received: Received) -> list[Message]:
        """Return the scans that the bytes complete."""
        assert self._stream is not None
        remainder, self._remainder = self._remainder, None
        messages = self.feed(remainder) if remainder is not None and remainder.data else []
        if received.data:
            self._stamper.add_chunk(received)
            measurements = self._stream.decoder.feed(received.data)
            for stamped, stamps in self._stamper.add(measurements):
                messages += self._assembler.add(stamped, self._monotonic.stamps(stamps))
        return messages

    def counters(self) -> dict[str, int]:
        """Return the counts of the decoders, the revolutions and the clocks."""
        counts = Counter(self._previous_counts)
        if self._stream is not None:
            counts.update(self._stream.decoder.counters.as_dict())
            del counts["bytes"]  # counted by the supervisor
            counts.update(
                revolutions=self._assembler.counters.complete,
                incomplete_revolutions=self._assembler.counters.incomplete,
            )
            if self._stream.find_strays is not None:
                counts.update(stray_points=self._assembler.counters.stray_points)
            counts.update(self._stamper.counters())
        return dict(counts)

    @abstractmethod
    def start_stream(self, transport: Transport, baud: int) -> LidarStream:
        """Make the identified lidar measure; return the stream of its measurements from now on."""
