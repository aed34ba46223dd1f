"""The paper's segmentation: line tracking with a threshold on distance (section V).

A ray belongs to the line of the rays before it if its end point is within the threshold of that line, and begins the
next line otherwise. The line starts with two rays and is fitted anew, in constant time, with every ray it takes.
"""

from __future__ import annotations

import math

from .compiled import compiled
from .pieces import Pieces, add, append, line
from .rays import Rays
from .sums import no_rays, over, put

PAPER_DISTANCE = 0.02
"""Threshold of the paper, metres."""


@compiled
def track(rays: Rays, count: int, distance: float, pieces: Pieces) -> int:
    """Divide the rays of a scan into lines by tracking; their number."""
    made = 0
    begin = 0
    while begin < count:
        put(pieces.sums, made, no_rays())
        end = begin
        while end < count and (end == begin or rays.broken[end] == 0):
            if end - begin >= 2:
                u, v = line(pieces, made)
                residual = rays.inverse[end] - (u * rays.cos[end] + v * rays.sin[end])
                # 1 - u x - v y = range * residual; over |(u, v)| it is the distance to the line
                if not abs(residual) * rays.range[end] <= distance * math.hypot(u, v):
                    break
            add(pieces, made, over(rays.prefix, count, end, end + 1))
            end += 1
        made = append(pieces, made, begin, end)
        begin = end
    return made
