"""What recorder and worker tell the supervisor over ZeroMQ: one tagged union of typed messages, `ControlMessage`."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from daemon.api import Message, WorkerStatus

__all__ = [
    "MAXIMUM_CONTROL_BYTES",
    "ControlMessage",
    "RecorderFailed",
    "RecorderFinished",
    "RecorderProgress",
    "RecorderReady",
    "RecorderTrouble",
    "WorkerProgress",
    "decode_control",
    "encode_control",
]


class RecorderReady(Message, frozen=True, kw_only=True, tag="recorder_ready"):
    """The recorder has opened its file and drains the ring."""

    part: int
    path: str
    pid: int


class RecorderProgress(Message, frozen=True, kw_only=True, tag="recorder_progress"):
    """So far: samples written, gaps found, bytes on disk, records waiting in the ring."""

    part: int
    samples: int
    sequence_gaps: int
    handover_gaps: int
    undecodable: int
    bytes: int
    backlog: int


class RecorderFinished(Message, frozen=True, kw_only=True, tag="recorder_finished"):
    """The file is closed, re-opened and counted; `counted` is the number of samples found in it."""

    part: int
    path: str
    samples: int
    counted: int
    samples_in_periods: int
    first_index: int
    last_index: int
    sequence_gaps: int
    handover_gaps: int
    undecodable: int
    bytes: int


class RecorderTrouble(Message, frozen=True, kw_only=True, tag="recorder_trouble"):
    """The disk refused for now; nothing is lost yet. reserve_opened: the room set aside for this was given back."""

    part: int
    sentence: str
    errno: int | None
    reserve_opened: bool


class RecorderFailed(Message, frozen=True, kw_only=True, tag="recorder_failed"):
    """The disk refused. Samples from `first_unwritten_index` on are not in the file."""

    part: int
    path: str
    sentence: str
    errno: int | None
    samples: int
    first_unwritten_index: int


class WorkerProgress(Message, frozen=True, kw_only=True, tag="worker_progress"):
    """A worker's status, pushed as it is written to the status file."""

    status: WorkerStatus


ControlMessage: TypeAlias = (
    RecorderReady | RecorderProgress | RecorderFinished | RecorderTrouble | RecorderFailed | WorkerProgress
)

_encoder = msgspec.json.Encoder()
_control_decoder: msgspec.json.Decoder[ControlMessage] = msgspec.json.Decoder(ControlMessage)
MAXIMUM_CONTROL_BYTES = 65536


def encode_control(message: ControlMessage) -> bytes:
    """JSON bytes of a control message, with its tag."""
    return _encoder.encode(message)


def decode_control(data: bytes) -> ControlMessage:
    """The message behind the bytes. Raises msgspec.DecodeError for anything else, however it is malformed."""
    if len(data) > MAXIMUM_CONTROL_BYTES:
        raise msgspec.DecodeError(f"control message of {len(data)} bytes; at most {MAXIMUM_CONTROL_BYTES} are taken")
    try:
        return _control_decoder.decode(data)
    except (UnicodeDecodeError, RecursionError) as error:
        raise msgspec.DecodeError(str(error)) from error
