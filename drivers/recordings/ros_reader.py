"""Base class for readers of ROS bags and MCAP files: selects topics, finds the lidar's mount, converts messages."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Set
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from .. import se2
from ..errors import RecordingError
from ..messages import GroundTruth, Message, YawRate, delay_odometry
from ..se2 import Pose
from .decompression import DecompressionError, uncompressed_message
from .multi_echo import MULTI_ECHO, first_echoes
from .point_clouds import POINT_CLOUD, HeightCut
from .range_units import ScanInUnits, find_range_unit
from .reader import RecordingReader
from .robot_namespaces import topics_of_other_robots
from .ros_contents import Contents, survey
from .ros_messages import (
    BEAMS,
    IMU,
    LASER_SCAN,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    TRANSFORMS_ROS1,
    LidarMount,
    decode,
    planar_pose,
    ranges_of,
    scan_of,
    stamp_of,
    yaw_rate_of,
)
from .ros_scans import ScanConverter
from .scan_sources import choose_scan_source
from .scan_topics import ScanTopic, choose_scan_topic
from .sensor_clocks import Stream, restamped
from .stored_messages import (
    OdometryTopic,
    StoredMessage,
    choose_odometry_topic,
    describe_odometry_choice,
    find_odometry_frames,
)

GROUND_TRUTH_TOPIC = "/ground_truth"
SHOWN_TOPICS = 6
"""Topics that the error names if none of them can be used."""
MESSAGE_TYPES = frozenset({LASER_SCAN, ODOMETRY, IMU, POSE, BEAMS, TRANSFORMS, TRANSFORMS_ROS1})


class RosReader(RecordingReader):
    """Recording of ROS messages: LaserScan, MultiEchoLaserScan or PointCloud2, Odometry, Imu, the lidar's mount from
    static transforms, and ground truth.

    If there are several topics with scans and none is named, the best one is read (see `scan_topics`); of several
    topics with odometry, see `choose_odometry_topic`; of those of a gyroscope, the one with the most messages. Scans
    with several echoes, of which the first of each beam is read, and point clouds are read if their topic is named, or
    if there are no other scans.
    Raises RecordingError if a named topic does not exist.

    cut  layer of point clouds that becomes a scan
    """

    states_beam_times = True

    def __init__(self, path: str | Path, scan_topic: str | None = None, odometry_topic: str | None = None) -> None:
        super().__init__(path)
        self.scan_topic, self.odometry_topic = scan_topic, odometry_topic
        self.cut = HeightCut()
        self._types = MESSAGE_TYPES
        self._left_out: frozenset[str] = frozenset()  # topics of other robots, as soon as the lidar's is known
        self._stored_topics: dict[str, str] = {}  # all topics with their types, as far as these are known

    def select_scans(self, topic: str, cut_height: float | None, cut_thickness: float) -> None:
        """Select the topic that is read, and the layer of point clouds; see `RecordingReader`."""
        self.scan_topic, self.cut = topic or None, HeightCut(cut_height, cut_thickness)

    def select_odometry(self, topic: str) -> None:
        """Select the topic of odometry that is read."""
        self.odometry_topic = topic

    @abstractmethod
    def _stored_messages(self, final: bool) -> Iterator[StoredMessage]:
        """Yield the messages of the types `self._types` in order. Damage is counted on the `final` pass only."""

    def _messages_to_read(self, final: bool) -> Iterator[StoredMessage]:
        """Yield the stored messages, decompressed, those with several echoes as LaserScans."""
        for stored in self._stored_messages(final):
            if stored.topic in self._left_out:
                continue
            message = self._uncompressed(stored) if stored.encoding == "cdr" else stored
            yield first_echoes(message) if message.msgtype == MULTI_ECHO else message

    def _uncompressed(self, stored: StoredMessage) -> StoredMessage:
        try:
            data = uncompressed_message(stored.data)
        except DecompressionError as error:
            raise RecordingError(self.path, stored.number, str(error)) from error
        return stored if data is stored.data else replace(stored, data=data)

    def _read(self) -> Iterator[tuple[int, Message]]:
        scans, reason = self._chosen_scan_topic
        if reason is not None:
            self.interpret(reason)
        contents = self._contents
        if self._left_out:
            self.interpret(f"topics of other robots are left out: {', '.join(sorted(self._left_out))}")
        if scans is None:
            self.doubt(self._reason_without_scans())
        odometry = self._odometry
        self.report.scan_topic, self.report.odometry_topic = scans, odometry.topic
        if odometry.frames is not None:
            self.interpret(f"odometry from the transforms {' -> '.join(odometry.frames)} on /tf")
        else:
            counts, named = contents.counts.get(ODOMETRY, Counter()), self.odometry_topic is not None
            if (choice := describe_odometry_choice(counts, odometry.topic, named=named)) is not None:
                self.interpret(choice)
        readings = [ranges_of(message) for message, _ in contents.sample(scans)]
        per_metre = find_range_unit(readings, self._drive(scans, odometry, contents), self)
        imu = self.report.gyroscope_topic = self._choose_topic(contents, IMU, None)
        foreign, reason = self._foreign_scans
        if reason is not None:
            self.interpret(reason)
        foreign |= self._other_odometry(imu)
        shifts = self._shifts(foreign, imu)
        if scans in contents.counts.get(LASER_SCAN, Counter()):
            self._interpret_mounts(contents, scans)
        converter = ScanConverter(contents, scans, self.cut, per_metre, contents.find_no_return(scans, per_metre))
        standing = contents.clocks.standing({scans, odometry.topic, imu}, odometry.frames)
        for topic in sorted({stream.topic for stream in standing}):
            self.interpret(f"stamps of {topic} stand still: the times of reception are taken")
        for stored in self._messages_to_read(final=True):
            stream = contents.clocks.stream_of(stored) if foreign or shifts or standing else None
            if stream in foreign:
                continue
            try:
                if stored.msgtype in (BEAMS, LASER_SCAN, POINT_CLOUD):
                    if (scan := converter.convert(stored)) is not None:
                        yield stored.number, restamped(scan, stored, standing=stream in standing)
                elif odometry.is_in(stored):
                    for reading in odometry.readings(stored):
                        timed = restamped(reading, stored, standing=stream in standing)
                        yield stored.number, delay_odometry(timed, shifts.get(stream, 0.0))
                elif stored.msgtype == IMU and stored.topic == imu:
                    rate = restamped(self._yaw_rate(stored, contents), stored, standing=stream in standing)
                    yield stored.number, delay_odometry(rate, shifts.get(stream, 0.0))
                elif stored.msgtype == POSE and stored.topic == GROUND_TRUTH_TOPIC:
                    pose = decode(stored.data, POSE, stored.encoding)
                    yield stored.number, GroundTruth(stamp_of(pose.header, stored.received), planar_pose(pose.pose))
            except ValueError as error:
                self.skip(stored.number, str(error))

    def _interpret_mounts(self, contents: Contents, scans: str | None) -> None:
        """Report the frames of scans that are not level and upright."""
        for frame in dict.fromkeys(stream.frame for stream in contents.clocks.streams(scans)):
            for text in contents.find_mount(frame).describe():
                self.interpret(f"{frame} is {text}")
            if contents.all.moves(frame, contents.base):
                self.doubt(f"{frame} moves on the robot by its transforms, and is taken to be where it is at first")
            if (difference := contents.all.disagreement(frame)) is not None:
                shift, turn = difference
                apart = f"{shift:.3f} m and {math.degrees(turn):.1f} degrees"
                self.interpret(f"two transforms of {frame} differ by {apart}; the first one is used")

    def _yaw_rate(self, stored: StoredMessage, contents: Contents) -> YawRate:
        message = decode(stored.data, IMU, stored.encoding)
        axis = contents.fixed.up_axis(contents.base, message.header.frame_id)
        return yaw_rate_of(message, stored.received, axis)

    def _drive(self, scans: str | None, odometry: OdometryTopic, contents: Contents) -> Iterator[ScanInUnits]:
        """Yield all scans of a topic in the recording's order and in their own unit, with the odometry before them."""
        base: Pose | None = None
        for stored in self._messages_to_read(final=False):
            with suppress(ValueError):  # counted on the final pass
                if odometry.is_in(stored):
                    base = next((reading.pose for reading in odometry.readings(stored)), base)
                elif stored.msgtype == LASER_SCAN and stored.topic == scans and base is not None:
                    message = replace(decode(stored.data, LASER_SCAN, stored.encoding), range_min=0.0, range_max=0.0)
                    mount = contents.find_mount(message.header.frame_id)
                    scan = scan_of(message, stored.received, mount)
                    pose = base if mount.pose is None else se2.compose(base, mount.pose)
                    yield ScanInUnits(scan.angles, scan.ranges, pose)

    @cached_property
    def _contents(self) -> Contents:
        """Topics, transforms and the base's frame of the robot whose lidar is read."""
        everything = self._contents_of_all
        self._left_out = topics_of_other_robots(everything.counts, self._chosen_scan_topic[0])
        return survey(self._messages_to_read(final=False)) if self._left_out else everything

    @cached_property
    def _contents_of_all(self) -> Contents:
        """Topics and transforms of all robots, found in a first pass; in two, if no LaserScan is to be read."""
        contents = survey(self._messages_to_read(final=False))
        topics = contents.counts.get(LASER_SCAN, Counter())
        if not topics or (self.scan_topic is not None and self.scan_topic not in topics):
            self._types = MESSAGE_TYPES | {MULTI_ECHO, POINT_CLOUD}
            contents = survey(self._messages_to_read(final=False))
        return contents

    @cached_property
    def _chosen_scan_topic(self) -> tuple[str | None, str | None]:
        """Topic with scans, and the reason if there was a choice."""
        contents = self._contents_of_all
        counts = contents.counts
        topics, clouds = counts.get(LASER_SCAN, Counter()), counts.get(POINT_CLOUD, Counter())
        if self.scan_topic in clouds or (clouds and not topics and self.scan_topic is None):
            chosen = self._choose_topic(contents, POINT_CLOUD, self.scan_topic)
            return chosen, f"point clouds of {chosen}, cut {_describe(self.cut)}"
        if self.scan_topic is not None or len(topics) < 2:
            return self._choose_topic(contents, LASER_SCAN, self.scan_topic), None
        candidates = {name: ScanTopic(name) for name in topics}
        for stored in self._messages_to_read(final=False):
            if stored.msgtype == LASER_SCAN:
                with suppress(ValueError):  # counted on the final pass
                    message = decode(stored.data, LASER_SCAN, stored.encoding)
                    candidate = candidates[stored.topic]
                    if not candidate.stamps:
                        candidate.defect = contents.defect_of(message.header.frame_id)
                    candidate.add(scan_of(message, stored.received, LidarMount()))
        return choose_scan_topic(list(candidates.values()))

    @cached_property
    def _foreign_scans(self) -> tuple[frozenset[Stream], str | None]:
        """Scans on the chosen topic that are not of the lidar, and the reason as text; none if they have one clock."""
        topic, clocks = self._chosen_scan_topic[0], self._contents.clocks
        if topic is None or topic not in self._contents.counts.get(LASER_SCAN, Counter()) or not clocks.apart(topic):
            return frozenset(), None
        odometry = [stream for stream in clocks.delays if self._is_odometry(stream)]
        return choose_scan_source(self._messages_to_read(final=False), topic, clocks, odometry)

    def _is_odometry(self, stream: Stream) -> bool:
        """Return True for a stream with the odometry that is read."""
        return stream.topic == self._odometry.topic or (stream.frame, stream.child) == self._odometry.frames

    def _other_odometry(self, imu: str | None) -> frozenset[Stream]:
        """Return the streams of odometry and gyroscope that other sources publish on the same topic, and report them.

        imu  topic of the gyroscope
        """
        clocks, lidar = self._contents.clocks, self._lidar
        topics = {stream.topic for stream in clocks.delays if self._is_odometry(stream) or stream.topic == imu}
        left_out = frozenset[Stream]()
        if lidar is None:
            return left_out
        for topic in sorted(topics):
            others = clocks.other_sources(topic, lidar)
            if others:
                count = sum(len(clocks.delays[stream]) for stream in others)
                self.interpret(f"several sources publish on {topic}: {count} messages with another clock are left out")
            left_out |= others
        return left_out

    @property
    def _lidar(self) -> Stream | None:
        """Stream of the scans that are read; None if there are no scans with stamps."""
        streams = self._contents.clocks.streams(self._chosen_scan_topic[0])
        return next((stream for stream in streams if stream not in self._foreign_scans[0]), None)

    def _shifts(self, foreign: Set[Stream], imu: str | None) -> dict[Stream | None, float]:
        """Return the seconds to be added to stamps of odometry and gyroscope on another clock than the scans.

        foreign  streams that are not read
        imu      topic of the gyroscope
        """
        shifts: dict[Stream | None, float] = {}
        for stream, seconds in self._contents.clocks.shifts(self._lidar).items() if self._lidar else ():
            if stream not in foreign and (self._is_odometry(stream) or stream.topic == imu):
                shifts[stream] = seconds
                self.interpret(f"stamps of {stream.topic} moved by {seconds:.3f} s: its clock is not that of the scans")
        return shifts

    @cached_property
    def _odometry(self) -> OdometryTopic:
        """Topic with odometry; transforms if there are no messages of the type Odometry."""
        contents = self._contents
        named = self.odometry_topic or choose_odometry_topic(contents.counts.get(ODOMETRY, Counter()))
        topic = self._choose_topic(contents, ODOMETRY, named)
        if topic is not None or not contents.counts.keys() & {TRANSFORMS, TRANSFORMS_ROS1}:
            return OdometryTopic(topic)
        lidar = next((stream.frame for stream in contents.clocks.streams(self._chosen_scan_topic[0])), "")
        frames = find_odometry_frames(self._messages_to_read(final=False), contents.all, lidar)
        contents.base = contents.base if frames is None else frames[1]
        return OdometryTopic(None, frames)

    def _choose_topic(self, contents: Contents, msgtype: str, named: str | None) -> str | None:
        topics = contents.counts.get(msgtype, Counter())
        if named is None:
            return topics.most_common(1)[0][0] if topics else None
        if named not in topics:
            if msgtype == LASER_SCAN:
                topics = topics + contents.counts.get(POINT_CLOUD, Counter())
            available = ", ".join(sorted(topics)) or "none"
            raise RecordingError(self.path, None, f"no topic {named} of type {msgtype}; available: {available}")
        return named

    def _may_have_gyroscope(self) -> bool:
        return IMU in self._contents.counts

    def _empty_reason(self) -> str:
        return f"contains no readable {LASER_SCAN} and no {ODOMETRY}{self._topics()}"

    def _reason_without_scans(self) -> str:
        return f"contains no readable {LASER_SCAN}{self._topics()}"

    def _topics(self) -> str:
        """Return the topics of the recording as the end of a line of text, empty if none is known."""
        read = self._contents_of_all.counts.get(LASER_SCAN, Counter())
        topics = [
            f"{topic} ({msgtype}{'' if topic in read or msgtype != LASER_SCAN else ', but without a message'})"
            for topic, msgtype in sorted(self._stored_topics.items())
        ]
        if not topics:
            return ""
        more = len(topics) - SHOWN_TOPICS
        return f"; its topics are {', '.join(topics[:SHOWN_TOPICS])}{f' and {more} more' if more > 0 else ''}"


def _describe(cut: HeightCut) -> str:
    """Return where point clouds are cut, as text."""
    where = "at the height of the lidar" if cut.height is None else f"{cut.height:g} m above the base"
    return f"{where} ± {0.5 * cut.thickness:g} m"
