"""The dense format, answer 0x85: 40 samples in 84 bytes, evenly spaced, in whole millimetres."""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..records import Records
from .capsules import CapsuleFormat, Returns, blank, millimetres, seal, whole_millimetres

LAYOUT = np.dtype([("sync", "u1", 2), ("angle", "<u2"), ("distances", "<u2", 40)])


def read(capsules: Records, following: Records) -> Returns:
    """The distances as they stand there."""
    return Returns(millimetres(capsules["distances"].astype(np.int64)))


FORMAT = CapsuleFormat(0x85, LAYOUT, 40, read)


def encode(heads: Floats, ranges: Floats, reset: bool = False) -> bytes:
    """Capsules (m,) with the head at `heads` (m,) radians clockwise at their beginning and `ranges` (m, 40) metres; NaN
    where nothing came back. `reset` marks the first capsule after a start.
    """
    capsules = blank(FORMAT, heads, reset)
    capsules["distances"] = whole_millimetres(ranges, 0xFFFF)
    return seal(capsules)
