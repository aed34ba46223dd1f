"""A scan of an emulated RPLIDAR under way, and its packets in the format of its mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lidars.records import Flags
from ..lidars.rplidar import dense, express, hq, standard, ultra, ultra_dense
from ..lidars.rplidar.answers import Answer
from ..lidars.rplidar.decoding import CAPSULES
from ..messages import Floats

NODES = 2e-3
"""Seconds of standard nodes that are made at a time; the first of them come so much late."""
QUALITY = 47
"""Of what came back."""


@dataclass(slots=True)
class Scanning:
    """A scan under way.

    answer   the format of its packets
    period   seconds between samples, on the lidar's own clock
    begun    when its first sample is due, on that clock
    samples  measured so far
    heads    (n,) radians clockwise of the head at the samples that are not sent yet, growing from turn to turn
    lags     (n,) radians by which their beams lag the head
    ranges   (n,) metres that they found; NaN where nothing came back
    packets  sent so far
    before   where the head was at the last sample that was sent, radians; None before the first
    """

    answer: int
    period: float
    begun: float
    samples: int
    heads: Floats
    lags: Floats
    ranges: Floats
    packets: int = 0
    before: float | None = None

    @property
    def in_packet(self) -> int:
        """Samples in what is made at a time."""
        if self.answer in CAPSULES:
            return CAPSULES[Answer(self.answer)].samples
        return hq.NODES if self.answer == Answer.HQ else max(2, round(NODES / self.period))


def encode(scan: Scanning, heads: Floats, ranges: Floats, lags: Floats, starts: Flags) -> bytes:
    """The packet with samples (n,), or n nodes; `scan` still has the sample after them.

    `heads`, `ranges` and `lags` as in `Scanning`; `starts` whether a revolution begins.
    """
    answer, first = scan.answer, scan.packets == 0
    head, row = heads[:1], ranges[None]
    qualities = np.where(np.isnan(ranges), 0, QUALITY)
    if answer == Answer.STANDARD:
        return standard.encode(heads - lags, ranges, qualities, starts)
    if answer == Answer.HQ:
        return hq.encode((heads - lags)[None], row, qualities[None], starts[None])
    if answer == Answer.EXPRESS:
        return express.encode(head, row, lags[None], reset=first)
    if answer == Answer.ULTRA:
        return ultra.encode(head, row, ahead=float(scan.ranges[len(ranges)]), reset=first)
    if answer == Answer.DENSE:
        return dense.encode(head, row, reset=first)
    return ultra_dense.encode(head, row, qualities[None], reset=first)


def lag_of(ranges: Floats) -> Floats:
    """Radians by which beams of these ranges (metres, infinite where nothing is) lag the head."""
    millimetres = np.round(np.minimum(ranges, 1e4) * 1e3).astype(np.int64)
    return np.asarray(np.radians(ultra.correction(millimetres)))


def lag_in_eighths(ranges: Floats) -> Floats:
    """The same as the express format tells it, in eighths of a degree."""
    return np.asarray(np.radians(np.round(np.degrees(lag_of(ranges)) * 8.0) / 8.0))
