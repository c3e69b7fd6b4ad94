"""The index of chunks while a log is being written, as packed bytes instead of one object per chunk.

Here: the stand-in for the list that the mcap library's writer keeps until the file is closed. Not here: the writing.
A chunk a quarter of a second makes 7200 entries in half an hour: 1 MB packed, ten times that as objects with their
dictionaries, in a process that shares two cores and their memory with a 1 kHz loop.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex

_ATTRIBUTE = "_Writer__chunk_indices"


class PackedChunkIndexes:
    """What the library does with its list and no more: `append` an index, and write all of them one after the other."""

    def __init__(self) -> None:
        self._packed = bytearray()

    def append(self, index: ChunkIndex) -> None:
        """Keep the record as it will stand in the file's summary."""
        # Any: the library annotates only part of its methods.
        builder: Any = RecordBuilder()
        index.write(builder)
        self._packed += builder.end()

    def __iter__(self) -> Iterator[PackedChunkIndexes]:
        """One element that writes every record."""
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """All records, in the order of the chunks."""
        builder.write(self._packed)


def pack_chunk_indexes_of(writer: Any) -> None:
    """Make an mcap Writer keep its chunk indexes packed.

    The list is private to the library; one that calls it otherwise keeps its own, which costs memory and nothing else.
    """
    if getattr(writer, _ATTRIBUTE, None) == []:
        setattr(writer, _ATTRIBUTE, PackedChunkIndexes())
