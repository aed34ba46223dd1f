"""The dense format, response type 0x85: 40 samples in 84 bytes, evenly spaced, in whole millimetres."""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..measurements import StructuredArray
from .capsules import CapsuleFormat, CapsuleReturns, add_checksums, new_capsules, to_metres, to_millimetres

LAYOUT = np.dtype([("sync", "u1", 2), ("angle", "<u2"), ("distances", "<u2", 40)])


def decode(capsules: StructuredArray, following: StructuredArray) -> CapsuleReturns:
    """Decode capsules (m,); the distances are stored directly."""
    return CapsuleReturns(to_metres(capsules["distances"].astype(np.int64)))


FORMAT = CapsuleFormat(0x85, LAYOUT, 40, decode)


def encode(heads: Floats, ranges: Floats, reset: bool = False) -> bytes:
    """Encode capsules (m,).

    heads   (m,) radians clockwise of the head at the capsules' beginning
    ranges  (m, 40) metres; NaN for no return
    reset   marks the first capsule after a start
    """
    capsules = new_capsules(FORMAT, heads, reset)
    capsules["distances"] = to_millimetres(ranges, 0xFFFF)
    return add_checksums(capsules)
