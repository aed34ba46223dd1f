"""Segmentation of the paper: line tracking with a distance threshold (section V).

A ray belongs to the line of the previous rays if its end point is within a threshold of that line; otherwise it starts
the next line. A line starts with two rays and is fitted again, in constant time, with every further ray.
"""

from __future__ import annotations

import math

from .compiled import inlined
from .normal_equations import set_column, sums_over, zero_sums
from .rays import Rays
from .segments import Segments, add_rays, append_segment, line

# Metres; threshold on the distance. Origin: definition, the paper.
PAPER_DISTANCE = 0.02


@inlined
def track_lines(rays: Rays, count: int, distance: float, segments: Segments) -> int:
    """Divide the rays of a scan into segments by tracking, and return their number."""
    segment_count = 0
    begin = 0
    while begin < count:
        set_column(segments.sums, segment_count, zero_sums())
        end = begin
        while end < count and (end == begin or rays.broken[end] == 0):
            if end - begin >= 2:
                u, v = line(segments, segment_count)
                residual = rays.inverse[end] - (u * rays.cos[end] + v * rays.sin[end])
                # 1 - u x - v y = range * residual; divided by |(u, v)| it is the distance from the line
                if not abs(residual) * rays.range[end] <= distance * math.hypot(u, v):
                    break
            add_rays(segments, segment_count, sums_over(rays.prefix, count, end, end + 1))
            end += 1
        segment_count = append_segment(segments, segment_count, begin, end)
        begin = end
    return segment_count
