"""The two seconds around an end, as they are read back from the ring after the loop has ended."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from fri_client.handover.last_samples import read_last_samples
from fri_client.handover.ring import Disposition, EventCode, HandoverRing
from fri_client.loop.result import LoopResult
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
)
from fri_client.wire.codec import Codec

MS = 1_000_000


def fill(ring: HandoverRing, ticks: int, stop_at: int | None) -> None:
    """One record per millisecond; the position of joint 1 is the tick in µrad."""
    codec = Codec(FriVersion.V1_15)
    for tick in range(ticks):
        message = MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, 500 + tick, 0),
            None,
            MonitorData(measured_joint_position=(tick * 1e-6,) + (0.0,) * 6, external_torque=(1.5,) * 7),
            ConnectionInfo(4, 3, 1, 1),
            IpoData(joint_position=(0.25,) * 7),
        )
        event = EventCode.GUARD if tick == stop_at else EventCode.NONE
        command = codec.encode_position_command(tick, 500 + tick, (tick * 2e-6,) * 7)
        time_ns = (10_000 + tick) * MS
        ring.push(time_ns, time_ns + MS // 5, 3, 1, tick, codec.encode_monitoring(message), command, event, 2, 9.0, 8.0)


@pytest.mark.parametrize(("stop_at", "first", "last"), [(4000, 2000, 6000), (6900, 4900, 6999), (None, 4999, 6999)])
def test_it_is_two_seconds_before_the_stop_and_two_after(stop_at: int | None, first: int, last: int) -> None:
    ring = HandoverRing.create(16384)
    fill(ring, 7000, stop_at)
    ring.read_batch(7000)
    ring.release()  # that the recorder has them already changes nothing
    kept = read_last_samples(ring, Codec(FriVersion.V1_15))
    columns = kept.columns
    assert (columns["index"][0], columns["index"][-1], len(kept)) == (first, last, last - first + 1)
    assert {len(values) for values in columns.values()} == {len(kept)}
    assert columns["sequence_counter"][0] == 500 + first
    assert columns["measured_position"][0][0] == pytest.approx(first * 1e-6)
    assert columns["sent_position"][0][6] == pytest.approx(first * 2e-6)
    assert columns["ipo_position"][0] == [0.25] * 7
    assert columns["external_torque"][0] == [1.5] * 7
    assert columns["host_receive_time_ns"][0] == (10_000 + first) * MS + ring.epoch_offset_ns
    assert columns["phase"][0] == "EXCITATION"
    assert [name for name in columns["event"] if name] == ["GUARD"] * (stop_at is not None)
    ring.close()


def test_a_ring_that_went_round_and_records_without_a_message_are_no_obstacle() -> None:
    ring = HandoverRing.create(64)
    for _ in range(3):
        fill(ring, 50, None)
        ring.read_batch(50)
        ring.release()
    ring.push(20_000 * MS, 0, 6, -1, -1, b"\xff\xffgarbage", None, disposition=Disposition.UNDECODABLE)
    ring.push(20_001 * MS, 0, 6, -1, -1, b"", None, EventCode.SILENCE, 0, 0.5, 0.5, Disposition.EVENT_ONLY)
    kept = read_last_samples(ring, Codec(FriVersion.V1_15))
    assert kept.columns["disposition"] == ["UNDECODABLE", "EVENT_ONLY"]
    assert kept.columns["measured_position"] == [None, None]
    assert kept.columns["session_state"] == [None, None]
    json.dumps(asdict(kept), allow_nan=False)
    ring.close()


def test_the_result_carries_them_with_the_reason() -> None:
    ring = HandoverRing.create(4096)
    fill(ring, 3000, 2500)
    result = LoopResult("stopped", "GUARD", "Joint 2 was too fast.", 2, 9.0, 8.0, tick=2501, criterion="velocity")
    result.keep_last_samples(read_last_samples(ring, Codec(FriVersion.V1_15)))
    kept = result.last_samples
    assert kept is not None
    assert len(kept) == 2500
    assert (kept.reason, kept.sentence) == ("GUARD", "Joint 2 was too fast.")
    assert (kept.criterion, kept.joint, kept.tick, kept.limit) == ("velocity", 2, 2501, 8.0)
    ring.close()
