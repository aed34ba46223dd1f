"""Serialised messages of a ROS recording, and which of them contain its odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from ..messages import Odometry
from .ros_messages import ODOMETRY, TRANSFORMS, TRANSFORMS_ROS1, decode, odometry_of
from .tf_odometry import TransformOdometry
from .transforms import TransformTree, is_odometry_frame, normalize_frame

TRUE_POSES = "ground_truth"
"""Part of the names of topics on which simulators publish the true poses of a robot as Odometry."""


@dataclass(frozen=True, slots=True)
class StoredMessage:
    """Serialised ROS message of a recording.

    number    1-based
    msgtype   ROS type name, as ROS 2 writes it
    encoding  cdr or ros1
    received  time of reception, nanoseconds
    """

    number: int
    topic: str
    msgtype: str
    encoding: str
    received: int
    data: bytes


@dataclass(frozen=True, slots=True)
class OdometryTopic:
    """Where the odometry of a recording is.

    topic   of type Odometry; None if it is not in such messages
    frames  frame of the odometry and frame of the base whose transforms are the odometry; None for a topic
    """

    topic: str | None
    frames: tuple[str, str] | None = None

    def is_in(self, stored: StoredMessage) -> bool:
        """Return true if a message may contain odometry."""
        if self.frames is not None:
            return is_moving_transform(stored)
        return stored.msgtype == ODOMETRY and stored.topic == self.topic

    def readings(self, stored: StoredMessage) -> list[Odometry]:
        """Return the odometry in a message; raises ValueError if it is invalid."""
        message = decode(stored.data, stored.msgtype, stored.encoding)
        if self.frames is None:
            return [odometry_of(message, stored.received)]
        return TransformOdometry(*self.frames, TransformTree()).readings(message, stored.received)


def choose_odometry_topic(counts: Counter[str]) -> str | None:
    """Return the topic with the most messages, one with the true poses of a simulator only if there is no other.

    counts  messages of each topic of type Odometry; None is returned if there is none
    """
    measured = Counter({topic: count for topic, count in counts.items() if TRUE_POSES not in topic})
    return next((topic for topic, _ in (measured or counts).most_common(1)), None)


def describe_odometry_choice(counts: Counter[str], chosen: str | None, *, named: bool) -> str | None:
    """Return which topic is read as odometry as one line of text; None if there was no choice and it is measured.

    named  true if the user has named the topic
    """
    if chosen is None or (len(counts) < 2 and TRUE_POSES not in chosen):
        return None
    others = ", ".join(f"{topic}: {count}" for topic, count in counts.items() if topic != chosen)
    return (
        f"odometry of {chosen}: {counts[chosen]} messages"
        + (f" ({others})" if others else "")
        + (", true poses by its name" if TRUE_POSES in chosen else "")
        + ("; odometry.topic names another topic" if others and not named else "")
    )


def is_moving_transform(stored: StoredMessage) -> bool:
    """Return true for messages with transforms that may change."""
    return stored.msgtype in (TRANSFORMS, TRANSFORMS_ROS1) and not stored.topic.endswith("tf_static")


def find_odometry_frames(
    messages: Iterable[StoredMessage], transforms: TransformTree, lidar: str
) -> tuple[str, str] | None:
    """Return the frame of the odometry and the frame that it moves, from the transforms of a recording.

    Of several such transforms it is one that moves the lidar, if transforms connect that with its base, and of these
    the one sent most often; None if there is none.

    transforms  of the robot
    lidar       frame of the scans; empty if it is unknown
    """
    counts: Counter[tuple[str, str]] = Counter()
    for stored in messages:
        if is_moving_transform(stored):
            with suppress(ValueError):  # counted on the final pass
                for stamped in decode(stored.data, stored.msgtype, stored.encoding).transforms:
                    frames = normalize_frame(stamped.header.frame_id), normalize_frame(stamped.child_frame_id)
                    counts[frames] += is_odometry_frame(frames[0])
    moved = Counter(
        {frames: n for frames, n in counts.items() if n and transforms.mount_on(frames[1], lidar).pose is not None}
    )
    found = (moved or counts).most_common(1)
    return found[0][0] if counts.total() else None
