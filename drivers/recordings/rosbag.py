"""Reader for ROS 1 bags (.bag, .bag.active) and ROS 2 bags (a directory, or its .db3 file)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, suppress
from itertools import count

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from ..errors import RecordingError
from .decompression import DecompressionError
from .ros_messages import LASER_SCAN, ODOMETRY, POSE
from .ros_reader import RosReader
from .rosbag_limits import limit_rosbags
from .stored_messages import StoredMessage
from .unindexed_bag import read_unindexed

ROS1_SUFFIXES = (".bag", ".active")
"""Suffixes of ROS 1 bags; `.active` is that of a bag that the recorder has not closed."""
OLD_MAGIC = b"#ROSRECORD"
"""First bytes of bags of the versions 1.1 and 1.2."""

limit_rosbags()


class BagReader(RosReader):
    """ROS 1 or ROS 2 bag as a `Source`. A damaged bag is read up to the damage, which is counted in the report, a ROS 1
    bag also without its index; a bag that cannot be opened raises RecordingError.
    """

    def __len__(self) -> int:
        """Return the number of messages of the supported types, from the bag's index."""
        try:
            reader = self._reader()
            with reader:
                return sum(c.msgcount for c in reader.connections if c.msgtype in (LASER_SCAN, ODOMETRY, POSE))
        except Exception:  # see _stored_messages; the length is only approximate
            return 0

    def _reader(self) -> Reader1 | Reader2:
        return Reader1(self.path) if self._is_ros1 else Reader2(self.path)

    @property
    def _is_ros1(self) -> bool:
        return self.path.suffix in ROS1_SUFFIXES

    def _stored_messages(self, final: bool) -> Iterator[StoredMessage]:
        encoding = "ros1" if self._is_ros1 else "cdr"
        with ExitStack() as stack:
            messages = self._opened(stack, final)
            for number in count(1):
                try:
                    following = next(messages, None)
                except DecompressionError as error:
                    raise RecordingError(self.path, None, str(error)) from error
                except Exception:  # rosbags raises exceptions of any type for damaged bags
                    if final:
                        self.skip(number, "bag is truncated or damaged; it was read up to this point")
                    return
                if following is None:
                    return
                topic, msgtype, received, data = following
                if not isinstance(data, bytes | bytearray | memoryview):  # NULL or a number in a database
                    if final:
                        self.skip(number, "message has no data")
                    continue
                yield StoredMessage(number, topic, msgtype, encoding, received, bytes(data))

    def _opened(self, stack: ExitStack, final: bool) -> Iterator[tuple[str, str, int, object]]:
        """Return topic, type, time of reception and data of the messages, by the bag's index if it has one.

        The bag stays open until `stack` is closed. Raises RecordingError if it cannot be opened.
        """
        try:
            reader = self._reader()
            stack.enter_context(reader)
            self._stored_topics = {c.topic: c.msgtype for c in reader.connections}
            if not all(isinstance(text, str) for pair in self._stored_topics.items() for text in pair):
                raise ValueError("a topic or its type is no text")
            connections = [c for c in reader.connections if c.msgtype in self._types]
            stored = reader.messages(connections) if connections else iter(())
        except DecompressionError as error:
            raise RecordingError(self.path, None, str(error)) from error
        except Exception as error:  # as above
            self._stored_topics = {}
            if not self._is_readable_without_index():
                raise RecordingError(self.path, None, self._reason(error)) from error
            if final:
                self.interpret("records in the order of the file, since the index of the bag is missing or damaged")
            return read_unindexed(self.path, self._types, self._stored_topics)
        return ((connection.topic, connection.msgtype, received, data) for connection, received, data in stored)

    def _is_readable_without_index(self) -> bool:
        """Return true for a ROS 1 bag of whose records a message of a supported type can be read, or all records."""
        if not self._is_ros1:
            return False
        try:
            next(read_unindexed(self.path, self._types, self._stored_topics), None)
            return bool(self._stored_topics)
        except DecompressionError:  # raised again when the messages are read
            return True
        except (ValueError, OSError):
            return False

    def _reason(self, error: Exception) -> str:
        """Return why the bag cannot be opened."""
        if self._is_ros1:
            with suppress(OSError), self.path.open("rb") as file:
                if file.read(len(OLD_MAGIC)) == OLD_MAGIC:
                    return "is a bag of before 2010; `rosbag filter OLD.bag NEW.bag True` of ROS 1 converts it"
        reason = " ".join(str(error).split())
        return f"is damaged or not a bag{f': {reason}' if reason else ''}"
