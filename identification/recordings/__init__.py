"""Recordings of a robot's motion and torque, whoever made them: one value object, one reader per file suffix.

Here: the Recording value object, readers (.npz, .csv, .mcap), what an import found wrong with the rows, the writer of
imported recordings. Not here: averaging, filtering, differentiation (identification.signals).
"""

from __future__ import annotations

from identification.recordings.independence import recording_names, refuse_repeated, refuse_shared_samples
from identification.recordings.reader import read_recording
from identification.recordings.recording import Finding, ImportReport, Recording, RecordingSource
from identification.recordings.writer import write_recording

__all__ = [
    "Finding",
    "ImportReport",
    "Recording",
    "RecordingSource",
    "read_recording",
    "recording_names",
    "refuse_repeated",
    "refuse_shared_samples",
    "write_recording",
]
