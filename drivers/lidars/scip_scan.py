"""Measurements in SCIP 2.0: one reply per scan, counter-clockwise, with the device's clock."""

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
"""Milliseconds after which the device's clock restarts at zero."""
DAMAGED = 0xFF
"""Substitute for the characters of damaged lines; no value contains it."""


class ScipDecoder:
    """`Decoder` of the replies to one measurement request; each reply is a whole scan.

    parameters  of the device
    request     that was sent
    baud        of the port, bits per second; infinite on USB

    A damaged line turns its measurements into NaN; a damaged echo, clock or number of lines loses the scan. Replies to
    other requests are counted as skipped bytes.
    """

    def __init__(self, parameters: Parameters, request: MeasureRequest, baud: float = np.inf) -> None:
        self.parameters, self.request, self.counters = parameters, request, DecoderCounters()
        self._reader = ReplyParser()
        self._clock: int | None = None  # milliseconds, unwrapped
        self._intact = False  # the last reply contained a scan
        middle = request.first + np.arange(request.count) * request.cluster + 0.5 * (request.cluster - 1)
        self._angles = (middle - parameters.front) * (2.0 * np.pi / parameters.steps)
        bytes_sent = len(encode(np.zeros(request.count), request, 0, 0))
        self._offsets = (middle - request.last) * parameters.step_period - bytes_sent * 10.0 / baud

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements of the scans that these bytes complete."""
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
        """Return the scan in a reply, as packet number `row`; None if it contains none."""
        if (
            not self._is_own_echo(reply.echo)
            or reply.status != (DATA if self.request.continuous else OK)
            or not reply.lines
        ):
            if reply.status != OK:  # the first reply to a continuous request has status OK and no data
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
        """Return whether an echo is that of the request, for any number of remaining scans."""
        echo_prefix, rest = echo[: len(self.request.echo_prefix)], echo[len(self.request.echo_prefix) :]
        return echo_prefix == self.request.echo_prefix and (
            len(rest) == 2 and rest.isdigit() if self.request.continuous else not rest
        )

    def _characters(self, lines: tuple[bytes, ...]) -> Bytes | None:
        """Return the characters of all values, with DAMAGED in place of damaged lines; None if the number of lines is
        wrong.
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
        """Return milliseconds that continue from the last scan's time."""
        self._clock = clock if self._clock is None else self._clock + (clock - self._clock) % CLOCK_WRAP
        return self._clock


def encode(ranges: Floats, request: MeasureRequest, clock: int, remaining: int = 0) -> bytes:
    """Encode the reply with one scan.

    ranges     (request.count,) metres; NaN for no return, encoded as 0
    clock      milliseconds on the device's clock
    remaining  number of scans still to come, 0 if the request has no limit
    """
    max_value = (1 << 6 * request.width) - 1
    values = np.clip(np.round(np.nan_to_num(ranges, posinf=0.0) * 1e3), 0, max_value).astype(np.int64)
    text = encode_values(values, request.width)
    time = encode_values(np.array([clock % CLOCK_WRAP]), 4)
    lines = [time, *(text[i : i + LINE_LENGTH] for i in range(0, len(text), LINE_LENGTH))]
    echo = request.echo_prefix + (b"%02d" % remaining if request.continuous else b"")
    status = DATA if request.continuous else OK
    return Reply(echo, status, tuple(line + checksum(line) for line in lines), 0).packet()
