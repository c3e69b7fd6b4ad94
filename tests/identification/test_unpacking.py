"""Claims about small files that unpack to large ones: one sentence, and no more memory than a recording needs.

Truth: the peak memory of a process of its own, as the kernel counted it.
"""

from __future__ import annotations

import io
import json
import sqlite3
import struct
import subprocess
import sys
import zipfile
from contextlib import closing
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionMode

from identification.errors import RecordingError
from identification.recordings import read_recording
from identification.recordings.bag import bag_files
from identification.recordings.unpacking import SMALLEST_ALLOWANCE, Allowance
from tests.identification.bags import JOINT_STATE, STORE, messages_of, write_bag

NAMES = [f"A{joint}" for joint in range(1, 8)]
MEMORY_MB = 700
"""Of which the libraries take 150: 64 MB may be unpacked, and are held a few times over."""
READ = """
import json, sys
from identification.errors import RecordingError
from identification.recordings import read_recording
try:
    read_recording(sys.argv[1])
    text = ""
except RecordingError as error:
    text = str(error)
# Not getrusage: a process that was forked from a large one begins with the peak of that.
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([text, int(peak.split()[1]) / 1024]))
"""


def assert_refused_cheaply(path: Path) -> str:
    done = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True)
    text, memory_mb = json.loads(done.stdout)
    assert memory_mb < MEMORY_MB
    assert text.count(". ") == 0
    return str(text)


def write_zeros(path: Path, rows: int) -> Path:
    """An .npz of seven joints that stand at zero."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, shape in (("t", (rows,)), ("q", (rows, 7)), ("tau", (rows, 7))):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                description = {"descr": "<f8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, description)
                member.write(bytes(8 * int(np.prod(shape))))
    return path


def write_repeated(path: Path, count: int, compression: CompressionType) -> Path:
    """An .mcap of one message over and over, without any index."""
    (item,) = messages_of([1.0], NAMES, np.zeros((1, 7)), np.zeros((1, 7)))
    packed = item.pack()
    definition, _ = STORE.generate_msgdef(JOINT_STATE, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=16 * 2**20, index_types=IndexType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for _ in range(count):
            writer.add_message(channel, 0, packed, 0)
        writer.finish()
    return path


def test_two_megabytes_of_npz_do_not_become_gigabytes(tmp_path: Path) -> None:
    path = write_zeros(tmp_path / "a.npz", 2_000_000)
    assert path.stat().st_size < 2e6
    assert "unpack to more than" in assert_refused_cheaply(path)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_small_mcap_does_not_become_gigabytes(tmp_path: Path, compression: CompressionType) -> None:
    path = write_repeated(tmp_path / "a.mcap", 400_000, compression)
    assert path.stat().st_size < 6e5
    assert "unpack to more than" in assert_refused_cheaply(path)


def test_an_import_inside_a_log_is_bounded_too(tmp_path: Path) -> None:
    zeros = write_zeros(tmp_path / "a.npz", 2_000_000).read_bytes()
    with (tmp_path / "import.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        writer.add_attachment(0, 0, "recording.npz", "application/x-npz", zeros)
        writer.finish()
    assert "unpack to more than" in assert_refused_cheaply(tmp_path / "import.mcap")


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_compressed_bag_is_bounded_too(tmp_path: Path, mode: CompressionMode) -> None:
    (item,) = messages_of([1.0], NAMES, np.zeros((1, 7)), np.zeros((1, 7)))
    folder = write_bag(tmp_path / "bag", [item], compression=mode)
    (file,) = bag_files(folder)
    if mode == CompressionMode.FILE:
        file.write_bytes(zstandard.compress(bytes(2 * SMALLEST_ALLOWANCE)))
    else:
        with closing(sqlite3.connect(file)) as database:
            database.execute("UPDATE messages SET data = ?", (zstandard.compress(bytes(2 * SMALLEST_ALLOWANCE)),))
            database.commit()
    assert "unpack to more than" in assert_refused_cheaply(folder)


def test_a_block_that_is_larger_than_it_states_is_not_unpacked(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(b"x")
    for compression, data in (("zstd", zstandard.compress(bytes(10**6))), ("lz4", lz4.frame.compress(bytes(10**6)))):
        with pytest.raises(RecordingError, match="more than the 1000 bytes it states"):
            Allowance(file).unpack(data, compression, 1000)
        assert Allowance(file).unpack(data, compression, 10**6) == bytes(10**6)


def test_headers_that_promise_memory_are_not_believed(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in ("t", "q", "tau"):
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(100))
    assert "cannot be read" in assert_refused_cheaply(tmp_path / "a.npz")
    record = struct.pack("<BQ", 5, 2**40) + bytes(100)
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + record)
    assert "no complete chunk" in assert_refused_cheaply(tmp_path / "a.mcap")


def test_real_recordings_are_far_from_the_bound(tmp_path: Path) -> None:
    """Rest and zeros compress best: twenty seconds at 1 kHz in which nothing moves are still read."""
    rows = 20_000
    np.savez_compressed(
        tmp_path / "rest.npz", t=np.arange(rows) * 1e-3, q=np.zeros((rows, 7)), tau=np.zeros((rows, 7)),
        q_link=np.zeros((rows, 7)), q_cmd=np.zeros((rows, 7)), robot="iiwa14",
    )  # fmt: skip
    assert read_recording(tmp_path / "rest.npz").samples == rows
    motion = np.random.default_rng(0).normal(size=(rows, 7)).round(3)
    np.savez_compressed(tmp_path / "moving.npz", t=np.arange(rows) * 1e-3, q=motion, tau=motion)
    unpacked = 15 * 8 * rows
    assert unpacked < 10 * (tmp_path / "moving.npz").stat().st_size
