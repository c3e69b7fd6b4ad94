"""Claims about MCAP recordings: the run's own logs, and files that break off. Bags of ROS 2: `test_recordings_bag`.

Truth: messages packed by rosbags from message definitions written here; the reader knows them only from the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from identification.errors import RecordingError
from identification.recordings import read_recording, write_recording
from identification.report.link import read_loop_report

ROWS, STEP_NS = 1200, 1_000_000
FRI_STATE = """
float64[7] measured_joint_position
float64[7] measured_torque
float64[7] commanded_joint_position
float64[7] external_torque
float64[7] ipo_joint_position
uint32 sequence_counter
uint32 robot_time_sec
uint32 robot_time_nanosec
uint32 send_period_ms
int32 motion_phase
int32 period
int32 sample_in_period
bool measured_joint_position_valid
bool measured_torque_valid
bool robot_time_valid
bool duplicate
bool out_of_order
float64[] trailing_values
"""
STATE_NAME = "iiwa_ident_msgs/msg/FriState"


def _states(rows: int = ROWS) -> list[dict[str, Any]]:
    """200 ticks before, 4 periods of 200 samples, 200 ticks after; the vendor's torque sign."""
    time = np.arange(rows) * 1e-3
    position = np.sin(3.0 * time[:, None] + np.arange(7))
    torque = 10.0 * np.cos(3.0 * time[:, None] + np.arange(7)) + np.random.default_rng(0).normal(size=(rows, 7))
    states = []
    for row in range(rows):
        excited = 200 <= row < 1000
        stamp = 1_700_000_000 * 10**9 + row * STEP_NS
        states.append(
            {
                "measured_joint_position": position[row],
                "measured_torque": -torque[row],
                "commanded_joint_position": np.full(7, np.nan),
                "external_torque": 0.1 * torque[row],
                "ipo_joint_position": position[row] + 1e-4,
                "sequence_counter": (2**32 - 100 + row) % 2**32,
                "robot_time_sec": stamp // 10**9,
                "robot_time_nanosec": stamp % 10**9,
                "send_period_ms": 1,
                "motion_phase": 3 if excited else 1,
                "period": (row - 200) // 200 if excited else -1,
                "sample_in_period": (row - 200) % 200 if excited else -1,
                "measured_joint_position_valid": True,
                "measured_torque_valid": True,
                "robot_time_valid": True,
                "duplicate": False,
                "out_of_order": False,
                "trailing_values": np.arange(row % 3, dtype=np.float64),
            }
        )
    return states


def _write_log(
    path: Path,
    states: list[dict[str, Any]],
    metadata: dict[str, str] | None = None,
    compression: CompressionType = CompressionType.ZSTD,
    attachments: dict[str, bytes] | None = None,
) -> Path:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(FRI_STATE, STATE_NAME))
    message = store.types[STATE_NAME]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=16 * 1024, compression=compression)
        writer.start("ros2", "test")
        if metadata is not None:
            writer.add_metadata("iiwa_ident", metadata)
        for name, data in (attachments or {}).items():
            writer.add_attachment(0, 0, name, "application/json", data)
        schema = writer.register_schema(STATE_NAME, "ros2msg", FRI_STATE.encode())
        channel = writer.register_channel("/fri/state", "cdr", schema)
        for row, state in enumerate(states):
            writer.add_message(
                channel, row * STEP_NS, bytes(store.serialize_cdr(message(**state), STATE_NAME)), row * STEP_NS
            )
        writer.finish()
    return path


METADATA = {"robot": "iiwa14", "period_s": "0.2", "samples_per_period": "200"}


def test_own_log_gets_the_inverse_dynamics_sign_and_the_labels_of_the_run(tmp_path: Path) -> None:
    states = _states()
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    np.testing.assert_array_equal(recording.torque, [-state["measured_torque"] for state in states])
    np.testing.assert_array_equal(recording.position, [state["measured_joint_position"] for state in states])
    np.testing.assert_array_equal(recording.period_index, [state["period"] for state in states])
    np.testing.assert_array_equal(recording.sample_in_period, [state["sample_in_period"] for state in states])
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 1e-3, atol=1e-12)
    assert recording.external_torque is not None
    np.testing.assert_array_equal(recording.external_torque[5], states[5]["external_torque"])
    assert (recording.robot, recording.period_s, recording.samples_per_period) == ("iiwa14", 0.2, 200)
    assert recording.complete_periods == 4
    assert recording.report.findings == ()


def test_lost_messages_are_seen_by_the_sequence_counter(tmp_path: Path) -> None:
    states = _states()
    del states[500:507]
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    (lost,) = recording.report.of_kind("lost_samples")
    assert lost.count == 7
    assert recording.samples == ROWS - 7
    assert recording.report.of_kind("gap")[0].count == 1


def test_a_counter_that_wraps_loses_nothing_and_still_tells_what_is_lost(tmp_path: Path) -> None:
    states = [{**state, "sequence_counter": (2**32 - 600 + row) % 2**32} for row, state in enumerate(_states())]
    del states[598:603]
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    assert [item.count for item in recording.report.of_kind("lost_samples")] == [5]


@pytest.mark.parametrize("has_clock", [True, False])
@pytest.mark.parametrize("anew", [0, 7, 5_000_000])
def test_a_counter_that_begins_anew_is_no_loss_of_millions(tmp_path: Path, anew: int, has_clock: bool) -> None:
    states = [{**state, "robot_time_valid": has_clock} for state in _states()]
    for row in range(600, ROWS):
        states[row]["sequence_counter"] = anew + row - 600
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    assert not recording.report.of_kind("lost_samples")
    assert recording.report.of_kind("counter_restart")[0].first_row == 600
    assert recording.time[-1] == pytest.approx((ROWS - 1) * 1e-3)


@pytest.mark.parametrize("has_clock", [True, False])
def test_a_gap_of_seconds_is_a_loss_where_the_robots_clock_says_so_or_there_is_none(
    tmp_path: Path, has_clock: bool
) -> None:
    states = [{**state, "robot_time_valid": has_clock} for state in _states(3200)]
    del states[1000:3000]
    recording = read_recording(_write_log(tmp_path / "run.mcap", states))
    assert [item.count for item in recording.report.of_kind("lost_samples")] == [2000]
    assert recording.time[-1] - recording.time[0] == pytest.approx(3.199)


def test_what_came_too_late_or_without_torque_is_not_called_missing(tmp_path: Path) -> None:
    """Rows 500 and 501 come behind row 503, as the session labels them; row 700 carries no torque."""
    states = _states()
    states[700]["measured_torque_valid"] = False
    late = [{**state, "out_of_order": True} for state in states[500:502]]
    states = [*states[:500], *states[502:504], *late, *states[504:]]
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    assert not recording.report.of_kind("lost_samples")
    assert recording.report.of_kind("unusable_message")[0].count == 3


def test_messages_that_came_twice_are_left_out(tmp_path: Path) -> None:
    states = _states()
    states.insert(300, {**states[299], "duplicate": True})
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    assert recording.samples == ROWS
    assert recording.report.of_kind("unusable_message")[0].first_row == 301


def test_without_a_robot_clock_time_is_the_sequence_counter(tmp_path: Path) -> None:
    states = [{**state, "robot_time_valid": False} for state in _states()]
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 1e-3)
    assert recording.report.of_kind("no_robot_clock")


def test_a_log_without_metadata_still_knows_its_periods(tmp_path: Path) -> None:
    recording = read_recording(_write_log(tmp_path / "run.mcap", _states()))
    assert recording.robot is None
    assert recording.samples_per_period == 200
    assert recording.period_s == pytest.approx(0.2)


def test_a_clock_of_the_robot_that_is_set_ahead_makes_no_gap_of_years(tmp_path: Path) -> None:
    """A cabinet that gets its time from the network. Half a billion seconds on a grid of 1 ms were 3.6 TiB."""
    states = _states()
    for state in states[600:]:
        state["robot_time_sec"] += 500_000_000
    recording = read_recording(_write_log(tmp_path / "run.mcap", states, METADATA))
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 1e-3, atol=1e-9)
    assert recording.report.of_kind("clock_set")[0].first_row == 600
    assert not recording.report.of_kind("gap")


@pytest.mark.parametrize("ahead_ns", [1_400_000, 5_000_000, 3_000_000_000])
def test_a_clock_that_is_set_ahead_by_less_than_a_loss_is_told_from_a_robot_that_was_held_up(
    tmp_path: Path, ahead_ns: int
) -> None:
    """The counter goes on by one in both; the arm has moved on where the robot was held up. A hole in the time of an
    arm that moves by 8 rad/s is an acceleration that was not there: 5 ms made six times the misfit of a fit.
    """
    states = _states()
    for state in states[600:]:
        stamp = state["robot_time_nanosec"] + ahead_ns
        state["robot_time_sec"] += stamp // 10**9
        state["robot_time_nanosec"] = stamp % 10**9
    recording = read_recording(_write_log(tmp_path / "set.mcap", states, METADATA))
    np.testing.assert_allclose(recording.time, np.arange(ROWS) * 1e-3, atol=1e-9)
    assert recording.report.of_kind("clock_set")[0].first_row == 600
    assert not recording.report.of_kind("gap")
    held_up = 2 + ahead_ns // STEP_NS
    counters = [state["sequence_counter"] for state in states]
    states = _states(ROWS + held_up)
    del states[600 : 600 + held_up]
    states = [{**state, "sequence_counter": at} for state, at in zip(states, counters, strict=True)]
    recording = read_recording(_write_log(tmp_path / "held.mcap", states, METADATA))
    assert recording.time[600] - recording.time[599] == pytest.approx((held_up + 1) * 1e-3)
    assert not recording.report.of_kind("clock_set")


def test_a_stamp_that_alone_is_late_is_no_clock_that_was_set(tmp_path: Path) -> None:
    states = _states()
    for state in states[100::100]:
        state["robot_time_nanosec"] += 600_000
    recording = read_recording(_write_log(tmp_path / "late.mcap", states, METADATA))
    assert recording.time[-1] == pytest.approx((ROWS - 1) * 1e-3)
    assert not recording.report.of_kind("clock_set")


@pytest.mark.parametrize(("earlier_ms", "noted"), [(5, "40"), (2, "100")])
@pytest.mark.parametrize("clock", [True, False])
def test_a_session_of_another_send_period_before_the_motion_changes_no_period(
    tmp_path: Path, earlier_ms: int, noted: str, clock: bool
) -> None:
    states = [{**state, "robot_time_valid": clock} for state in _states()]
    first = states[0]["robot_time_sec"] * 10**9
    for row, state in enumerate(states[:100]):
        stamp = first - (100 - row) * earlier_ms * STEP_NS
        state |= {"send_period_ms": earlier_ms, "robot_time_sec": stamp // 10**9, "robot_time_nanosec": stamp % 10**9}
    for row, state in enumerate(states[100:]):
        stamp = first + row * STEP_NS
        state |= {"robot_time_sec": stamp // 10**9, "robot_time_nanosec": stamp % 10**9}
    log = _write_log(tmp_path / "run.mcap", states, {**METADATA, "samples_per_period": noted})
    recording = read_recording(log)
    assert (recording.period_s, recording.samples_per_period, recording.complete_periods) == (0.2, 200, 4)
    np.testing.assert_allclose(np.diff(recording.time[100:]), 1e-3, rtol=1e-6)
    np.testing.assert_allclose(np.diff(recording.time[:100]), earlier_ms * 1e-3, rtol=1e-6)


@pytest.mark.parametrize("share", [0.9, 0.6])
def test_a_log_that_breaks_off_gives_its_complete_chunks(tmp_path: Path, share: float) -> None:
    whole = _write_log(tmp_path / "run.mcap", _states(), METADATA)
    data = whole.read_bytes()
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data[: int(share * len(data))])
    recording = read_recording(broken)
    reference = read_recording(whole)
    assert 0.3 * ROWS < recording.samples < ROWS
    np.testing.assert_array_equal(recording.torque, reference.torque[: recording.samples])
    assert recording.report.of_kind("truncated_file")


def test_a_log_broken_off_in_its_first_chunk_is_refused(tmp_path: Path) -> None:
    data = _write_log(tmp_path / "run.mcap", _states(), METADATA).read_bytes()
    broken = tmp_path / "broken.mcap"
    for length in (0, 5, 400):
        broken.write_bytes(data[:length])
        with pytest.raises(RecordingError) as caught:
            read_recording(broken)
        assert caught.value.exit_code == 65
        assert "()" not in str(caught.value), "the cause is said"


def test_any_cut_gives_rows_of_the_log_or_a_clear_error(tmp_path: Path) -> None:
    whole = _write_log(tmp_path / "run.mcap", _states(), METADATA)
    data, reference = whole.read_bytes(), read_recording(whole)
    broken = tmp_path / "broken.mcap"
    for length in np.random.default_rng(4).integers(0, len(data), 25):
        broken.write_bytes(data[: int(length)])
        try:
            recording = read_recording(broken)
        except RecordingError:
            continue
        np.testing.assert_array_equal(recording.position, reference.position[: recording.samples])


def test_a_damaged_byte_is_no_torque(tmp_path: Path) -> None:
    """In chunks that are not compressed any byte can be read; only their checksum tells that it is another one."""
    whole = _write_log(tmp_path / "run.mcap", _states(), METADATA, CompressionType.NONE)
    data, reference = whole.read_bytes(), read_recording(whole)
    damaged = tmp_path / "damaged.mcap"
    for place in np.random.default_rng(5).integers(6 * len(data) // 10, 8 * len(data) // 10, 25).tolist():
        damaged.write_bytes(data[:place] + bytes([data[place] ^ 0x40]) + data[place + 1 :])
        recording = read_recording(damaged)
        np.testing.assert_array_equal(recording.position, reference.position[: recording.samples])
        np.testing.assert_array_equal(recording.torque, reference.torque[: recording.samples])
        assert "a chunk is damaged" in recording.report.of_kind("truncated_file")[0].sentence


def test_a_damaged_attachment_is_said_and_costs_no_sample(tmp_path: Path) -> None:
    log = _write_log(tmp_path / "run.mcap", _states(), METADATA, attachments={"host.json": b"{1234}", "a": b"5678"})
    reference = read_recording(log)
    assert not reference.report.of_kind("damaged_attachment")
    log.write_bytes(log.read_bytes().replace(b"{1234}", b"{1235}"))
    recording = read_recording(log)
    np.testing.assert_array_equal(recording.torque, reference.torque)
    (finding,) = recording.report.of_kind("damaged_attachment")
    assert "'host.json'" in finding.sentence


def test_a_loop_report_whose_bytes_are_damaged_is_not_shown(tmp_path: Path) -> None:
    report = b'{"received": 1234}'
    log = _write_log(tmp_path / "run.mcap", _states(), METADATA, attachments={"loop_report.json": report})
    assert read_loop_report(log) == {"received": 1234}
    log.write_bytes(log.read_bytes().replace(report, b'{"received": 1235}'))
    assert read_loop_report(log) is None


def test_an_import_whose_arrays_are_damaged_is_refused(tmp_path: Path) -> None:
    """Where the bytes of the arrays still unpack, only their checksum tells."""
    file = write_recording(read_recording(_write_log(tmp_path / "run.mcap", _states(), METADATA)), tmp_path / "i.mcap")
    data = file.read_bytes()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    (place,) = [each.offset + each.length for each in summary.attachment_indexes if each.name == "recording.npz"]
    for before_end in (5, 40, 3000):
        at = place - before_end
        file.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(RecordingError, match=r"recording\.npz.*damaged"):
            read_recording(file)
