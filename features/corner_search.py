"""Corners of a scan: intersections of neighbouring lines that lie between the rays of both."""

from __future__ import annotations

import math

from .compiled import inlined
from .corner import intersect, parallel
from .curves import curve_evidence
from .feature_buffers import FeatureBuffers
from .normal_limits import NORMAL_LIMIT
from .rays import TURN, Rays, widest_gap, wrap_index
from .settings import Settings
from .types import Floats

# Beam steps by which a corner may lie outside the rays next to it.
# Origin: tuned on simulated scans, confirmed on others.
CORNER_STEPS = 1.5
# Standard deviations of bearing that are added to that. Origin: definition.
CORNER_SIGMAS = NORMAL_LIMIT
# Maximum range of a corner relative to the farther ray next to it. Origin: chosen; not measured.
CORNER_RANGE = 1.3
# Standard deviations of range that are added to that. Origin: chosen; not measured.
CORNER_RANGE_SIGMAS = 6.0
# Maximum number of rays between the two lines of a corner. Origin: chosen; not measured.
MAX_CORNER_RAYS = 8
# Metres. Maximum standard deviation of a corner's position; less certain corners are useless as landmarks.
# Origin: chosen; not measured.
MAX_CORNER_SIGMA = 0.3


@inlined
def add_pair(
    rays: Rays,
    count: int,
    step: float,
    output: FeatureBuffers,
    before: int,
    after: int,
    settings: Settings,
    pairs: int,
) -> bool:
    """Compare line `before` and the next line `after` with one curve, and write their corner, if any, to row `pairs`.

    Without a corner, the row of `corners` has NaN and the evidence against a curve. Chords of a wide curve have no
    corner, as the angle between them is too small. Lines without a corner are no chords if the curve bends by less
    than the roughness of walls. Returns False if the lines are not neighbours.
    """
    first, second = output.lines[before], output.lines[after]
    last, following = wrap_index(output.spans[before, 4], count), wrap_index(output.spans[after, 3], count)
    between = following - last - 1
    if between < 0:
        between += count
    gap = (rays.bearing[following] - rays.bearing[last]) % TURN
    if between > MAX_CORNER_RAYS or gap > widest_gap(step) + step:
        return False
    begin, end = output.spans[before, 3], output.spans[before, 4] + 1
    start, stop = output.spans[after, 3], output.spans[after, 4] + 1
    if start < begin:
        start, stop = start + count, stop + count
    row = output.corners[pairs]
    least_bend = 0.0
    if not find_corner(rays, step, first, second, last, following, gap, settings, row):
        row[:6], least_bend = math.nan, settings.roughness
    row[6] = curve_evidence(rays, count, first, second, begin, end, start, stop, least_bend, settings)
    output.pairs[pairs, 0], output.pairs[pairs, 1] = before, after
    return True


@inlined
def find_corner(
    rays: Rays,
    step: float,
    first: Floats,
    second: Floats,
    last: int,
    following: int,
    gap: float,
    settings: Settings,
    row: Floats,
) -> bool:
    """Intersect line `first` with its neighbour `second`, and write the corner to `row`; return False if there is none.

    The corner must lie between the `last` ray of the one and the `following` ray, the first of the other line, in
    bearing, and not much farther than these. Occlusion acts in bearing, so this test accepts more corners than one on
    end point distances. `gap` is the angle between the two rays.
    """
    if parallel(first[0], first[1], second[0], second[1]):
        return False
    x, y, cxx, cxy, cyy = intersect(
        first[0], first[1], first[2:6].reshape(2, 2), second[0], second[1], second[2:6].reshape(2, 2)
    )
    distance = math.hypot(x, y)
    reach = max(rays.range[last], rays.range[following])
    if not distance < CORNER_RANGE * reach + CORNER_RANGE_SIGMAS * settings.sigma_range:
        return False
    across = (y * y * cxx - 2.0 * x * y * cxy + x * x * cyy) / distance**4
    margin = CORNER_STEPS * step + CORNER_SIGMAS * (settings.sigma_bearing + math.sqrt(across + first[11]))
    bearing = (math.atan2(y, x) - rays.bearing[last] + math.pi) % TURN - math.pi
    if not -margin <= bearing <= gap + margin or cxx + cyy > MAX_CORNER_SIGMA**2:
        return False
    row[0], row[1], row[2], row[3], row[4], row[5] = x, y, cxx, cxy, cxy, cyy
    return True
