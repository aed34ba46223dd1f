"""How well places are recognised: pieces of a recording's second half looked for in the map of its first half.

The recording's truth is not known, so the pose of the uncut run stands for it, where both halves are one map. That map
and the first half's differ by what was learnt later; so a pose is carried over by the nearest keyframe of the first
half, which is in both.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.messages import Message, Odometry, Scan

from ...config import Config
from ...errors import MapError
from ...geometry.segments import Floats
from ...loop_closure.relocalisation import MapIndex, index_map, relocalise, submap_of
from ...mapping.mapper import Mapper
from ...pipeline import Slam

WAYS = 2.0, 4.0, 6.0  # metres of driving that a fragment is mapped of
WRONG, WRONG_TURN = 0.5, np.radians(10.0)  # metres and radians from which on an accepted pose is wrong
KNOWN_WITHIN = 2.0  # metres from the way of the first half within which a place counts as known
TURN_AS_METRES = 0.5  # metres that a radian counts as when the nearest keyframe is sought
LATER = 0.5  # seconds of messages after a fragment's last scan, so that odometry covers its sweep


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A recording cut in two.

    index               the map of the first half
    stamps, before      (k,) the first half's keyframes and (k, 3) their poses in its map
    after               (k, 3) their poses in the uncut map
    all_stamps, path    (m,), (m, 3) the uncut run
    second_half         messages
    """

    index: MapIndex
    before: Floats
    after: Floats
    all_stamps: Floats
    path: Floats
    second_half: Sequence[Message]


@dataclass(frozen=True, slots=True)
class Query:
    """One fragment: how far its place is from the first half's way (NaN: another building), seconds the search took,
    whether a place was accepted, and by how much that was off (NaN where none was, or where all are wrong)."""

    distance: float
    seconds: float
    accepted: bool
    error: float
    turn_error: float

    @property
    def right(self) -> bool:
        """Whether a place was accepted that is the right one."""
        return self.accepted and self.error <= WRONG and self.turn_error <= WRONG_TURN


@dataclass(frozen=True, slots=True)
class Row:
    """Of fragments of `way` metres: queries, places accepted, right ones among them, places that are known and those of
    them that were found, seconds a query."""

    way: float
    queries: int
    accepted: int
    right: int
    known: int
    found: int
    median: float
    p95: float


def cut(messages: Sequence[Message], config: Config) -> Known:
    """Map the first half of a recording, and all of it."""
    first_half, second_half = halves(messages)
    slam = _mapped(first_half, config)
    half = slam.finish()
    whole = _mapped(messages, config).finish()
    at = np.searchsorted(whole.stamps, half.keyframe_stamps).clip(0, len(whole.stamps) - 1)
    return Known(
        index=index_map(slam.slam_state.mapper),
        before=half.keyframes,
        after=whole.poses[at],
        all_stamps=whole.stamps,
        path=whole.poses,
        second_half=second_half,
    )


def halves(messages: Sequence[Message]) -> tuple[list[Message], list[Message]]:
    """What comes before the middle of a recording's time, and after. Raises MapError where there is nothing."""
    if not messages:
        raise MapError("nothing in it, so there are no halves to compare")
    middle = 0.5 * (messages[0].stamp + messages[-1].stamp)
    first = [message for message in messages if message.stamp < middle]
    return first, [message for message in messages if message.stamp >= middle]


def index_of(messages: Sequence[Message], config: Config) -> MapIndex:
    """The map of some messages, prepared."""
    slam = _mapped(messages, config)
    slam.finish()
    return index_map(slam.slam_state.mapper)


def run(
    known: Known, way: float, count: int, config: Config, *, elsewhere: MapIndex | None = None, seed: int = 0
) -> list[Query]:
    """Look for `count` random fragments of `way` metres of the second half in the first half's map.

    Or `elsewhere`, in the map of another building, where nothing may be found.
    """
    queries = []
    for stamp, mapper in _fragments(known.second_half, way, count, config, seed):
        fragment = submap_of(mapper)
        start = time.perf_counter()
        found = relocalise(fragment, known.index if elsewhere is None else elsewhere)
        seconds = time.perf_counter() - start
        accepted = found is not None and found.verdict.accepted
        distance, error = np.nan, np.full(3, np.nan)
        if elsewhere is None:
            pose, distance = _truth(known, stamp)
            if accepted and found is not None:
                error = se2.between(pose, found.pose)
        queries.append(Query(distance, seconds, accepted, float(np.hypot(*error[:2])), float(abs(error[2]))))
    return queries


def summary(way: float, queries: Sequence[Query]) -> Row:
    """Count what was found; the times are NaN where there was no query."""
    known = [query for query in queries if query.distance <= KNOWN_WITHIN]
    seconds = [query.seconds for query in queries] or [np.nan]
    return Row(
        way=way,
        queries=len(queries),
        accepted=sum(query.accepted for query in queries),
        right=sum(query.right for query in queries),
        known=len(known),
        found=sum(query.right for query in known),
        median=float(np.median(seconds)),
        p95=float(np.quantile(seconds, 0.95)),
    )


def _truth(known: Known, stamp: float) -> tuple[se2.Pose, float]:
    """The pose at a time in the first half's map, and how far that is from the nearest keyframe there."""
    pose = known.path[np.abs(known.all_stamps - stamp).argmin()]
    relative = se2.between(known.after, pose).reshape(-1, 3)
    distance = np.hypot(relative[:, 0], relative[:, 1])
    nearest = int((distance + TURN_AS_METRES * np.abs(relative[:, 2])).argmin())
    return se2.compose(known.before[nearest], relative[nearest]), float(distance[nearest])


def _fragments(
    messages: Sequence[Message], way: float, count: int, config: Config, seed: int
) -> Iterable[tuple[float, Mapper]]:
    """Small maps of the last `way` metres before random scans, with the stamps of their last keyframes."""
    odometry = [message for message in messages if isinstance(message, Odometry)]
    if not odometry:
        return
    stamps = np.array([message.stamp for message in odometry])
    positions = np.array([message.pose[:2] for message in odometry])
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    ends = np.array([message.stamp for message in messages if isinstance(message, Scan)])
    ends = ends[np.interp(ends, stamps, driven) > way]
    random = np.random.default_rng(seed)
    all_stamps = np.array([message.stamp for message in messages])
    for end in random.choice(ends, min(count, len(ends)), replace=False):
        since = stamps[np.searchsorted(driven, np.interp(end, stamps, driven) - way, side="right") - 1]
        slam = Slam(config)
        for message in messages[np.searchsorted(all_stamps, since) : np.searchsorted(all_stamps, end + LATER)]:
            if message.stamp <= end or isinstance(message, Odometry):
                slam.add(message)
        slam_state = slam.slam_state
        if slam_state.mapper.keyframe_count:
            yield slam_state.keyframe_stamps[-1], slam_state.mapper


def _mapped(messages: Iterable[Message], config: Config) -> Slam:
    slam = Slam(config)
    for message in messages:
        slam.add(message)
    return slam
