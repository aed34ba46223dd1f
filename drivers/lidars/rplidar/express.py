"""The first express format, answer 0x82: 32 samples in 84 bytes, each with its own correction of the angle."""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..measurements import StructuredArray
from .capsules import CapsuleFormat, CapsuleReturns, add_checksums, new_capsules, to_metres, to_millimetres

CABIN = np.dtype([("distances", "<u2", 2), ("corrections", "u1")])
LAYOUT = np.dtype([("sync", "u1", 2), ("angle", "<u2"), ("cabins", CABIN, 16)])
MAX_DISTANCE = 0x3FFF
"""Millimetres; what 14 bits hold."""


def decode(capsules: StructuredArray, following: StructuredArray) -> CapsuleReturns:
    """Distances in millimetres above two bits; with four more bits for each sample, corrections in 1/8 degree.

    The corrections are unsigned, 0 to 7.875 degrees: real capsules have them as the optics' geometry predicts.
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
    """Capsules (m,) with the head at `heads` (m,) radians clockwise at their beginning, `ranges` (m, 32) metres (NaN
    where nothing came back), and `corrections` (m, 32) radians by which each beam lags the head, 0 to 7.875 degrees.
    """
    capsules = new_capsules(FORMAT, heads, reset)
    distances = to_millimetres(ranges, MAX_DISTANCE)
    lag = np.zeros(ranges.shape) if corrections is None else corrections
    eighths = np.clip(np.round(np.degrees(lag) * 8.0), 0, 63).astype(np.int64)
    capsules["cabins"]["distances"] = ((distances << 2) | (eighths >> 4)).reshape(-1, 16, 2)
    capsules["cabins"]["corrections"] = (eighths[:, ::2] & 0x0F) | ((eighths[:, 1::2] & 0x0F) << 4)
    return add_checksums(capsules)
