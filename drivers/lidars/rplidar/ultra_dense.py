"""The ultra-dense format, response type 0x86: 64 samples with quality in 170 bytes, evenly spaced.

A sample has 20 bits. The lowest two select one of four scales: at larger distances the steps are coarser and fewer bits
remain for the quality.
"""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..measurements import Integers, StructuredArray
from .capsules import CapsuleFormat, CapsuleReturns, add_checksums, new_capsules, to_metres, to_millimetres

CABIN = np.dtype([("low", "<u2", 2), ("high", "u1")])
LAYOUT = np.dtype([("sync", "u1", 2), ("timestamp", "<u4"), ("status", "<u2"), ("angle", "<u2"), ("cabins", CABIN, 32)])

# by scale: bits of the distance, millimetres per step, distance of step 0, low bits dropped from the quality
BITS = np.array([10, 11, 12, 13])
STEP = np.array([2, 3, 4, 5])
BASE = np.array([0, 2046, 8187, 24567])
SHORTENED = np.array([0, 1, 2, 3])
MAX_DISTANCE = int(BASE[3] + STEP[3] * ((1 << BITS[3]) - 1))


def unpack_words(words: Integers) -> tuple[Integers, Integers]:
    """Return distances in millimetres and qualities of words of 20 bits, of the same shape."""
    scale = words & 3
    body = words >> 2
    distances = (body & ((1 << BITS) - 1)[scale]) * STEP[scale] + BASE[scale]
    return distances, (body >> BITS[scale]) << SHORTENED[scale]


def pack_words(distances: Integers, qualities: Integers) -> Integers:
    """Return words of 20 bits in the finest possible scale; distances in millimetres, qualities 0 to 255."""
    scale = np.searchsorted(BASE[1:] - 1, distances, side="left")
    steps = np.clip((distances - BASE[scale] + STEP[scale] // 2) // STEP[scale], 0, ((1 << BITS) - 1)[scale])
    return np.asarray(scale | (steps << 2) | ((qualities >> SHORTENED[scale]) << (BITS[scale] + 2)))


def decode(capsules: StructuredArray, following: StructuredArray) -> CapsuleReturns:
    """Decode capsules (m,): two words of 20 bits per cabin, their highest four bits in its last byte."""
    cabins = capsules["cabins"]
    high = cabins["high"].astype(np.int64)
    words = cabins["low"].astype(np.int64) | (np.stack([high & 0x0F, high >> 4], axis=-1) << 16)
    distances, qualities = unpack_words(words.reshape(len(capsules), -1))
    return CapsuleReturns(to_metres(distances), qualities)


FORMAT = CapsuleFormat(0x86, LAYOUT, 64, decode)


def encode(heads: Floats, ranges: Floats, qualities: Integers, timestamp: int = 0, reset: bool = False) -> bytes:
    """Encode capsules (m,), all with one device timestamp.

    heads      (m,) radians clockwise of the head at the capsules' beginning
    ranges     (m, 64) metres; NaN for no return
    qualities  (m, 64) 0 to 255
    reset      marks the first capsule after a start
    """
    capsules = new_capsules(FORMAT, heads, reset)
    capsules["timestamp"] = timestamp
    words = pack_words(to_millimetres(ranges, MAX_DISTANCE), qualities.astype(np.int64))
    capsules["cabins"]["low"] = (words & 0xFFFF).reshape(-1, 32, 2)
    capsules["cabins"]["high"] = (words[:, ::2] >> 16) | ((words[:, 1::2] >> 16) << 4)
    return add_checksums(capsules)
