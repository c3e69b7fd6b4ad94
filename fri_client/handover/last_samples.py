"""The last two seconds before an end: samples, answers and labels, read back from the hand-over ring.

The ring keeps what was pushed until its slot is used again, whether the recorder has taken it or not, so nothing has to
be kept aside while the loop runs, and whoever outlives a killed loop can still read its last seconds. Called once, by
the loop when a run ended otherwise than as planned, or by the supervisor when there is no loop any more.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fri_client.errors import CodecError
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, EventCode, HandoverRecord, HandoverRing
from fri_client.messages import ConnectionInfo, IpoData, MonitorData, name_or_number
from fri_client.wire.codec import Codec

LAST_SAMPLES_S = 2.0

AFTERWARDS_S = 2.0
"""What comes after the stop or drop is kept as well, for so long: the ramp, and whether the arm came to rest."""

_MOST_RECORDS = 16384
"""Where to look; the wait for a standstill takes up to 5 s."""

_NO_MONITOR, _NO_CONNECTION, _NO_IPO = MonitorData(), ConnectionInfo(0, 0), IpoData()

_ENDS = frozenset(int(code) for code in EventCode if code.is_stop_reason or code is EventCode.SESSION_DROP)


@dataclass(slots=True)
class LastSamples:
    """What came in and went out around an end, one row per record of the ring, oldest first.

    columns: name -> values, all equally long, None where a record has no such value.
        host_receive_time_ns, host_send_time_ns: Unix time in ns (0: not answered); sequence_counter: the robot's;
        phase: name of the MotionPhase; period, sample_in_period: place in the table of the command sent, -1 outside
        EXCITATION; session_state, quality: as numbers; measured_position, ipo_position, sent_position,
        robot_commanded_position (what the robot says it was commanded, 1.x only): 7 values in rad;
        measured_torque, external_torque: 7 values in Nm with the vendor's signs; disposition: name of the Disposition;
        event: name of the EventCode, event_joint from 1, event_value, event_limit.
    The other fields say why the run ended: see LoopResult.
    """

    reason: str = ""
    sentence: str = ""
    criterion: str = ""
    joint: int | None = None
    value: float | None = None
    limit: float | None = None
    tick: int | None = None
    columns: dict[str, list[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.columns.get("index", ()))


def read_last_samples(ring: HandoverRing, codec: Codec) -> LastSamples:
    """The records from LAST_SAMPLES_S before the stop or drop to AFTERWARDS_S after it; without either, the last ones.

    Why the run ended is filled in by the caller.
    """
    records = ring.newest(_MOST_RECORDS)
    if records:
        ends = [record.receive_ns for record in records if record.event_code in _ENDS]
        end_ns = ends[0] if ends else records[-1].receive_ns
        since, until = end_ns - LAST_SAMPLES_S * 1e9, end_ns + AFTERWARDS_S * 1e9
        records = [record for record in records if since <= record.receive_ns <= until]
    rows = [_row(record, codec, ring.epoch_offset_ns) for record in records]
    names = rows[0].keys() if rows else ()
    return LastSamples(columns={name: [row[name] for row in rows] for name in names})


def _row(record: HandoverRecord, codec: Codec, epoch_offset_ns: int) -> dict[str, Any]:
    counter: int | None = None
    monitor, connection, ipo = _NO_MONITOR, _NO_CONNECTION, _NO_IPO
    sent: list[float] | None = None
    try:
        if record.monitoring:
            message = codec.decode_monitoring(record.monitoring)
            counter = message.header.sequence_counter
            monitor = message.monitor_data or monitor
            connection = message.connection_info or connection
            ipo = message.ipo_data or ipo
        if record.command is not None:
            data = codec.decode_command(record.command).command_data
            sent = _listed(None if data is None else data.joint_position)
    except CodecError:
        pass  # the record of an undecodable datagram says so itself
    known = counter is not None
    return {
        "index": record.index,
        "host_receive_time_ns": record.receive_ns + epoch_offset_ns,
        "host_send_time_ns": record.send_ns + epoch_offset_ns if record.send_ns else 0,
        "sequence_counter": counter,
        "phase": name_or_number(MotionPhase, record.phase),
        "period": record.period,
        "sample_in_period": record.sample_in_period,
        "session_state": connection.session_state if known else None,
        "quality": connection.quality if known else None,
        "measured_position": _listed(monitor.measured_joint_position),
        "ipo_position": _listed(ipo.joint_position),
        "sent_position": sent,
        "robot_commanded_position": _listed(monitor.commanded_joint_position),
        "measured_torque": _listed(monitor.measured_torque),
        "external_torque": _listed(monitor.external_torque),
        "disposition": name_or_number(Disposition, record.disposition),
        "event": name_or_number(EventCode, record.event_code) if record.event_code else None,
        "event_joint": record.event_joint,
        "event_value": record.event_value,
        "event_limit": record.event_limit,
    }


def _listed(values: tuple[float, ...] | None) -> list[float] | None:
    return None if values is None else list(values)
