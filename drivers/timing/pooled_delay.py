"""Compare all pairs of successive scans together at each delay of the lidar's stamps.

Where scans have few returns, hardly any scan can be matched to the one before it, and the turns of the lidar are not
known. Each pair shows a little of the delay all the same. With a delay d of the lidar's stamps, odometry's path at
t - d places every return that was measured at t, and

    minimise over d:    c(d) = sum_k sum_i log(1 + e_ki(d)^2 / s^2),

with e_ki the distance of return i of scan k from the surface that the scan before shows, along its normal. Returns that
are farther than REACH from it count as if they were REACH away: other things were seen there, or the delay is wrong.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from .. import se2
from ..immutable import immutable
from ..messages import Floats, Scan
from .beam_times import BeamTimes
from .scan_matching import MAX_POINTS, SCALE, middle_offset, scan_points, surface, surface_loss
from .turns import MAX_SCAN_PERIOD, Turns

# Seconds, step of the delays that are tried; the minimum is interpolated. Origin: numerical, a quarter of the period of
# scans of the slower lidars.
STEP = 0.05
# Metres from a surface beyond which returns are not compared with it. Origin: geometry, the motion of a surface 3 m
# away by a turn of 0.1 rad, which odometry with a wrong delay adds or misses from scan to scan.
REACH = 0.3


@immutable
class _Returns:
    """Returns of a scan: stamps (n,) and points (n, 2) in the base's frame (metres), and the middle of the sweep."""

    middle: float
    stamps: Floats
    points: Floats


def delay_costs(turns: Turns, times: BeamTimes, largest: float, block: float) -> tuple[Floats, Floats]:
    """Return the delays (d,) that are tried, up to `largest` seconds, and the costs (b, d) of blocks of the drive.

    times  when the beams of the scans were measured
    block  duration of a block, seconds

    Pairs of scans are left out if odometry has a gap within the largest delay of them.
    """
    delays = np.asarray(STEP * np.arange(-round(largest / STEP), round(largest / STEP) + 1), dtype=np.float64)
    scans = [_returns(times.of(scan), turns.mount) for scan in turns.collected]
    stamps = turns.odometry[:, 0]
    pairs = [k for k, pair in enumerate(pairwise(scans)) if _comparable(*pair, stamps, largest)]
    if not pairs:
        return delays, np.zeros((0, len(delays)))
    costs = np.array([_costs(scans, pairs, turns, delay) for delay in delays.tolist()])
    middles = np.array([scans[k].middle for k in pairs])
    _, rows = np.unique(np.floor((middles - middles[0]) / block), return_inverse=True)
    blocks = np.zeros((rows.max() + 1, len(delays)))
    np.add.at(blocks, rows, costs.T)
    return delays, blocks


def _returns(scan: Scan, mount: se2.Pose | None) -> _Returns:
    """Return at most MAX_POINTS returns of a scan, evenly thinned out."""
    valid = np.flatnonzero(np.isfinite(scan.ranges) & (scan.ranges > 0.0))
    step = max(1, -(-len(valid) // MAX_POINTS))
    points = scan_points(scan)[::step]
    if mount is not None:
        points = se2.transform(mount, points)
    return _Returns(scan.stamp + middle_offset(scan), scan.stamp + scan.time_offsets[valid[::step]], points)


def _comparable(before: _Returns, scan: _Returns, odometry: Floats, largest: float) -> bool:
    """Return true if two scans follow each other, have returns, and odometry (m,) is continuous around them."""
    if not len(before.stamps) or not len(scan.stamps) or scan.middle - before.middle > MAX_SCAN_PERIOD:
        return False
    first = int(np.searchsorted(odometry, before.stamps.min() - largest)) - 1
    last = int(np.searchsorted(odometry, scan.stamps.max() + largest))
    return first >= 0 and last < len(odometry) and float(np.diff(odometry[first : last + 1]).max()) <= MAX_SCAN_PERIOD


def _costs(scans: list[_Returns], pairs: list[int], turns: Turns, delay: float) -> Floats:
    """Return the costs (p,) of `pairs` of a scan and the next one if all are stamped late by `delay` seconds."""
    x, y, heading = turns.path_at(np.concatenate([scan.stamps for scan in scans]) - delay).T
    c, s, (px, py) = np.cos(heading), np.sin(heading), np.concatenate([scan.points for scan in scans]).T
    placed = np.column_stack([x + c * px - s * py, y + s * px + c * py])
    ends = np.cumsum([0, *(len(scan.stamps) for scan in scans)])
    robots = turns.path_at(np.array([scan.middle for scan in scans]) - delay)[:, :2]
    unmatched, costs = math.log1p((REACH / SCALE) ** 2), np.empty(len(pairs))
    for row, k in enumerate(pairs):
        before, points = placed[ends[k] : ends[k + 1]] - robots[k], placed[ends[k + 1] : ends[k + 2]] - robots[k]
        seen = surface(before, least=1)
        loss, found = (0.0, 0) if seen is None else surface_loss(points, seen, REACH)
        costs[row] = loss + unmatched * (len(points) - found)
    return costs
