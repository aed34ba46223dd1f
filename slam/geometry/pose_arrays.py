"""Arrays of some dozens of poses, in compiled code; for single poses and large arrays `drivers.se2` serves.

The operations on each pose, and their order, are those of `drivers.se2`. For arrays of this size it takes ten times as
long, most of it to call NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined


@compiled
def compose_each(first, second):  # type: ignore[no-untyped-def]
    """Return the products (n, 3) of transforms (n, 3), each of `second` in the frame of that of `first`.

    One of the two may be a single one (1, 3), which is used for all of the other.
    """
    count = max(len(first), len(second))
    result = np.empty((count, 3))
    for k in range(count):
        a, b = first[min(k, len(first) - 1)], second[min(k, len(second) - 1)]
        result[k, 0], result[k, 1], result[k, 2] = _product(a[0], a[1], a[2], b)
    return result


@compiled
def between_each(first, second):  # type: ignore[no-untyped-def]
    """Return transforms (n, 3) relative to those of `first` (n, 3); one may be single, as for `compose_each`."""
    count = max(len(first), len(second))
    result = np.empty((count, 3))
    for k in range(count):
        a, b = first[min(k, len(first) - 1)], second[min(k, len(second) - 1)]
        result[k, 0], result[k, 1], result[k, 2] = _between(a, b)
    return result


@compiled
def spaced_rows(last, poses, distance, per_radian):  # type: ignore[no-untyped-def]
    """Return the rows of poses (n, 3) each of which is at least a distance from the one before, the first from `last`.

    A radian counts for `per_radian` metres.
    """
    rows, count = np.empty(len(poses), np.int64), 0
    x, y, heading = last[0], last[1], last[2]
    for k in range(len(poses)):
        turn = abs(wrapped(poses[k, 2] - heading))
        if math.hypot(poses[k, 0] - x, poses[k, 1] - y) + per_radian * turn >= distance:
            x, y, heading = poses[k, 0], poses[k, 1], poses[k, 2]
            rows[count] = k
            count += 1
    return rows[:count]


@compiled
def unwrapped(angles):  # type: ignore[no-untyped-def]
    """Return angles (n,), radians, without steps of more than half a turn, as `np.unwrap` does."""
    result, correction = angles.copy(), 0.0
    for k in range(1, len(angles)):
        step = angles[k] - angles[k - 1]
        if abs(step) >= math.pi:
            within = wrapped(step)
            correction += (math.pi if within == -math.pi and step > 0.0 else within) - step
        result[k] = angles[k] + correction
    return result


@compiled
def interpolate_each(times, poses, wanted):  # type: ignore[no-untyped-def]
    """Return (m, 3) the poses at the `wanted` times (m,), between poses (n, 3) at increasing `times` (n,).

    They are interpolated linearly in SE(2), and constant before the first and after the last time.
    """
    result = np.empty((len(wanted), 3))
    for k in range(len(wanted)):
        after = min(np.searchsorted(times, wanted[k]), len(times) - 1)
        pose = poses[after]
        result[k, 0], result[k, 1], result[k, 2] = pose[0], pose[1], pose[2]
        if after > 0 and times[after] > wanted[k]:
            before = poses[after - 1]
            part = (wanted[k] - times[after - 1]) / (times[after] - times[after - 1])
            x, y, turn = _between(before, pose)
            motion = part * x, part * y, part * turn
            result[k, 0], result[k, 1], result[k, 2] = _product(before[0], before[1], before[2], motion)
    return result


@inlined
def _between(first, second):  # type: ignore[no-untyped-def]
    c, s = math.cos(first[2]), math.sin(first[2])
    x, y, heading = -c * first[0] - s * first[1], s * first[0] - c * first[1], wrapped(-first[2])
    return _product(x, y, heading, second)


@inlined
def _product(x, y, heading, second):  # type: ignore[no-untyped-def]
    c, s = math.cos(heading), math.sin(heading)
    return x + c * second[0] - s * second[1], y + s * second[0] + c * second[1], wrapped(heading + second[2])


@inlined
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return an angle (radians) wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
