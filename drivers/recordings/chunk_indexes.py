"""Index of the chunks of an MCAP file that is being written, with little memory."""

from __future__ import annotations

from collections.abc import Iterator

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex


class ChunkIndexes:
    """What `mcap.writer.Writer` needs of its list of chunk indexes: to append one, and to write all into the summary.

    Each is kept as the bytes of its record, some 140. As objects they take six times as much, and a recording of a
    robot that drives for days has two chunks a second.
    """

    def __init__(self) -> None:
        self._records = bytearray()

    def append(self, index: ChunkIndex) -> None:
        """Add the index of a chunk that was written."""
        builder = RecordBuilder()
        index.write(builder)
        self._records += builder.end()  # type: ignore[no-untyped-call]

    def __iter__(self) -> Iterator[ChunkIndexes]:
        """Yield one item, which writes all of them."""
        yield self

    def write(self, stream: RecordBuilder) -> None:
        """Write all records."""
        stream.write(self._records)
