"""Reads logs and bags: runs of this project (/fri/state), imports (their arrays), ROS 2 bags (JointState).

A file that breaks off still gives all of its complete chunks. Logs are written elsewhere.
"""

from __future__ import annotations

from pathlib import Path

from identification.errors import RecordingError
from identification.recordings import archive
from identification.recordings.bag import FRI_STATE_TOPIC, Bag, bag_files, read_bag
from identification.recordings.fri_log import read_fri_log
from identification.recordings.joint_states import read_joint_states
from identification.recordings.recording import Finding, Recording
from identification.recordings.table import RawTable


def read_log(path: Path) -> list[RawTable] | Recording:
    """Tables that an .mcap or .db3 holds, one for each topic that may be meant, or the Recording of an import.

    Raises RecordingError when the file is neither, or holds neither /fri/state nor a JointState with effort.
    """
    return _read(path, read_bag((path,), path))


def read_bag_folder(path: Path) -> list[RawTable] | Recording:
    """The same of a folder that ROS 2 recorded, all of its files together. Raises RecordingError where it is none."""
    files = bag_files(path)
    if not files:
        raise RecordingError.at(path, "is a folder with neither recording.mcap nor a ROS 2 bag in it")
    return _read(path, read_bag(files, path))


def _read(path: Path, bag: Bag) -> list[RawTable] | Recording:
    if archive.ATTACHMENT_NAME in bag.damaged:
        raise RecordingError.named(
            path,
            f"the bytes of its attachment {archive.ATTACHMENT_NAME}, which holds the recording, are damaged (their "
            "checksum does not fit); import the original once more",
        )
    if bag.archive is not None:
        return archive.unpack(bag.archive, path)
    tables = [read_fri_log(path, bag)] if FRI_STATE_TOPIC in bag.topics else read_joint_states(path, bag)
    if bag.broken_off:
        for table in tables:
            rows = table.time.shape[0]
            sentence = f"the file breaks off after row {rows} ({bag.broken_off}); its complete chunks were read"
            table.findings.append(Finding("truncated_file", max(rows, 1), max(rows, 1), 1, sentence))
    for name in bag.damaged:
        for table in tables:
            sentence = f"the attachment '{name}' is damaged, its checksum does not fit; no sample stands in it"
            table.findings.append(Finding.of_all("damaged_attachment", table.time.shape[0], sentence))
    return tables
