"""Roughness of surfaces: what the segments fitted to them err by, beyond the noise of the rays.

The ends of a segment of length l are off by the roughness of the surface, of variance f, which turns the segment by a
variance of 12 f / l^2. All of its points are off together by what depends on the view: the range error of a surface of
this brightness at this angle, quantised ranges, and the part of a bent wall that is seen. So its offset has a variance
of its own, in offices three to four times that of the ends.
"""

from __future__ import annotations

from typing import NamedTuple

from .segments import Floats


class Roughness(NamedTuple):
    """Variances in square metres.

    offset  of a segment across its wall
    ends    of either end of a segment relative to its offset
    """

    offset: float
    ends: float


def add_roughness(covariances: Floats, half_lengths: Floats, roughness: Roughness) -> Floats:
    """Return covariances (n, 2, 2) of offset and heading of segments, `half_lengths` (n,) metres, with roughness."""
    result = covariances.copy()
    result[:, 0, 0] += roughness.offset
    result[:, 1, 1] += 3 * roughness.ends / half_lengths**2
    return result
