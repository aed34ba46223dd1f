"""Bags of ROS 1 (.bag) and of ROS 2 (a directory, or its .db3 file)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from ..errors import RecordingError
from .ros_messages import LASER_SCAN, ODOMETRY, POSE
from .ros_reader import KINDS, Entry, RosRecording


class Bag(RosRecording):
    """A bag of ROS 1 or 2 as a `Source`. A bag that is damaged is read as far as it goes, which is counted
    in the report; one that cannot be opened raises RecordingError.
    """

    def __len__(self) -> int:
        """The number of messages of the types that are read, as the bag's index says."""
        try:
            reader = self._reader()
            with reader:
                return sum(c.msgcount for c in reader.connections if c.msgtype in (LASER_SCAN, ODOMETRY, POSE))
        except Exception:  # as in _entries; the length is a mere hint
            return 0

    def _reader(self) -> Reader1 | Reader2:
        return Reader1(self.path) if self.path.suffix == ".bag" else Reader2(self.path)

    def _entries(self, final: bool) -> Iterator[Entry]:
        encoding = "ros1" if self.path.suffix == ".bag" else "cdr"
        number = 0
        with ExitStack() as stack:
            try:
                reader = self._reader()
                stack.enter_context(reader)
                connections = [c for c in reader.connections if c.msgtype in KINDS]
                stored = reader.messages(connections) if connections else iter(())
            except Exception as error:  # rosbags raises whatever its parsers trip over in a damaged bag
                reason = " ".join(str(error).split()) or type(error).__name__
                raise RecordingError(self.path, None, f"is damaged or no bag: {reason}") from error
            while True:
                try:
                    following = next(stored, None)
                except Exception:  # as above
                    if final:
                        self.skip(number + 1, "bag ends early or is damaged; it was read up to there")
                    return
                if following is None:
                    return
                number += 1
                connection, received, data = following
                yield Entry(number, connection.topic, connection.msgtype, encoding, received, bytes(data))
