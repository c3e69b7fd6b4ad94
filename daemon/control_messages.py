"""What recorders tell the supervisor over ZeroMQ: one tagged union of typed messages, `ControlMessage`."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from daemon.api import Message


class RecorderReady(Message, frozen=True, kw_only=True, tag="recorder_ready"):
    """The recorder has opened its file and drains the ring."""

    part: int


class RecorderProgress(Message, frozen=True, kw_only=True, tag="recorder_progress"):
    """The recorder lives and has written so many samples so far."""

    part: int
    samples: int


class RecorderFinished(Message, frozen=True, kw_only=True, tag="recorder_finished"):
    """The file is closed, re-opened and counted: the samples are in it."""

    part: int
    samples: int
    samples_in_periods: int
    last_index: int
    sequence_gaps: int
    handover_gaps: int


class RecorderTrouble(Message, frozen=True, kw_only=True, tag="recorder_trouble"):
    """The disk refused for now; nothing is lost yet. reserve_opened: the room set aside for this was given back."""

    part: int
    sentence: str
    reserve_opened: bool


class RecorderFailed(Message, frozen=True, kw_only=True, tag="recorder_failed"):
    """The disk refused for good; what is not in the file is still in the ring."""

    part: int
    sentence: str


ControlMessage: TypeAlias = RecorderReady | RecorderProgress | RecorderFinished | RecorderTrouble | RecorderFailed

_control_decoder: msgspec.json.Decoder[ControlMessage] = msgspec.json.Decoder(ControlMessage)
MAXIMUM_CONTROL_BYTES = 65536


def decode_control(data: bytes) -> ControlMessage:
    """The message behind the bytes. Raises msgspec.DecodeError for anything else, however it is malformed."""
    if len(data) > MAXIMUM_CONTROL_BYTES:
        raise msgspec.DecodeError(f"control message of {len(data)} bytes; at most {MAXIMUM_CONTROL_BYTES} are taken")
    try:
        return _control_decoder.decode(data)
    except (UnicodeDecodeError, RecursionError) as error:
        raise msgspec.DecodeError(str(error)) from error
