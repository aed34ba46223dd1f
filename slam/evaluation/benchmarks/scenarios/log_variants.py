"""Variants of a log: other lidars, errors of ranges, stamps and odometry, thinned logs, and drives played backwards."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from operator import attrgetter
from typing import TypeAlias

import numpy as np

from drivers import se2
from drivers.messages import Message, Odometry, Scan, YawRate, end_stamp, with_reversed_times
from drivers.se2 import Pose

LogVariant: TypeAlias = Callable[[Iterable[Message], np.random.Generator], Iterable[Message]]
"""Changes the messages of a drive; the generator is for its random numbers."""

KEPT_DISTANCE, KEPT_TURN = 1.0, float(np.radians(30.0))
"""Metres and radians driven between two scans of a thinned log."""
NO_RETURNS = 51.05, 51.16
"""Metres between which the readings for a no-return scatter; those of the lidar of two public logs."""
DRIFT = 0.04, 0.05, 0.011
"""Standard deviations of the systematic errors of odometry: relative error of the distance and of the turn, and radians
per metre; those of the simulator's bad wheels."""
WORKING, FAILING = (30.0, 120.0), (5.0, 40.0)
"""Seconds, least and most, for which a device works, and for which it fails then."""
SHORT_REACH = 5.0
"""Metres that the lidar of a robot vacuum cleaner reaches."""
MIN_PERIOD = 1e-4
"""Seconds between two readings that are stamped when they arrive: they arrive one after the other."""
JITTER = 1e-6
"""Metres and radians, standard deviation of the noise that shows by how much results scatter by chance."""


def _of_scans(change: Callable[[Scan, np.random.Generator], Scan]) -> LogVariant:
    """Return the variant that changes each scan by itself."""

    def changed(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        for message in messages:
            yield change(message, random) if isinstance(message, Scan) else message

    return changed


def crop(half_angle: float) -> LogVariant:
    """Keep the beams within an angle (radians) to both sides of ahead; the first one that remains is at the stamp."""

    def cropped(scan: Scan, _: np.random.Generator) -> Scan:
        kept = np.abs(scan.angles) <= half_angle + 1e-6  # angles are multiples of a rounded increment
        offsets = scan.time_offsets[kept]
        return replace(
            scan,
            stamp=scan.stamp + float(offsets[0]),
            ranges=scan.ranges[kept],
            angles=scan.angles[kept],
            time_offsets=offsets - offsets[0],
        )

    return _in_time_order(_of_scans(cropped))


def shorten() -> LogVariant:
    """Replace the ranges beyond SHORT_REACH by no-returns, as of a lidar that does not reach farther."""

    def shortened(scan: Scan, _: np.random.Generator) -> Scan:
        ranges = np.where(scan.ranges < SHORT_REACH, scan.ranges, np.nan)
        return replace(scan, ranges=ranges, range_max=SHORT_REACH)

    return _of_scans(shortened)


def quantise(step: float) -> LogVariant:
    """Round all ranges to multiples of `step` metres."""
    return _of_scans(lambda scan, _: replace(scan, ranges=step * np.round(scan.ranges / step)))


def disturb(share: float, error: float) -> LogVariant:
    """Add `error` metres to a share of all ranges, chosen at random."""

    def disturbed(scan: Scan, random: np.random.Generator) -> Scan:
        return replace(scan, ranges=scan.ranges + error * (random.random(len(scan.ranges)) < share))

    return _of_scans(disturbed)


def stamp_late(seconds: float) -> LogVariant:
    """Add `seconds` to the stamps of all scans."""
    return _in_time_order(_of_scans(lambda scan, _: replace(scan, stamp=scan.stamp + seconds)))


def stamp_odometry_inexactly(sigma: float) -> LogVariant:
    """Add normally distributed errors (seconds) to the stamps of odometry, as of readings stamped when they arrive."""

    def stamped(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        latest = -np.inf
        for message in messages:
            if isinstance(message, Odometry):
                latest = max(message.stamp + sigma * random.standard_normal(), latest + MIN_PERIOD)
                yield replace(message, stamp=latest)
            else:
                yield message

    return _in_time_order(stamped)


def reverse_times() -> LogVariant:
    """Reverse the order of the beams' times, as a driver does that reverses the beams but not their times."""
    return _of_scans(lambda scan, _: with_reversed_times(scan))


def thin(distance: float = KEPT_DISTANCE, turn: float = KEPT_TURN) -> LogVariant:
    """Keep one scan for each `distance` (metres) or `turn` (radians) of odometry, as in many published logs."""

    def thinned(messages: Iterable[Message], _: np.random.Generator) -> Iterator[Message]:
        pose: Pose | None = None
        kept: Pose | None = None
        for message in messages:
            if isinstance(message, Odometry):
                pose = message.pose
            if isinstance(message, Scan):
                if pose is None or (kept is not None and not _is_beyond(se2.between(kept, pose), distance, turn)):
                    continue
                kept = pose
            yield message

    return thinned


def _is_beyond(motion: Pose, distance: float, turn: float) -> bool:
    return bool(np.hypot(motion[0], motion[1]) >= distance or abs(motion[2]) >= turn)


def drift() -> LogVariant:
    """Add systematic errors of worn wheels to odometry, drawn once for a drive: see DRIFT."""

    def drifting(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        distance_error, turn_error, veer = DRIFT * random.standard_normal(3)

        def change(motion: Pose) -> Pose:
            turn = (1.0 + turn_error) * motion[2] + veer * float(np.hypot(motion[0], motion[1]))
            return np.array([*(1.0 + distance_error) * motion[:2], turn])

        return _with_motions(messages, change)

    return drifting


def jitter() -> LogVariant:
    """Add noise that is far below any measurement's to the motions of odometry: see JITTER."""

    def jittered(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        return _with_motions(messages, lambda motion: motion + JITTER * random.standard_normal(3))

    return jittered


def fail_odometry() -> LogVariant:
    """Let odometry fail now and then: it stands still and goes on from there, or its readings are missing.

    Both kinds of failure are equally probable; for the times see `_Failures`.
    """

    def failing(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        failures = _Failures(random)
        counted: Pose | None = None  # by the wheels up to the last reading that is used
        pose = np.zeros(3)
        for message in messages:
            if not isinstance(message, Odometry):
                yield message
                continue
            failures.advance(message.stamp)
            if failures.failing and failures.draw < 0.5:
                continue
            if not failures.failing:
                pose = message.pose if counted is None else se2.compose(pose, se2.between(counted, message.pose))
            counted = message.pose
            yield replace(message, pose=pose)

    return failing


def lose_scans() -> LogVariant:
    """Let the lidar fail now and then: its scans are missing; for the times see `_Failures`."""

    def failing(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        failures = _Failures(random)
        for message in messages:
            if isinstance(message, Scan):
                failures.advance(message.stamp)
            if not (isinstance(message, Scan) and failures.failing):
                yield message

    return failing


def carry() -> LogVariant:
    """Let the robot be switched off, carried along the way, and switched on again, now and then.

    All messages are missing meanwhile, and odometry starts at zero again; for the times see `_Failures`.
    """

    def carried(messages: Iterable[Message], random: np.random.Generator) -> Iterator[Message]:
        failures = _Failures(random)
        start: Pose | None = None
        for message in messages:
            failures.advance(message.stamp)
            if failures.failing:
                start = None
                continue
            if isinstance(message, Odometry):
                start = message.pose if start is None else start
                message = replace(message, pose=se2.between(start, message.pose))
            yield message

    return carried


class _Failures:
    """Failures of a device, whose times are drawn from WORKING and FAILING.

    failing  True if the device fails at the last stamp
    draw     0 to 1, drawn for each time in which it works or fails, for the kind of failure
    """

    def __init__(self, random: np.random.Generator) -> None:
        self.failing, self.draw = True, 0.0
        self._random, self._end = random, -np.inf

    def advance(self, stamp: float) -> None:
        """Go on to a stamp."""
        if stamp < self._end:
            return
        self.failing, self.draw = not self.failing, float(self._random.random())
        self._end = stamp + self._random.uniform(*(FAILING if self.failing else WORKING))


def _with_motions(messages: Iterable[Message], change: Callable[[Pose], Pose]) -> Iterator[Message]:
    """Yield the messages with changed motions between the readings of odometry."""
    before: Pose | None = None
    changed: Pose | None = None
    for message in messages:
        if isinstance(message, Odometry):
            start = changed
            changed = (
                message.pose
                if before is None or start is None
                else se2.compose(start, change(se2.between(before, message.pose)))
            )
            before = message.pose
            yield replace(message, pose=changed)
        else:
            yield message


def play_backwards(messages: Iterable[Message]) -> tuple[list[Message], float]:
    """Return the messages of a drive in the opposite order, and the sum of their old and new stamps.

    A sweep is stamped by its last beam, which is now its first. It holds the whole drive in memory.
    """
    ordered = sorted(messages, key=end_stamp)
    mirror = ordered[0].stamp + end_stamp(ordered[-1]) if ordered else 0.0

    def backwards(message: Message) -> Message:
        stamp = mirror - end_stamp(message)
        if isinstance(message, Scan):
            message = with_reversed_times(message)
        if isinstance(message, YawRate):
            message = replace(message, rate=-message.rate)
        return replace(message, stamp=stamp)

    return [backwards(message) for message in reversed(ordered)], mirror


def scatter_no_returns() -> LogVariant:
    """Replace no-returns by readings that scatter over a narrow band, NO_RETURNS."""
    low, high = NO_RETURNS

    def scattered(scan: Scan, random: np.random.Generator) -> Scan:
        readings = random.uniform(low, high, len(scan.ranges))
        limit = max(scan.range_max, high + 1.0)
        return replace(scan, ranges=np.where(np.isnan(scan.ranges), readings, scan.ranges), range_max=limit)

    return _of_scans(scattered)


def chain(*variants: LogVariant) -> LogVariant:
    """Apply variants one after the other."""

    def chained(messages: Iterable[Message], random: np.random.Generator) -> Iterable[Message]:
        for variant in variants:
            messages = variant(messages, random)
        return messages

    return chained


def _in_time_order(variant: LogVariant) -> LogVariant:
    """Return a variant whose messages are sorted by stamp; it holds the whole drive in memory."""

    def ordered(messages: Iterable[Message], random: np.random.Generator) -> list[Message]:
        return sorted(variant(messages, random), key=attrgetter("stamp"))

    return ordered
