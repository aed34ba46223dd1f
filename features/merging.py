"""Merge neighbouring segments that are one wall, also across spurious returns.

The test is exact: the increase of chi-square by a common line is the squared Mahalanobis distance of the two lines.
"""

from __future__ import annotations

from .compiled import inlined
from .normal_equations import sums_over
from .normal_limits import NORMAL_LIMIT
from .rays import MISSING_STEPS, TURN, Rays, distance_squared, widest_gap, wrap_index
from .segments import Segments, add_rays, copy_segment, join_segments, joint_line, line, segment_chi2
from .settings import Settings
from .types import Integers

# Number of rays below which a segment is spurious: with two fitted parameters fewer rays are no evidence.
# Origin: tuned on simulated scans.
MIN_SEGMENT_RAYS = 4

# Maximum number of rays off a wall between two parts of it. Origin: tuned on simulated scans.
MAX_BRIDGED = 4

# Squared normalised residual up to which an unassigned ray extends the line next to it.
EXTENSION_GATE = NORMAL_LIMIT**2  # Origin: definition.

# Instead of the number of rays between two segments: none, and no break either. Origin: definition.
ADJACENT = -1

# Maximum number of passes over all neighbours; two suffice for nearly every scan. Origin: measured.
MAX_PASSES = 4


@inlined
def is_one_line(segments: Segments, i: int, j: int, penalty: float) -> bool:
    """Return True if one line explains segments i and j."""
    return joint_line(segments, i, j)[2] - segment_chi2(segments, i) - segment_chi2(segments, j) < penalty


@inlined
def is_bridgeable(
    rays: Rays, count: int, step: float, segments: Segments, i: int, j: int, between: int, settings: Settings
) -> bool:
    """Return True if the `between` rays from segment i to segment j show no opening in their common wall."""
    last, following = wrap_index(segments.end[i] - 1, count), wrap_index(segments.begin[j], count)
    gap = rays.bearing[following] - rays.bearing[last]
    if gap < 0.0:
        gap += TURN
    if gap > widest_gap(step):
        return False
    if distance_squared(rays, last, following) <= settings.maximum_gap**2:
        return True
    # wider than the maximum gap: at grazing incidence a single lost ray may cause that
    if gap > MISSING_STEPS * step:
        return False
    u, v, _ = joint_line(segments, i, j)
    for k in range(segments.end[i], segments.end[i] + between):
        ray = wrap_index(k, count)
        if rays.inverse[ray] < u * rays.cos[ray] + v * rays.sin[ray]:  # it passed through the wall
            return False
    return True


@inlined
def count_rays_between(segments: Segments, broken: Integers, count: int, i: int, j: int, shift: int) -> int:
    """Return the number of rays between segment i and the next one j, or ADJACENT if the wall may just continue.

    Ray indices of j are `shift` smaller than in the numbering of i.
    """
    between = segments.begin[j] + shift - segments.end[i]
    return between if between > 0 or broken[wrap_index(segments.begin[j], count)] != 0 else ADJACENT


@inlined
def merge_segments(
    rays: Rays, count: int, step: float, segments: Segments, segment_count: int, bridge: bool, settings: Settings
) -> int:
    """Merge neighbours that are one wall, if `bridge` also across spurious rays; return the number of segments left."""
    max_between = MAX_BRIDGED if bridge else ADJACENT
    penalty, broken = settings.penalty, rays.broken
    for _ in range(MAX_PASSES):
        before = segment_count
        kept = 0
        for i in range(1, segment_count + 1):
            # after the last segment: it may continue in the first one, across the start of the revolution
            wraps = i == segment_count
            j, shift = (0, count) if wraps else (i, 0)
            if kept == j:
                break
            between = count_rays_between(segments, broken, count, kept, j, shift)
            same_wall = between <= max_between and is_one_line(segments, kept, j, penalty)
            if same_wall and between != ADJACENT:
                same_wall = is_bridgeable(rays, count, step, segments, kept, j, between, settings)
            if same_wall:
                join_segments(segments, kept, j, between == ADJACENT, shift)
                if wraps:
                    for k in range(kept):
                        copy_segment(segments, k + 1, k)
                    kept -= 1
            elif not wraps:
                kept += 1
                copy_segment(segments, i, kept)
        segment_count = min(segment_count, kept + 1)
        if segment_count == before:
            break
    return segment_count


@inlined
def remove_small_segments(segments: Segments, segment_count: int) -> int:
    """Remove segments of fewer than MIN_SEGMENT_RAYS rays; return the number left."""
    kept = 0
    for i in range(segment_count):
        if segments.end[i] - segments.begin[i] >= MIN_SEGMENT_RAYS:
            copy_segment(segments, i, kept)
            kept += 1
    return kept


@inlined
def fits_line(rays: Rays, ray: int, u: float, v: float, settings: Settings) -> bool:
    """Return True if a ray is within EXTENSION_GATE of the line (u, v)."""
    p, t = u * rays.cos[ray] + v * rays.sin[ray], v * rays.cos[ray] - u * rays.sin[ray]
    residual = rays.inverse[ray] - p
    range_variance = settings.sigma_range**2 + settings.roughness**2
    variance = range_variance * p * p * p * p + (settings.sigma_bearing * t) ** 2
    return bool(residual * residual <= EXTENSION_GATE * variance)


@inlined
def extend_segments(rays: Rays, count: int, segments: Segments, segment_count: int, settings: Settings) -> None:
    """Extend segments at both ends by rays of removed segments that fit their lines."""
    for i in range(segment_count):
        u, v = line(segments, i)
        limit = segments.begin[i + 1] if i + 1 < segment_count else segments.begin[0] + count
        end = segments.end[i]
        while (
            end < limit
            and rays.broken[wrap_index(end, count)] == 0
            and fits_line(rays, wrap_index(end, count), u, v, settings)
        ):
            end += 1
        if segments.head[i] == segments.end[i]:
            segments.head[i] = end
        add_rays(segments, i, sums_over(rays.prefix, count, segments.end[i], end))
        segments.end[i] = end
        limit = segments.end[i - 1] if i > 0 else max(0, segments.end[segment_count - 1] - count)
        begin = segments.begin[i]
        while begin > limit and rays.broken[wrap_index(begin, count)] == 0:
            if not fits_line(rays, wrap_index(begin - 1, count), u, v, settings):
                break
            begin -= 1
        if segments.tail[i] == segments.begin[i]:
            segments.tail[i] = begin
        add_rays(segments, i, sums_over(rays.prefix, count, begin, segments.begin[i]))
        segments.begin[i] = begin
