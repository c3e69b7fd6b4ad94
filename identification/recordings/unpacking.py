"""How much a compressed file may become in memory: a small file that unpacks to gigabytes is refused, not obeyed.

Measured motion and torque hardly compress (a factor of 2 to 15); a factor of 100 is room enough.
"""

from __future__ import annotations

from pathlib import Path

import lz4.frame
import zstandard

from identification.errors import RecordingError

LARGEST_FACTOR = 100
SMALLEST_ALLOWANCE = 64 * 2**20
LARGEST_ALLOWANCE = 4 * 2**30


class Allowance:
    """Bytes that one file may still unpack to: 100 times its size, at least 64 MB, at most 4 GB."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.whole = min(max(LARGEST_FACTOR * self.size, SMALLEST_ALLOWANCE), LARGEST_ALLOWANCE)
        self.left = self.whole

    def take(self, count: int) -> None:
        """Count bytes about to be unpacked. Raises RecordingError where they are more than may be."""
        self.left -= count
        if self.left < 0:
            raise RecordingError.named(
                self.path,
                f"its {_size(self.size)} unpack to more than {_size(self.whole)}, which no "
                "recording of this size does; nothing of it was used",
            )

    def unpack(self, data: bytes, compression: str, claimed: int) -> bytes:
        """Bytes of a block compressed as "zstd", "lz4" or "" (not at all).

        claimed: how many the file says they are. Raises RecordingError where they are more than that or than may be.
        """
        if compression == "":
            return data
        self.take(claimed)
        match compression:
            case "zstd":
                with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                    unpacked = stream.read(claimed + 1)
            case "lz4":
                unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, claimed + 1)
            case _:
                raise RecordingError.named(self.path, f"is compressed with '{compression}'")
        if len(unpacked) > claimed:
            raise RecordingError.named(self.path, f"a block unpacks to more than the {claimed} bytes it states")
        return unpacked


def _size(count: int) -> str:
    for unit, bytes_ in (("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if count >= bytes_:
            return f"{count / bytes_:.3g} {unit}"
    return f"{count} bytes"
