"""The first express format, response type 0x82: 32 samples in 84 bytes, each with its own angle correction."""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..measurements import StructuredArray
from .capsules import CapsuleFormat, CapsuleReturns, add_checksums, new_capsules, to_metres, to_millimetres

CABIN = np.dtype([("distances", "<u2", 2), ("corrections", "u1")])
LAYOUT = np.dtype([("sync", "u1", 2), ("angle", "<u2"), ("cabins", CABIN, 16)])
MAX_DISTANCE = 0x3FFF
"""Millimetres; the largest value of 14 bits."""


def decode(capsules: StructuredArray, following: StructuredArray) -> CapsuleReturns:
    """Decode capsules (m,): distances in millimetres, and angle corrections in 1/8 degree.

    A sample has 14 bits of distance and six bits of correction, four of them in a byte of their own. The corrections
    are unsigned, 0 to 7.875 degrees: those of real capsules agree with the geometry of the optics.
    """
    cabins = capsules["cabins"]
    words = cabins["distances"].astype(np.int64)  # (m, 16, 2)
    low = cabins["corrections"].astype(np.int64)
    nibbles = np.stack([low & 0x0F, low >> 4], axis=-1)
    eighths = nibbles | ((words & 3) << 4)
    distances = (words >> 2).reshape(len(capsules), -1)
    return CapsuleReturns(to_metres(distances), None, eighths.reshape(len(capsules), -1) / 8.0)


FORMAT = CapsuleFormat(0x82, LAYOUT, 32, decode)


def encode(heads: Floats, ranges: Floats, corrections: Floats | None = None, reset: bool = False) -> bytes:
    """Encode capsules (m,).

    heads        (m,) radians clockwise of the head at the capsules' beginning
    ranges       (m, 32) metres; NaN for no return
    corrections  (m, 32) radians by which each beam lags the head, 0 to 7.875 degrees
    reset        marks the first capsule after a start
    """
    capsules = new_capsules(FORMAT, heads, reset)
    distances = to_millimetres(ranges, MAX_DISTANCE)
    lag = np.zeros(ranges.shape) if corrections is None else corrections
    eighths = np.clip(np.round(np.degrees(lag) * 8.0), 0, 63).astype(np.int64)
    capsules["cabins"]["distances"] = ((distances << 2) | (eighths >> 4)).reshape(-1, 16, 2)
    capsules["cabins"]["corrections"] = (eighths[:, ::2] & 0x0F) | ((eighths[:, 1::2] & 0x0F) << 4)
    return add_checksums(capsules)
