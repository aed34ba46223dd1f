"""Measurements in SCIP 2.0: one reply a scan, counter-clockwise, with the device's clock."""

from __future__ import annotations

import numpy as np

from ..messages import Floats
from .measurements import NO_MEASUREMENTS, NO_QUALITY, PACKET, SAMPLE, Bytes, DecoderCounters, Measurements
from .scip import (
    DATA,
    LINE_LENGTH,
    OK,
    MeasureRequest,
    Parameters,
    Reply,
    ReplyParser,
    checksum,
    decode_values,
    encode_values,
    parse_clock,
)

CLOCK_WRAP = 1 << 24
"""Milliseconds after which the device's clock begins again."""
DAMAGED = 0xFF
"""Stands in for the characters of damaged lines; no value has it."""


class ScipDecoder:
    """Decodes the replies to one request for measurements, as a `Decoder`; each is one whole scan.

    parameters  of the device
    request     what was asked
    baud        of the port, bits a second; infinite on USB

    A damaged line costs the measurements in it, which become NaN; a damaged echo, clock or number of lines costs the
    scan. Replies to other requests are passed over, as their bytes are by the counters.
    """

    def __init__(self, parameters: Parameters, request: MeasureRequest, baud: float = np.inf) -> None:
        self.parameters, self.request, self.counters = parameters, request, DecoderCounters()
        self._reader = ReplyParser()
        self._clock: int | None = None  # milliseconds, unwrapped
        self._intact = False  # the last reply was taken
        middle = request.first + np.arange(request.count) * request.cluster + 0.5 * (request.cluster - 1)
        self._angles = (middle - parameters.front) * (2.0 * np.pi / parameters.steps)
        bytes_sent = len(encode(np.zeros(request.count), request, 0, 0))
        self._offsets = (middle - request.last) * parameters.step_period - bytes_sent * 10.0 / baud

    def feed(self, data: bytes) -> Measurements:
        """The measurements of the scans that these bytes complete."""
        replies = self._reader.feed(data)
        self.counters.bytes += len(data)
        skipped = self._reader.bytes_skipped
        parts: list[Measurements] = []
        for reply in replies:
            scan = self._scan(reply, len(parts))
            self._intact = scan is not None
            if scan is not None:
                parts.append(scan)
        self.counters.bytes_skipped += self._reader.bytes_skipped - skipped
        if not parts:
            return NO_MEASUREMENTS
        self.counters.packets += len(parts)
        samples = np.concatenate([part.samples for part in parts])
        self.counters.samples += len(samples)
        return Measurements(samples, np.concatenate([part.packets for part in parts]))

    def _scan(self, reply: Reply, row: int) -> Measurements | None:
        """The scan in a reply, as packet number `row`; None where it holds none."""
        if (
            not self._is_own_echo(reply.echo)
            or reply.status != (DATA if self.request.continuous else OK)
            or not reply.lines
        ):
            if reply.status != OK:  # which is what the first reply to a request that goes on says
                self.counters.bytes_skipped += len(reply.packet())
            return None
        clock = parse_clock(reply.lines[0])
        characters = self._characters(reply.lines[1:])
        if clock is None or characters is None:
            self.counters.checksum_failures += 1
            self.counters.bytes_skipped += len(reply.packet())
            return None
        values, good = decode_values(characters, self.request.width)
        ranges = values / 1e3
        within = good & (ranges >= self.parameters.range_min) & (ranges <= self.parameters.range_max)
        samples = np.zeros(len(values), dtype=SAMPLE)
        samples["angle"], samples["range"] = self._angles, np.where(within, ranges, np.nan)
        samples["quality"] = NO_QUALITY
        samples["start"][0] = True
        samples["offset"], samples["packet"] = self._offsets, row
        packet = np.array([(reply.end, self._unwrapped(clock) / 1e3, self._intact)], dtype=PACKET)
        return Measurements(samples, packet)

    def _is_own_echo(self, echo: bytes) -> bool:
        """Whether an echo is that of the request, whatever the number of scans that remain."""
        echo_prefix, rest = echo[: len(self.request.echo_prefix)], echo[len(self.request.echo_prefix) :]
        return echo_prefix == self.request.echo_prefix and (
            len(rest) == 2 and rest.isdigit() if self.request.continuous else not rest
        )

    def _characters(self, lines: tuple[bytes, ...]) -> Bytes | None:
        """The characters of all values, DAMAGED in the place of damaged lines; None where there are not as many lines
        as there should be.
        """
        total = self.request.count * self.request.width
        if len(lines) != -(-total // LINE_LENGTH):
            return None
        characters = np.full(total, DAMAGED, dtype=np.uint8)
        for i, line in enumerate(lines):
            part = characters[i * LINE_LENGTH : (i + 1) * LINE_LENGTH]
            if len(line) == len(part) + 1 and checksum(line[:-1]) == line[-1:]:
                part[:] = np.frombuffer(line, np.uint8, len(part))
            else:
                self.counters.checksum_failures += 1
        return characters

    def _unwrapped(self, clock: int) -> int:
        """Milliseconds counted on from the last scan's."""
        self._clock = clock if self._clock is None else self._clock + (clock - self._clock) % CLOCK_WRAP
        return self._clock


def encode(ranges: Floats, request: MeasureRequest, clock: int, remaining: int = 0) -> bytes:
    """The reply with one scan: `ranges` (n,) metres (NaN where nothing came back, which is told as 0), n =
    request.count; the device's `clock` in milliseconds; how many scans remain of those asked for, 0 where they are
    without end.
    """
    max_value = (1 << 6 * request.width) - 1
    values = np.clip(np.round(np.nan_to_num(ranges, posinf=0.0) * 1e3), 0, max_value).astype(np.int64)
    text = encode_values(values, request.width)
    time = encode_values(np.array([clock % CLOCK_WRAP]), 4)
    lines = [time, *(text[i : i + LINE_LENGTH] for i in range(0, len(text), LINE_LENGTH))]
    echo = request.echo_prefix + (b"%02d" % remaining if request.continuous else b"")
    status = DATA if request.continuous else OK
    return Reply(echo, status, tuple(line + checksum(line) for line in lines), 0).packet()
