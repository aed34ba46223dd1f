"""Segmentation of a scan: split, merge, refine boundaries, remove small segments, bridge the gaps they leave.

The rays between two certain breaks are split where the sum of the costs of both parts is lowest, if that decreases the
cost by more than a penalty; neighbours whose common line costs less than the penalty more are merged again. Boundaries
are then moved to where both sides fit best, segments of very few rays are removed, and walls interrupted only by those
are joined.
"""

from __future__ import annotations

from .compiled import inlined
from .merging import extend_segments, merge_segments, remove_small_segments
from .rays import Rays
from .segments import Segments
from .settings import Settings
from .splitting import refine_boundaries, split_rays
from .types import Floats, Integers

# Decrease of chi-square that a further break must bring. A break adds two line parameters and one of n positions: about
# 3 ln n, and half as much again because the best break for the noise is chosen. Origin: tuned on simulated
# scans, confirmed on others.
PENALTY = 30.0


@inlined
def segment_rays(
    rays: Rays, count: int, step: float, segments: Segments, gains: Floats, stack: Integers, settings: Settings
) -> int:
    """Divide the rays of a scan into segments and return their number; some rays may be in no segment.

    count         number of rays
    step          of the bearing grid, radians
    gains, stack  memory, one entry for each ray
    """
    segment_count = split_rays(rays, count, settings.penalty, segments, gains, stack)
    segment_count = merge_segments(rays, count, step, segments, segment_count, False, settings)
    refine_boundaries(rays, count, segments, segment_count, gains)
    remaining = remove_small_segments(segments, segment_count)
    if remaining < segment_count:
        extend_segments(rays, count, segments, remaining, settings)
        remaining = merge_segments(rays, count, step, segments, remaining, True, settings)
        refine_boundaries(rays, count, segments, remaining, gains)
    return remaining
