"""Measure precision and recall of relocalisation: submaps of a recording's second half in the map of its first half.

Ground truth is not available; the pose from mapping the whole recording takes its place. Its map and that of the first
half differ by later corrections, so a pose is transferred relative to the nearest keyframe of the first half, which is
in both.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Message, Odometry, Scan

from ...config import Config
from ...errors import MapError
from ...estimation.slam_state import SlamState
from ...geometry.segments import Floats
from ...pipeline import Slam
from ...recognition.drive_scans import DriveScans
from ...recognition.location import LOST, locate
from ...recognition.map_index import index_map
from ...recognition.scanned_map import ScannedMap, scan_map

SUBMAP_LENGTHS = 2.0, 4.0, 6.0  # metres travelled while a submap is built
MAX_ERROR, MAX_ANGLE_ERROR = 0.5, np.radians(10.0)  # metres, radians; an accepted pose with a larger error is wrong
KNOWN_DISTANCE = 2.0  # metres to the nearest keyframe of the first half within which a place counts as known
METRES_PER_RADIAN = 0.5  # weight of the heading in the choice of the nearest keyframe
ODOMETRY_MARGIN = 0.5  # seconds of odometry after a submap's last scan, to cover its sweep


@immutable
class SplitRecording:
    """A recording split in two halves.

    known                     map of the first half
    keyframes                 (k, 3) keyframe poses in the map of the first half
    keyframes_in_full_map     (k, 3) the same keyframes in the map of the whole recording
    stamps, path              (m,), (m, 3) path of the whole recording
    second_half               messages
    """

    known: ScannedMap
    keyframes: Floats
    keyframes_in_full_map: Floats
    stamps: Floats
    path: Floats
    second_half: Sequence[Message]


@dataclass(frozen=True, slots=True)
class RelocalisationQuery:
    """Result of searching for one submap.

    distance            to the nearest keyframe of the first half, metres; NaN in the map of another building
    seconds             search time
    accepted            True if a pose was accepted
    error, angle_error  of the accepted pose, metres and radians; NaN without one, or in another building
    """

    distance: float
    seconds: float
    accepted: bool
    error: float
    angle_error: float

    @property
    def correct(self) -> bool:
        """True if a correct pose was accepted."""
        return self.accepted and self.error <= MAX_ERROR and self.angle_error <= MAX_ANGLE_ERROR


@dataclass(frozen=True, slots=True)
class QueryStatistics:
    """Counts over the queries with submaps of one length, and search times in seconds.

    accepted, correct  queries with an accepted pose, and with a correct one
    known, found       queries at known places, and those of them with a correct pose
    """

    submap_length: float
    queries: int
    accepted: int
    correct: int
    known: int
    found: int
    median: float
    p95: float


def split_recording(messages: Sequence[Message], config: Config) -> SplitRecording:
    """Map the first half of a recording, and the whole recording."""
    first_half, second_half = split_halves(messages)
    slam = _run_slam(first_half, config)
    half = slam.finish()
    whole = _run_slam(messages, config).finish()
    at = np.searchsorted(whole.stamps, half.keyframes.stamps).clip(0, len(whole.stamps) - 1)
    return SplitRecording(
        known=_scan(slam.slam_state),
        keyframes=half.keyframes.poses,
        keyframes_in_full_map=whole.poses[at],
        stamps=whole.stamps,
        path=whole.poses,
        second_half=second_half,
    )


def split_halves(messages: Sequence[Message]) -> tuple[list[Message], list[Message]]:
    """Return the messages before and after the middle of a recording's time. Raises MapError without messages."""
    if not messages:
        raise MapError("the recording is empty")
    middle = 0.5 * (messages[0].stamp + messages[-1].stamp)
    first = [message for message in messages if message.stamp < middle]
    return first, [message for message in messages if message.stamp >= middle]


def known_map_of(messages: Sequence[Message], config: Config) -> ScannedMap:
    """Map messages and return the map prepared for relocalisation."""
    slam = _run_slam(messages, config)
    slam.finish()
    return _scan(slam.slam_state)


def run_queries(
    split: SplitRecording,
    submap_length: float,
    count: int,
    config: Config,
    *,
    elsewhere: ScannedMap | None,
    seed: int,
) -> list[RelocalisationQuery]:
    """Search for `count` random submaps of the second half in the map of the first half.

    submap_length  metres travelled per submap
    elsewhere      map of another building to search instead, where any accepted pose is wrong; None for the own one
    """
    queries = []
    for stamp, state in _submaps(split.second_half, submap_length, count, config, seed):
        drive = DriveScans().take(state.mapper, state.local_field, 0)
        start = time.perf_counter()
        location = locate(drive, split.known if elsewhere is None else elsewhere, LOST)
        seconds = time.perf_counter() - start
        accepted = location.accepted
        distance, error = np.nan, np.full(3, np.nan)
        if elsewhere is None:
            pose, distance = _reference_pose(split, stamp)
            if accepted:
                error = se2.between(pose, se2.compose(location.members[-1].motion, state.mapper.pose))
        queries.append(
            RelocalisationQuery(distance, seconds, accepted, float(np.hypot(*error[:2])), float(abs(error[2])))
        )
    return queries


def summarise_queries(submap_length: float, queries: Sequence[RelocalisationQuery]) -> QueryStatistics:
    """Return the counts and search times; the times are NaN without queries."""
    known = [query for query in queries if query.distance <= KNOWN_DISTANCE]
    seconds = [query.seconds for query in queries] or [np.nan]
    return QueryStatistics(
        submap_length=submap_length,
        queries=len(queries),
        accepted=sum(query.accepted for query in queries),
        correct=sum(query.correct for query in queries),
        known=len(known),
        found=sum(query.correct for query in known),
        median=float(np.median(seconds)),
        p95=float(np.quantile(seconds, 0.95)),
    )


def _reference_pose(split: SplitRecording, stamp: float) -> tuple[se2.Pose, float]:
    """Return the reference pose at a time in the map of the first half, and its distance to the nearest keyframe."""
    pose = split.path[np.abs(split.stamps - stamp).argmin()]
    relative = se2.between(split.keyframes_in_full_map, pose).reshape(-1, 3)
    distance = np.hypot(relative[:, 0], relative[:, 1])
    nearest = int((distance + METRES_PER_RADIAN * np.abs(relative[:, 2])).argmin())
    return se2.compose(split.keyframes[nearest], relative[nearest]), float(distance[nearest])


def _submaps(
    messages: Sequence[Message], submap_length: float, count: int, config: Config, seed: int
) -> Iterable[tuple[float, SlamState]]:
    """Yield the stamp of the last keyframe and the state after the last metres before each of several random scans."""
    odometry = [message for message in messages if isinstance(message, Odometry)]
    if not odometry:
        return
    stamps = np.array([message.stamp for message in odometry])
    positions = np.array([message.pose[:2] for message in odometry])
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    ends = np.array([message.stamp for message in messages if isinstance(message, Scan)])
    ends = ends[np.interp(ends, stamps, travelled) > submap_length]
    random = np.random.default_rng(seed)
    all_stamps = np.array([message.stamp for message in messages])
    for end in random.choice(ends, min(count, len(ends)), replace=False):
        since = stamps[np.searchsorted(travelled, np.interp(end, stamps, travelled) - submap_length, side="right") - 1]
        slam = Slam(config)
        for message in messages[
            np.searchsorted(all_stamps, since) : np.searchsorted(all_stamps, end + ODOMETRY_MARGIN)
        ]:
            if message.stamp <= end or isinstance(message, Odometry):
                slam.add(message)
        slam_state = slam.slam_state
        if slam_state.mapper.keyframe_count:
            slam_state.mapper.solve_waiting()
            yield slam_state.keyframe_stamps[-1], slam_state


def _scan(state: SlamState) -> ScannedMap:
    """Prepare the map of a state to search in."""
    points = state.local_field.points_of(np.arange(state.mapper.keyframe_count))
    return scan_map(index_map(state.mapper), state.mapper.keyframe_poses, points)


def _run_slam(messages: Iterable[Message], config: Config) -> Slam:
    slam = Slam(config)
    for message in messages:
        slam.add(message)
    return slam
