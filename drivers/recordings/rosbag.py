"""Reader for ROS 1 bags (.bag) and ROS 2 bags (a directory, or its .db3 file)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from ..errors import RecordingError
from .decompression import DecompressionError
from .ros_messages import LASER_SCAN, ODOMETRY, POSE
from .ros_reader import RosReader
from .rosbag_limits import limit_rosbags
from .stored_messages import StoredMessage

limit_rosbags()


class BagReader(RosReader):
    """ROS 1 or ROS 2 bag as a `Source`. A damaged bag is read up to the damage, which is counted in the report; a bag
    that cannot be opened raises RecordingError.
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
        return Reader1(self.path) if self.path.suffix == ".bag" else Reader2(self.path)

    def _stored_messages(self, final: bool) -> Iterator[StoredMessage]:
        encoding = "ros1" if self.path.suffix == ".bag" else "cdr"
        number = 0
        with ExitStack() as stack:
            try:
                reader = self._reader()
                stack.enter_context(reader)
                connections = [c for c in reader.connections if c.msgtype in self._types]
                stored = reader.messages(connections) if connections else iter(())
            except DecompressionError as error:
                raise RecordingError(self.path, None, str(error)) from error
            except Exception as error:  # rosbags raises exceptions of any type for damaged bags
                reason = " ".join(str(error).split()) or type(error).__name__
                raise RecordingError(self.path, None, f"is damaged or not a bag: {reason}") from error
            while True:
                try:
                    following = next(stored, None)
                except DecompressionError as error:
                    raise RecordingError(self.path, None, str(error)) from error
                except Exception:  # as above
                    if final:
                        self.skip(number + 1, "bag is truncated or damaged; it was read up to this point")
                    return
                if following is None:
                    return
                number += 1
                connection, received, data = following
                if data is None:  # NULL in a database
                    if final:
                        self.skip(number, "message has no data")
                    continue
                yield StoredMessage(number, connection.topic, connection.msgtype, encoding, received, bytes(data))
