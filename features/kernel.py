"""Extract the lines and corners of one scan: the compiled function behind Extractor."""

from __future__ import annotations

import math
from typing import Any

from .compiled import compiled, inlined
from .corner_search import add_pair
from .curves import remove_curve_corners
from .estimators import MAXIMUM_LIKELIHOOD, fit_by_code
from .feature_buffers import FeatureBuffers, NoiseEstimate
from .line_tracking import track_lines
from .merging import remove_small_segments
from .noise_estimates import MIN_ADAPT_RAYS, estimate_noise, median_estimate
from .normal_equations import bearing_variance, get_column
from .normal_limits import GROSS_LIMIT
from .rays import (
    Rays,
    RaySlice,
    accumulate_sums,
    bearing_step,
    first_rays,
    mark_breaks,
    select_rays,
    slice_rays,
    update_grid,
    wrap_index,
)
from .rays import views as ray_views
from .segmentation import segment_rays
from .segments import Segments, line
from .segments import views as segment_views
from .settings import Settings
from .types import Floats, Integers
from .wclm import INLIER_GATE, REWEIGHTINGS, reweighted

# In units of the range noise: minimum range of a usable ray; the noise of 1/range of closer ones is far from Gaussian.
# Origin: definition, 20 % relative noise.
MIN_RANGE_SIGMAS = GROSS_LIMIT
# In units of the squared bearing noise: minimum variance of the bearings of a line's rays; noise alone explains less.
# Origin: chosen; not measured.
MIN_BEARING_VARIANCE = 10.0
# Minimum share of a segment's rays that are inliers of its line; only few rays are bridged.
# Origin: chosen; not measured.
MIN_INLIER_SHARE = 0.6
# Maximum chi-square per degree of freedom of a line: residuals of twice the noise. Clutter fits worse than walls.
# Origin: chosen; not measured.
MAX_CHI2 = 4.0
# Rays at each end of a segment that are excluded from the fit: they may lie half beside the wall, or on the jamb at its
# edge, and always pull to the same side, so that no number of scans averages it out. Origin: geometry, the spot of one
# beam crosses an edge.
TRIMMED_RAYS = 1


@inlined
def within_gate(inverse: float, cos: float, sin: float, u: float, v: float, settings: Settings) -> bool:
    """Return True if a ray is within the inlier gate of the line (u, v); also if the line is NaN.

    inverse, cos, sin  1/range of the ray, 1/metres, and cosine and sine of its bearing
    """
    p, t = u * cos + v * sin, v * cos - u * sin
    residual = inverse - p
    variance = (settings.sigma_range * p * p) ** 2 + (settings.sigma_bearing * t) ** 2
    return not residual * residual > INLIER_GATE * variance


@inlined
def lies_on(rays: Rays, ray: int, u: float, v: float, settings: Settings) -> bool:
    """Return True if the ray with index `ray` is within the inlier gate of the line."""
    return within_gate(rays.inverse[ray], rays.cos[ray], rays.sin[ray], u, v, settings)


@inlined
def select_inliers(part: RaySlice, u: float, v: float, settings: Settings, buffer: RaySlice) -> RaySlice:
    """Return the rays within the inlier gate of the line, copied into `buffer`."""
    kept = 0
    for i in range(len(part.inverse)):
        if within_gate(part.inverse[i], part.cos[i], part.sin[i], u, v, settings):
            buffer.inverse[kept], buffer.cos[kept], buffer.sin[kept] = part.inverse[i], part.cos[i], part.sin[i]
            kept += 1
    return first_rays(buffer, kept)


@inlined
def trim_ends(rays: Rays, count: int, begin: int, end: int, u: float, v: float, settings: Settings) -> tuple[int, int]:
    """Return the rays begin..end-1 without those at both ends that do not lie on the line; one is always left."""
    while begin < end - 1 and not lies_on(rays, wrap_index(begin, count), u, v, settings):
        begin += 1
    while begin < end - 1 and not lies_on(rays, wrap_index(end - 1, count), u, v, settings):
        end -= 1
    return begin, end


@inlined
def write_ends(rays: Rays, count: int, begin: int, end: int, used: int, output: FeatureBuffers, lines: int) -> None:
    """Write the ends of the line in row `lines`, which has its (u, v) already, and its span of rays begin..end-1.

    used  number of rays of the fit
    """
    row, span = output.lines[lines], output.spans[lines]
    first, last = wrap_index(begin, count), wrap_index(end - 1, count)
    for ray, column in ((first, 6), (last, 8)):
        distance = 1.0 / (row[0] * rays.cos[ray] + row[1] * rays.sin[ray])
        row[column], row[column + 1] = distance * rays.cos[ray], distance * rays.sin[ray]
    span[0], span[1], span[2], span[3], span[4] = rays.beam[first], rays.beam[last], used, begin, end - 1
    output.curved[lines] = False


@inlined
def fit_reweighted(
    part: RaySlice, u: float, v: float, settings: Settings
) -> tuple[float, float, float, float, float, float, int]:
    """Return the maximum-likelihood line of rays, as `reweighted` does, from the line (u, v).

    The number of inliers is 0 if there are too few for a line.
    """
    cuu = cuv = cvv = chi2 = math.nan
    used = 0
    for _ in range(REWEIGHTINGS):
        u, v, cuu, cuv, cvv, chi2, used = reweighted(
            part.inverse,
            part.cos,
            part.sin,
            u,
            v,
            settings.sigma_range,
            settings.sigma_bearing,
            settings.learned_range,
            settings.learned_bearing,
            INLIER_GATE,
        )
        if used < settings.minimum_count or used < MIN_INLIER_SHARE * len(part.inverse):
            return u, v, cuu, cuv, cvv, chi2, 0
    return u, v, cuu, cuv, cvv, chi2, used


@inlined
def fit_segment(
    rays: Rays,
    count: int,
    segments: Segments,
    segment: int,
    buffer: RaySlice,
    settings: Settings,
    output: FeatureBuffers,
    lines: int,
    estimates: int,
) -> tuple[bool, bool]:
    """Fit a line to a segment and write it to row `lines`, and its estimates of the noise to row `estimates`.

    Returns True if it is accepted as a line, and True if it has estimated the noise.
    """
    begin, end = segments.begin[segment], segments.end[segment]
    if end - begin < settings.minimum_count:
        return False, False
    trimmed = min(TRIMMED_RAYS, (end - begin - settings.minimum_count) // 2)
    part = slice_rays(rays, count, begin + trimmed, end - trimmed, buffer)
    u, v = line(segments, segment)
    u, v, cuu, cuv, cvv, chi2, used = fit_reweighted(part, u, v, settings)
    if used == 0:
        return False, False
    estimated = used >= MIN_ADAPT_RAYS
    if estimated:
        estimate_noise(part, u, v, settings, output.noise[estimates])
    bearing_spread = bearing_variance(get_column(segments.sums, segment))
    if not (chi2 <= MAX_CHI2 * (used - 2) and bearing_spread >= MIN_BEARING_VARIANCE * settings.sigma_bearing**2):
        return False, estimated
    if not cuu * cvv > cuv * cuv:  # the weights leave so few bearings that their noise alone explains the spread
        return False, estimated
    begin, end = trim_ends(rays, count, begin, end, u, v, settings)
    if settings.estimator != MAXIMUM_LIKELIHOOD:
        part = select_inliers(part, u, v, settings, buffer)
        u, v, cuu, cuv, cvv = fit_by_code(
            settings.estimator, part.inverse, part.cos, part.sin, settings.learned_range, settings.learned_bearing
        )
    cuu += segments.boundary_covariance[0, segment]
    cuv += segments.boundary_covariance[1, segment]
    cvv += segments.boundary_covariance[2, segment]
    row = output.lines[lines]
    row[0], row[1], row[2], row[3], row[4], row[5], row[10] = u, v, cuu, cuv, cuv, cvv, chi2
    row[11] = segments.boundary_covariance[3, segment]
    write_ends(rays, count, begin, end, used, output, lines)
    return math.hypot(row[8] - row[6], row[9] - row[7]) >= settings.minimum_length, estimated


@inlined
def fit_segments(
    rays: Rays,
    count: int,
    segments: Segments,
    segment_count: int,
    buffer: RaySlice,
    settings: Settings,
    output: FeatureBuffers,
) -> tuple[int, int]:
    """Fit lines to the segments in the order of their beams.

    Returns the numbers of lines, and of estimates of the noise.
    """
    start = 0
    for segment in range(1, segment_count):
        if rays.beam[wrap_index(segments.begin[segment], count)] < rays.beam[wrap_index(segments.begin[start], count)]:
            start = segment
    lines = estimates = 0
    for k in range(start, start + segment_count):
        is_line, estimated = fit_segment(
            rays, count, segments, wrap_index(k, segment_count), buffer, settings, output, lines, estimates
        )
        if is_line:
            lines += 1
        if estimated:
            estimates += 1
    return lines, estimates


@compiled
def extract_features(
    ranges: Floats,
    angles: Floats,
    setting_values: tuple[Any, ...],
    memory: tuple[Floats, Integers, Floats, Integers],
    output_arrays: tuple[Any, ...],
) -> tuple[int, int, NoiseEstimate]:
    """Extract the features of a scan.

    ranges, angles  (n,) metres and radians
    setting_values  fields of Settings; as a plain tuple, because passing a named one takes a microsecond longer
    memory          results of `rays.allocate` and `segments.allocate`
    output_arrays   fields of FeatureBuffers, as a plain tuple

    Returns the numbers of lines and corners written to the output, and the estimate of the noise.
    """
    settings, output = Settings(*setting_values), FeatureBuffers(*output_arrays)
    grid, ray_buffer = ray_views(memory[0], memory[1])
    segments, gains, stack = segment_views(memory[2], memory[3])
    update_grid(angles, grid)
    range_min = max(settings.range_min, MIN_RANGE_SIGMAS * settings.sigma_range)
    rays, count = select_rays(ranges, range_min, settings.range_max, grid, ray_buffer)
    if count < settings.minimum_count:
        return 0, 0, NoiseEstimate(math.nan, 0.0, math.nan, 0.0, math.nan, 0.0)
    step = bearing_step(angles, rays, count)
    mark_breaks(rays, count, step, settings)
    accumulate_sums(rays, count, step, settings)
    if settings.tracking_distance > 0.0:
        segment_count = remove_small_segments(segments, track_lines(rays, count, settings.tracking_distance, segments))
        segments.boundary_covariance[:, :segment_count] = 0.0
    else:
        segment_count = segment_rays(rays, count, step, segments, gains, stack, settings)
    # gains and prefix sums are not needed any more; their memory is used for the rays of one segment at a time
    buffer = RaySlice(gains, rays.prefix[0], rays.prefix[1])
    lines, estimates = fit_segments(rays, count, segments, segment_count, buffer, settings, output)
    pairs = 0
    for after in range(lines):
        before = after - 1 if after > 0 else lines - 1
        if before != after and add_pair(rays, count, step, output, before, after, settings, pairs):
            pairs += 1
    corners = remove_curve_corners(output.corners, output.pairs, output.curved, pairs)
    estimate = NoiseEstimate(
        *median_estimate(output.noise, estimates, 0),
        *median_estimate(output.noise, estimates, 2),
        *median_estimate(output.noise, estimates, 4),
    )
    return lines, corners, estimate
