"""A running scan of an emulated RPLIDAR, and its packets in the format of its mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lidars.measurements import Flags
from ..lidars.rplidar import dense, express, hq, standard, ultra, ultra_dense
from ..lidars.rplidar.decoding import CAPSULES
from ..lidars.rplidar.responses import ResponseType
from ..messages import Floats

BURST_DURATION = 2e-3
"""Seconds of standard nodes that are created at a time; the first of them are late by this much."""
RETURN_QUALITY = 47
"""Quality of samples with a return."""


@dataclass(slots=True)
class ScanInProgress:
    """A scan under way.

    response_type  format of its packets
    period   seconds between samples, on the lidar's own clock
    start    time at which its first sample is due, on that clock
    samples  number of samples measured so far
    heads    (n,) radians clockwise of the head at the samples not sent yet, growing from turn to turn
    lags     (n,) radians by which their beams lag the head
    ranges   (n,) metres; NaN for no return
    packets  number of packets sent so far
    before   angle of the head at the last sample sent, radians; None before the first one
    """

    response_type: int
    period: float
    start: float
    samples: int
    heads: Floats
    lags: Floats
    ranges: Floats
    packets: int = 0
    before: float | None = None

    @property
    def in_packet(self) -> int:
        """Samples created at a time."""
        if self.response_type in CAPSULES:
            return CAPSULES[ResponseType(self.response_type)].samples
        return hq.NODES if self.response_type == ResponseType.HQ else max(2, round(BURST_DURATION / self.period))


def encode(scan: ScanInProgress, heads: Floats, ranges: Floats, lags: Floats, starts: Flags) -> bytes:
    """Encode the packet with samples (n,), or n nodes; `scan` still has the sample after them.

    `heads`, `ranges` and `lags` as in `ScanInProgress`; `starts` is True where a revolution begins.
    """
    response_type, first = scan.response_type, scan.packets == 0
    head, row = heads[:1], ranges[None]
    qualities = np.where(np.isnan(ranges), 0, RETURN_QUALITY)
    if response_type == ResponseType.STANDARD:
        return standard.encode(heads - lags, ranges, qualities, starts)
    if response_type == ResponseType.HQ:
        return hq.encode((heads - lags)[None], row, qualities[None], starts[None])
    if response_type == ResponseType.EXPRESS:
        return express.encode(head, row, lags[None], reset=first)
    if response_type == ResponseType.ULTRA:
        return ultra.encode(head, row, ahead=float(scan.ranges[len(ranges)]), reset=first)
    if response_type == ResponseType.DENSE:
        return dense.encode(head, row, reset=first)
    return ultra_dense.encode(head, row, qualities[None], reset=first)


def beam_lag(ranges: Floats) -> Floats:
    """Return the radians by which beams lag the head, for ranges in metres, infinite for no return."""
    millimetres = np.round(np.minimum(ranges, 1e4) * 1e3).astype(np.int64)
    return np.asarray(np.radians(ultra.correction(millimetres)))


def quantised_beam_lag(ranges: Floats) -> Floats:
    """Return the lag as the express format stores it, in multiples of an eighth of a degree."""
    return np.asarray(np.radians(np.round(np.degrees(beam_lag(ranges)) * 8.0) / 8.0))
