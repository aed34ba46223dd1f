"""The ultra format, response type 0x84 (Boost, Sensitivity, Stability): 96 samples in 132 bytes.

A cabin of 32 bits holds the distance of its first sample (`major`, 12 bits on a scale that coarsens with distance) and
two small differences: of the second sample to the first, and of the third sample to the next cabin's first.
"""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..measurements import Integers, StructuredArray
from .capsules import CapsuleFormat, CapsuleReturns, add_checksums, new_capsules, to_metres, to_millimetres

LAYOUT = np.dtype([("sync", "u1", 2), ("angle", "<u2"), ("cabins", "<u4", 32)])

# by level: the first major and its distance in millimetres; a step is 2^level millimetres
FIRST_MAJOR = np.array([0, 512, 1280, 1792, 3328])
FIRST_DISTANCE = np.array([0, 512, 2048, 4096, 16384])
MAX_DISTANCE = int(FIRST_DISTANCE[4] + ((0xFFF - FIRST_MAJOR[4]) << 4))
INVALID_DIFFERENCES = (-512, 511)
"""Differences that encode no return."""
NEAR_DISTANCE = 50
"""Millimetres; shorter distances are corrected by a constant angle."""


def decode_majors(majors: Integers) -> tuple[Integers, Integers]:
    """Return the distances in millimetres and the levels of majors."""
    level = np.searchsorted(FIRST_MAJOR, majors, side="right") - 1
    return FIRST_DISTANCE[level] + ((majors - FIRST_MAJOR[level]) << level), level


def encode_majors(distances: Integers) -> Integers:
    """Return the majors nearest to distances in millimetres."""
    level = np.searchsorted(FIRST_DISTANCE, distances, side="right") - 1
    half = (1 << level) >> 1
    majors = FIRST_MAJOR[level] + ((distances - FIRST_DISTANCE[level] + half) >> level)
    return np.asarray(np.minimum(majors, 0xFFF))


def correction(distances: Integers) -> Floats:
    """Return the degrees by which beams lag the head, from the geometry of the optics; distances in millimetres.

    In radians * 2^16 it is 8 degrees - 64 k - k^3 / 98304, with k = 98361 / (4 d) rounded down.
    """
    k = 98361 // (4 * np.maximum(distances, NEAR_DISTANCE))
    lag = int(np.pi / 180.0 * 8.0 * 65536.0) - (k << 6) - k**3 // 98304
    return np.where(distances >= NEAR_DISTANCE, np.degrees(lag / 65536.0), 7.5)


def decode(capsules: StructuredArray, following: StructuredArray) -> CapsuleReturns:
    """Decode capsules (m,): distances from majors and differences; the last cabin's third sample refers to the
    following capsule's first major.
    """
    cabins = capsules["cabins"].astype(np.int64)
    majors = np.column_stack([cabins & 0xFFF, following["cabins"][:, 0].astype(np.int64) & 0xFFF])
    values, levels = decode_majors(majors)
    first, after = values[:, :-1], values[:, 1:]
    base, level = _base(values, levels)
    second, third = _signed(cabins >> 12), _signed(cabins >> 22)
    distances = np.stack(
        [
            first,
            np.where(np.isin(second, INVALID_DIFFERENCES), 0, base + (second << level)),
            np.where(np.isin(third, INVALID_DIFFERENCES), 0, after + (third << levels[:, 1:])),
        ],
        axis=-1,
    ).reshape(len(capsules), -1)
    distances = np.maximum(distances, 0)
    return CapsuleReturns(to_metres(distances), None, correction(distances))


FORMAT = CapsuleFormat(0x84, LAYOUT, 96, decode)


def encode(heads: Floats, ranges: Floats, ahead: float = np.nan, reset: bool = False) -> bytes:
    """Encode capsules (m,).

    heads   (m,) radians clockwise of the head at the capsules' beginning
    ranges  (m, 96) metres; NaN for no return
    ahead   first range of the capsule after these
    reset   marks the first capsule after a start

    A second or third sample too far from its reference cannot be encoded and becomes invalid, as in the device.
    """
    capsules = new_capsules(FORMAT, heads, reset)
    wanted = to_millimetres(ranges, MAX_DISTANCE).reshape(-1, 3)
    last = to_millimetres(np.array([ahead]), MAX_DISTANCE)
    majors = encode_majors(np.concatenate([wanted[:, 0], last]))
    values, levels = decode_majors(majors)
    base, level = _base(values[None], levels[None])
    second = _difference(wanted[:, 1], base[0], level[0])
    third = _difference(wanted[:, 2], values[1:], levels[1:])
    words = majors[:-1] | ((second & 0x3FF) << 12) | ((third & 0x3FF) << 22)
    capsules["cabins"] = words.reshape(-1, 32)
    return add_checksums(capsules)


def _base(values: Integers, levels: Integers) -> tuple[Integers, Integers]:
    """Return distance and level to which second samples refer: of their own cabin, or of the next one if it has no
    return.
    """
    lost = (values[:, :-1] == 0) & (values[:, 1:] != 0)
    return np.where(lost, values[:, 1:], values[:, :-1]), np.where(lost, levels[:, 1:], levels[:, :-1])


def _signed(bits: Integers) -> Integers:
    """Return the lowest ten bits as a signed number."""
    return ((bits & 0x3FF) ^ 0x200) - 0x200


def _difference(wanted: Integers, base: Integers, level: Integers) -> Integers:
    """Return the encoded difference of a second or third sample nearest to the wanted distance; an invalid one if out
    of range.
    """
    steps = (wanted - base + ((1 << level) >> 1)) >> level
    stored = (wanted > 0) & (steps > INVALID_DIFFERENCES[0]) & (steps < INVALID_DIFFERENCES[1])
    return np.where(stored, steps, INVALID_DIFFERENCES[0])
