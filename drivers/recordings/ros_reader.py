"""What bags and MCAP files share: which topics are read, and how their messages become ours."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import RecordingError
from ..messages import GroundTruth, Message, Odometry
from .reader import Recording, is_stamp
from .ros_messages import (
    BEAMS,
    LASER_SCAN,
    ODOMETRY,
    OLD_TRANSFORMS,
    POSE,
    TRANSFORMS,
    Placing,
    decode,
    exact_scan_of,
    planar_pose,
    scan_of,
    stamp_of,
)
from .transforms import TransformTree

TRUTH_TOPIC = "/ground_truth"
BEAMS_TOPIC = "/scan_beams"
KINDS = frozenset({LASER_SCAN, ODOMETRY, POSE, BEAMS, TRANSFORMS, OLD_TRANSFORMS})
REPEATED_TRANSFORMS = 1000
"""Messages on /tf that are searched for the lidar's mount, which older robots publish there over and over."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A message as it is stored: its number (1-based), topic, type, encoding, time of reception (ns) and bytes."""

    number: int
    topic: str
    kind: str
    encoding: str
    received: int
    data: bytes


@dataclass(slots=True)
class _Survey:
    """What a first look at a recording tells."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)  # type -> topic -> messages
    fixed: TransformTree = field(default_factory=TransformTree)
    repeated: TransformTree = field(default_factory=TransformTree)  # with the fixed ones
    base: str | None = None  # the frame that the odometry moves

    def placing(self, frame: str) -> Placing:
        for tree in (self.fixed, self.repeated):
            exact = tree.planar(frame, self.base)
            if exact is not None:
                return Placing(exact)
            placing = tree.placing(frame, self.base)
            if placing.mount is not None:
                return placing
        return Placing()


class RosRecording(Recording):
    """A recording of ROS messages: LaserScan, Odometry, the lidar's mount from static transforms, ground
    truth.

    Of several topics of a type the one with the most messages is read unless one is named. Raises
    RecordingError where a named topic is not there.
    """

    def __init__(self, path: str | Path, scan_topic: str | None = None, odometry_topic: str | None = None) -> None:
        super().__init__(path)
        self.scan_topic, self.odometry_topic = scan_topic, odometry_topic

    @abstractmethod
    def _entries(self, final: bool) -> Iterator[Entry]:
        """The stored messages of KINDS in order. What is damaged is counted in the report on the `final` pass only."""

    def _read(self) -> Iterator[tuple[int, Message]]:
        survey = self._survey()
        scans = self._choose(survey, LASER_SCAN, self.scan_topic)
        odometry = self._choose(survey, ODOMETRY, self.odometry_topic)
        placings: dict[str, Placing] = {}
        beams: Entry | None = None
        for entry in self._entries(final=True):
            try:
                if entry.kind == BEAMS and entry.topic == BEAMS_TOPIC:
                    beams = entry
                elif entry.kind == LASER_SCAN and entry.topic == scans:
                    message = self._scan(entry, beams, survey, placings)
                    beams = None
                    yield entry.number, message
                elif entry.kind == ODOMETRY and entry.topic == odometry:
                    yield entry.number, _odometry(entry)
                elif entry.kind == POSE and entry.topic == TRUTH_TOPIC:
                    pose = decode(entry.data, POSE, entry.encoding)
                    yield entry.number, GroundTruth(_stamp(pose.header, entry), planar_pose(pose.pose))
            except ValueError as error:
                self.skip(entry.number, str(error))

    def _scan(self, entry: Entry, beams: Entry | None, survey: _Survey, placings: dict[str, Placing]) -> Message:
        message = decode(entry.data, LASER_SCAN, entry.encoding)
        stamp = _stamp(message.header, entry)
        frame = message.header.frame_id
        if frame not in placings:
            placings[frame] = survey.placing(frame)
        if beams is not None and beams.received == entry.received:
            exact = decode(beams.data, BEAMS, beams.encoding)
            return exact_scan_of(exact, stamp, placings[frame].mount)
        return scan_of(message, entry.received, placings[frame])

    def _survey(self) -> _Survey:
        survey = _Survey()
        searched = 0
        for entry in self._entries(final=False):
            counts = survey.counts.setdefault(entry.kind, Counter())
            counts[entry.topic] += 1
            try:
                if entry.kind in (TRANSFORMS, OLD_TRANSFORMS):
                    fixed = entry.topic.endswith("tf_static")
                    searched += not fixed
                    if fixed or searched <= REPEATED_TRANSFORMS:
                        message = decode(entry.data, entry.kind, entry.encoding)
                        survey.repeated.add(message)
                        if fixed:
                            survey.fixed.add(message)
                elif entry.kind == ODOMETRY and survey.base is None:
                    survey.base = decode(entry.data, ODOMETRY, entry.encoding).child_frame_id or None
            except ValueError:
                continue  # counted when it is read; transforms that cannot be decoded leave the mount unknown
        return survey

    def _choose(self, survey: _Survey, kind: str, named: str | None) -> str | None:
        topics = survey.counts.get(kind, Counter())
        if named is None:
            return topics.most_common(1)[0][0] if topics else None
        if named not in topics:
            there = ", ".join(sorted(topics)) or "none"
            raise RecordingError(self.path, None, f"no topic {named} of type {kind}; there are: {there}")
        return named

    def _nothing_found(self) -> str:
        return f"holds no readable {LASER_SCAN} and no {ODOMETRY}"


def _odometry(entry: Entry) -> Odometry:
    message = decode(entry.data, ODOMETRY, entry.encoding)
    return Odometry(_stamp(message.header, entry), planar_pose(message.pose.pose))


def _stamp(header: Any, entry: Entry) -> float:
    stamp = stamp_of(header, entry.received)
    if not is_stamp(stamp):
        raise ValueError("stamp is impossible")
    return stamp
