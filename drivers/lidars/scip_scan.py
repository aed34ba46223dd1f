"""Measurements in SCIP 2.0: one reply per scan, counter-clockwise, with the device's clock.

A beam that hits an edge, glass or rain returns several echoes. Lidars that report them send those of a step one after
the other, the nearest first. One of them is used: a scan has one range for each beam.
"""

from __future__ import annotations

import numpy as np

from ..messages import Floats
from .measurements import NO_MEASUREMENTS, NO_QUALITY, PACKET, SAMPLE, Bytes, DecoderCounters, Integers, Measurements
from .scip import (
    DATA,
    ECHO,
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
    strip_checksum,
)

CLOCK_WRAP = 1 << 24
"""Milliseconds after which the device's clock restarts at zero."""
DAMAGED = 0xFF
"""Substitute for the characters of damaged lines; no value contains it."""
MAX_QUALITY = np.iinfo(SAMPLE["quality"]).max
"""Larger intensities are limited to it."""


class ScipDecoder:
    """`Decoder` of the replies to one measurement request; each reply is a whole scan.

    parameters  of the device
    request     that was sent
    baud        of the port, bits per second; infinite on USB
    strongest   if the request is for several echoes, which of them are used: the strongest, which needs intensities,
                or the farthest

    A damaged line turns its measurements into NaN; a damaged echo, clock or number of lines loses the scan, and with
    several echoes any damaged line does. Replies to other requests are counted as skipped bytes.
    """

    def __init__(
        self, parameters: Parameters, request: MeasureRequest, baud: float = np.inf, *, strongest: bool = False
    ) -> None:
        self.parameters, self.request, self.counters = parameters, request, DecoderCounters()
        self._strongest = strongest
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
        values = self._echoes(reply.lines[1:]) if self.request.echoes else self._values(reply.lines[1:])
        if clock is None or values is None:
            self.counters.checksum_failures += 1
            self.counters.bytes_skipped += len(reply.packet())
            return None
        ranges, intensities = values
        samples = np.zeros(len(ranges), dtype=SAMPLE)
        samples["angle"], samples["range"] = self._angles, ranges
        samples["quality"] = intensities
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

    def _values(self, lines: tuple[bytes, ...]) -> tuple[Floats, Integers] | None:
        """Return ranges in metres, NaN for no return, and intensities, from lines with one echo per step."""
        characters = self._characters(lines)
        return None if characters is None else self._decoded(characters)

    def _echoes(self, lines: tuple[bytes, ...]) -> tuple[Floats, Integers] | None:
        """Return the same from lines with several echoes, of which one is chosen for each step."""
        if any(strip_checksum(line) is None for line in lines):  # what follows cannot be assigned to steps
            return None
        text = np.frombuffer(b"".join(line[:-1] for line in lines), np.uint8)
        values, size = np.flatnonzero(text != ECHO), self.request.characters
        if not len(values) or len(values) % size:
            return None
        begins = values[::size]
        more = text[begins - 1] == ECHO  # the character before the first one is the last
        more[0] = False
        steps = np.cumsum(~more) - 1
        separators = np.count_nonzero(more)
        if steps[-1] + 1 != self.request.count or separators != len(text) - len(values):
            return None
        ranges, intensities = self._decoded(text[values])
        rank = intensities if self._strongest else np.arange(len(ranges))
        order = np.lexsort((rank, ~np.isnan(ranges), steps))
        chosen = order[np.flatnonzero(np.diff(steps[order], append=self.request.count))]
        return ranges[chosen], intensities[chosen]

    def _decoded(self, characters: Bytes) -> tuple[Floats, Integers]:
        """Return the ranges (n,) in metres, NaN for no return, and the intensities (n,) of n values."""
        values, good = decode_values(characters, self.request.width)
        intensities = np.full(len(values), NO_QUALITY)
        if self.request.intensity:
            good, intensities = good[::2] & good[1::2], np.minimum(values[1::2], MAX_QUALITY)
            values, intensities = values[::2], np.where(good, intensities, 0)
        ranges = values / 1e3
        within = good & (ranges >= self.parameters.range_min) & (ranges <= self.parameters.range_max)
        return np.where(within, ranges, np.nan), intensities

    def _characters(self, lines: tuple[bytes, ...]) -> Bytes | None:
        """Return the characters of all values, with DAMAGED in place of damaged lines; None if the number of lines is
        wrong.
        """
        total = self.request.count * self.request.characters
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


def encode(
    ranges: Floats,
    request: MeasureRequest,
    clock: int,
    remaining: int = 0,
    *,
    intensities: Floats | None = None,
    behind: Floats | None = None,
) -> bytes:
    """Encode the reply with one scan.

    ranges       (request.count,) metres; NaN for no return, encoded as 0
    clock        milliseconds on the device's clock
    remaining    number of scans still to come, 0 if the request has no limit
    intensities  (request.count,) if the request is for intensities; default zero. Those of all echoes of a step
    behind       (request.count,) metres of a second echo if the request is for several; NaN for none
    """
    first, second = _encode_ranges(ranges, intensities, request), []
    if request.echoes and behind is not None:
        second = [
            b"" if np.isnan(metres) else bytes([ECHO]) + text
            for metres, text in zip(behind, _encode_ranges(behind, intensities, request), strict=True)
        ]
    text = b"".join(part for step in zip(first, second, strict=True) for part in step) if second else b"".join(first)
    time = encode_values(np.array([clock % CLOCK_WRAP]), 4)
    lines = [time, *(text[i : i + LINE_LENGTH] for i in range(0, len(text), LINE_LENGTH))]
    echo = request.echo_prefix + (b"%02d" % remaining if request.continuous else b"")
    status = DATA if request.continuous else OK
    return Reply(echo, status, tuple(line + checksum(line) for line in lines), 0).packet()


def _encode_ranges(ranges: Floats, intensities: Floats | None, request: MeasureRequest) -> list[bytes]:
    """Return the characters of each range, with its intensity if the request is for that."""
    max_value, size = (1 << 6 * request.width) - 1, request.characters
    values = np.clip(np.round(np.nan_to_num(ranges, posinf=0.0) * 1e3), 0, max_value).astype(np.int64)
    if request.intensity:
        strengths = np.zeros(len(values)) if intensities is None else np.clip(intensities, 0, max_value)
        values = np.column_stack([values, strengths.astype(np.int64)]).ravel()
    text = encode_values(values, request.width)
    return [text[i : i + size] for i in range(0, len(text), size)]
