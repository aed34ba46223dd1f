"""Roughness of surfaces: what the segments fitted to them err by, beyond the noise of the rays.

The ends of a segment of length l are off by the roughness of the surface, of variance f, which turns the segment by a
variance of 12 f / l^2. All of its points are off together by what depends on the view: the range error of a surface of
this brightness at this angle, quantised ranges, and the part of a bent wall that is seen. So its offset has a variance
of its own, in offices three to four times that of the ends.
"""

from __future__ import annotations

from typing import NamedTuple

from drivers.compiled import inlined

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


@inlined
def wall_weights(segment, half, wall, along, roughness):  # type: ignore[no-untyped-def]
    """Return the information of the offset and heading of a segment relative to its wall: (yy, yt, tt).

    `segment` and `wall` are the covariances (2, 2) of both, `half` is half the length of the segment, `along` the
    position of its middle on the wall. For `roughness` see `Roughness`.
    """
    yy = segment[0, 0] + roughness[0] + wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
    yt = segment[0, 1] + wall[0, 1] + along * wall[1, 1]
    tt = segment[1, 1] + 3 * roughness[1] / half**2 + wall[1, 1]
    determinant = yy * tt - yt * yt
    return tt / determinant, -yt / determinant, yy / determinant
