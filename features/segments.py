"""Segments of rays: intervals of neighbouring rays that one line fits, with the normal equations of that line.

The lines that become of them are `Lines` in the lidar's frame, and in the base's frame `slam.geometry.segments`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import inlined
from .normal_equations import Sums, add_sums, get_column, residual_sum, set_column, solve_line
from .types import Floats, Integers


class Segments(NamedTuple):
    """Intervals of rays in order, without overlap; the last may extend beyond ray n (see rays).

    begin, end           first ray, and one past the last ray
    head, tail           end of the first uninterrupted run of rays, begin of the last one
    sums                 (6, segments) table of sums over the segment's own rays, without bridged ones
    boundary_covariance  (4, segments) due to the uncertain position of boundaries: uu, uv, vv of the line, and variance
                         of the bearing of its end
    """

    begin: Integers
    end: Integers
    head: Integers
    tail: Integers
    sums: Floats
    boundary_covariance: Floats


# Rows of memory per beam: sums, boundary covariance, gains. Origin: definition.
FLOAT_ROWS = 6 + 4 + 1
# Begin, end, head, tail, stack. Origin: definition.
INTEGER_ROWS = 5


def allocate(beams: int) -> tuple[Floats, Integers]:
    """Allocate memory for scans of up to `beams` beams."""
    return np.zeros((FLOAT_ROWS, beams + 1)), np.zeros((INTEGER_ROWS, 2 * beams + 2), dtype=np.int64)


@inlined
def views(floats: Floats, integers: Integers) -> tuple[Segments, Floats, Integers]:
    """Return the segments, the gains and the stack for splitting in the memory from `allocate`."""
    segments = Segments(integers[0], integers[1], integers[2], integers[3], floats[0:6], floats[6:10])
    return segments, floats[10], integers[4]


@inlined
def append_segment(segments: Segments, segment_count: int, begin: int, end: int) -> int:
    """Append the interval begin..end and return the new number of segments. The caller sets its sums."""
    segments.begin[segment_count], segments.end[segment_count] = begin, end
    segments.head[segment_count], segments.tail[segment_count] = end, begin
    return segment_count + 1


@inlined
def add_rays(segments: Segments, i: int, sums: Sums) -> None:
    """Add the sums over further rays to segment i."""
    set_column(segments.sums, i, add_sums(get_column(segments.sums, i), sums))


@inlined
def segment_chi2(segments: Segments, i: int) -> float:
    """Return the chi-square of segment i."""
    return residual_sum(get_column(segments.sums, i)) if segments.end[i] - segments.begin[i] > 2 else 0.0


@inlined
def line(segments: Segments, i: int) -> tuple[float, float]:
    """Return (u, v) of segment i."""
    u, v, _ = solve_line(get_column(segments.sums, i))
    return u, v


@inlined
def joint_line(segments: Segments, i: int, j: int) -> tuple[float, float, float]:
    """Return (u, v, chi-square) of the common line of segments i and j."""
    sums = add_sums(get_column(segments.sums, i), get_column(segments.sums, j))
    u, v, _ = solve_line(sums)
    return u, v, residual_sum(sums) if math.isfinite(u) else math.inf


@inlined
def join_segments(segments: Segments, i: int, j: int, adjacent: bool, shift: int) -> None:
    """Extend segment i by segment j, whose ray indices are `shift` larger in the numbering of i."""
    if adjacent:
        if segments.head[i] == segments.end[i]:
            segments.head[i] = segments.head[j] + shift
        if segments.tail[j] != segments.begin[j]:
            segments.tail[i] = segments.tail[j] + shift
    else:
        segments.tail[i] = segments.tail[j] + shift
    segments.end[i] = segments.end[j] + shift
    add_rays(segments, i, get_column(segments.sums, j))


@inlined
def copy_segment(segments: Segments, source: int, target: int) -> None:
    """Copy segment `source` to `target`."""
    if source == target:
        return
    segments.begin[target], segments.end[target] = segments.begin[source], segments.end[source]
    segments.head[target], segments.tail[target] = segments.head[source], segments.tail[source]
    set_column(segments.sums, target, get_column(segments.sums, source))
    for row in range(4):
        segments.boundary_covariance[row, target] = segments.boundary_covariance[row, source]


@inlined
def rotate_segments(segments: Segments, segment_count: int, count: int) -> None:
    """Make the first segment the last one, after its begin has moved back across ray 0."""
    copy_segment(segments, 0, segment_count)
    segments.begin[segment_count] += count
    segments.end[segment_count] += count
    segments.head[segment_count] += count
    segments.tail[segment_count] += count
    for i in range(segment_count):
        copy_segment(segments, i + 1, i)
