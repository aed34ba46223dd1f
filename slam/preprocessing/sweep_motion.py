"""Motion of odometry during the sweep of a scan, and the beams as seen from the middle of the sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from drivers.compiled import compiled, inlined

from ..geometry.pose_arrays import between_each
from ..geometry.segments import Floats
from ..odometry.history import TRAVEL_PER_RADIAN, wheel_travel
from ..odometry.measurement_clock import USUAL_PERIOD


@dataclass(frozen=True, eq=False)
class SweepMotion:
    """Motion of odometry during a sweep, relative to the pose in its middle.

    times        (n,) seconds from the middle to each beam
    poses        (n, 3) [x, y, heading] of the base at each beam
    speed_error  standard deviation of the relative error of the speed, see `smoothed_poses`
    breakpoints  (m + 1,) seconds from the middle to the readings between which odometry's error changes evenly
    steps        (m,) metres of wheel travel between these
    fitted       seconds from the middle to either end of the interval that the reference is fitted to
    offset       metres of wheel travel between the middle and the stamp that the scan was moved to
    """

    times: Floats
    poses: Floats
    speed_error: float
    breakpoints: Floats
    steps: Floats
    fitted: float
    offset: float = 0.0

    @staticmethod
    @lru_cache(maxsize=2)  # all scans of a lidar have as many beams; there may be two lidars
    def standing(beams: int) -> SweepMotion:
        """Return that of a robot that stands."""
        return SweepMotion(np.zeros(beams), np.zeros((beams, 3)), 0.0, np.array([0.0, 1.0]), np.zeros(1), 0.0)

    @cached_property
    def travel(self) -> Floats:
        """(n,) metres of wheel travel between the middle and each beam."""
        return wheel_travel(self.poses)

    @cached_property
    def reach(self) -> float:
        """Metres of wheel travel between the stamp and the beam that is farthest from it."""
        return float(self.travel.max(initial=0.0)) + self.offset


@compiled
def beams_from_middle(ranges, angles, times, knots, lidars, moves):  # type: ignore[no-untyped-def]
    """Return ranges and bearings (n,) of beams as seen from the lidar in the middle of the sweep, and the base's poses.

    ranges, angles  (n,) metres and radians as seen from the lidar at the time of each beam
    times           (n,) seconds from the start of the sweep
    knots           (k,) seconds from there, evenly spaced
    lidars          (k, 3) poses of the lidar at these relative to that in the middle, headings unwrapped
    moves           (k, 3) poses of the base likewise

    The poses (n, 3) of the base at the beams are relative to that in the middle, too. A missing range stays missing;
    its bearing is turned with the lidar.
    """
    count, last = len(ranges), len(knots) - 1
    seen_ranges, bearings, poses = np.empty(count), np.empty(count), np.empty((count, 3))
    per_second = last / (knots[last] - knots[0])
    for k in range(count):
        place = min(max((times[k] - knots[0]) * per_second, 0.0), float(last))
        i = min(int(place), last - 1)
        part = place - i
        for axis in range(3):
            poses[k, axis] = _between(moves[i, axis], moves[i + 1, axis], part)
        x, y = _between(lidars[i, 0], lidars[i + 1, 0], part), _between(lidars[i, 1], lidars[i + 1, 1], part)
        turned = angles[k] + _between(lidars[i, 2], lidars[i + 1, 2], part)
        c, s = math.cos(turned), math.sin(turned)
        along, across = ranges[k] + c * x + s * y, c * y - s * x
        seen_ranges[k], bearings[k] = math.sqrt(along * along + across * across), turned
        if math.isfinite(along):
            bearings[k] += math.atan2(across, along)
    return seen_ranges, bearings, poses


@inlined
def _between(first, second, part):  # type: ignore[no-untyped-def]
    return first + part * (second - first)


@compiled
def travelled_at(poses, knots, wanted):  # type: ignore[no-untyped-def]
    """Return metres of wheel travel from the first knot to the `wanted` times (m,), which increase.

    poses, knots  (k, 3) smoothed poses and (k,) their times, seconds: between readings, noise would count as travel

    Before and after the knots, the speed is that at their ends.
    """
    travelled, steps = np.zeros(len(knots)), between_each(poses[:-1], poses[1:])
    for k in range(len(steps)):
        length = math.sqrt(steps[k, 0] ** 2 + steps[k, 1] ** 2)
        travelled[k + 1] = travelled[k] + length + TRAVEL_PER_RADIAN * abs(steps[k, 2])
    result = np.empty(len(wanted))
    after = 1
    for j in range(len(wanted)):
        while after < len(knots) - 1 and knots[after] < wanted[j]:
            after += 1
        part = (wanted[j] - knots[after - 1]) / (knots[after] - knots[after - 1])
        result[j] = _between(travelled[after - 1], travelled[after], part)
    return result


@compiled
def breakpoints_of(stamps, begin, end):  # type: ignore[no-untyped-def]
    """Return (m + 1,) stamps between which odometry's error changes evenly, from before a sweep until after it.

    stamps      (n,) of the readings, from USUAL_PERIOD before the sweep to the first one after it
    begin, end  of the sweep, seconds

    These are the stamps of the readings. Where readings are farther apart than USUAL_PERIOD, during which robots
    move smoothly, stamps between them are added.
    """
    first, last = begin - USUAL_PERIOD, end + USUAL_PERIOD
    for stamp in stamps:
        if stamp <= begin:
            first = stamp
        elif stamp >= end:
            last = min(last, stamp)
    result = [first]
    for k in range(len(stamps) + 1):
        stamp = stamps[k] if k < len(stamps) else last
        if k < len(stamps) and not begin < stamp < end:
            continue
        previous = result[-1]
        parts = math.ceil((stamp - previous) / USUAL_PERIOD)
        for part in range(1, parts):
            result.append(previous + part / parts * (stamp - previous))
        result.append(stamp)
    return np.array(result)
