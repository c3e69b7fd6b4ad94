"""The motion, driven tick by tick; velocities and accelerations are judged by differences of what came out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.motion.program import MotionError, MotionProgram, StopReason, command_stride
from fri_client.motion.standstill import STANDSTILL_SPREAD_RAD, Standstill
from safety.limits import IIWA14_R820
from safety.ramps import RampError

HOME = np.array([0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05])
OPERATOR = StopReason(EventCode.OPERATOR_STOP, "The operator asked for a stop.")


def sine_table(rows: int = 2000, amplitude: float = 0.1) -> np.ndarray:
    """One period, all joints in different phase, so that no joint passes the start at rest."""
    angle = 2 * np.pi * np.arange(rows) / rows
    return HOME + amplitude * np.sin(angle[:, None] + np.arange(7))


def program(table: np.ndarray | None = None, **changes: Any) -> MotionProgram:
    options: dict[str, Any] = {"command_period_s": 0.001, "periods": 2, "lead_in_s": 0.3, **changes}
    return MotionProgram(sine_table() if table is None else table, IIWA14_R820, **options)


class Drive:
    """An ideal robot: stands at the IPO position, follows each command at once, and keeps them all."""

    def __init__(self, motion: MotionProgram, start: np.ndarray = HOME) -> None:
        self.motion = motion
        self.ipo = tuple(start.tolist())
        self.commands: list[tuple[float, ...]] = []
        self.labels: list[tuple[int, int, int]] = []
        motion.begin(self.ipo)

    def tick(self, count: int = 1, *, measured: tuple[float, ...] | None = None, **changes: Any) -> None:
        for _ in range(count):
            if self.motion.phase == MotionPhase.DONE:
                return
            here = measured or (self.commands[-1] if self.commands else self.ipo)
            self.commands.append(tuple(self.motion.tick(here, changes.get("external"))))
            self.labels.append((self.motion.phase, self.motion.period, self.motion.sample_in_period))
            self.motion.observe(here)

    def finish(self, limit: int = 60000) -> None:
        self.tick(limit)
        assert self.motion.phase == MotionPhase.DONE

    def until(self, phase: MotionPhase) -> None:
        while self.motion.phase != phase:
            self.tick()

    def assert_inside_limits(self, period_s: float = 0.001) -> None:
        """Steps and second differences of the whole stream, the standing still before it included."""
        path = np.array([self.ipo] * 3 + self.commands)
        velocity = np.abs(np.diff(path, axis=0)).max(axis=0) / period_s
        acceleration = np.abs(np.diff(path, n=2, axis=0)).max(axis=0) / period_s**2
        assert np.all(velocity <= IIWA14_R820.velocity * 1.001), velocity
        assert np.all(acceleration <= IIWA14_R820.acceleration * 1.02), acceleration
        assert np.all(path >= IIWA14_R820.position_lower)
        assert np.all(path <= IIWA14_R820.position_upper)


def test_a_whole_motion_stays_inside_the_limits_and_labels_each_sample_once() -> None:
    drive = Drive(program())
    drive.finish()
    drive.assert_inside_limits()
    in_period = [(period, sample) for phase, period, sample in drive.labels if phase == MotionPhase.EXCITATION]
    assert in_period == [(period, sample) for period in range(2) for sample in range(2000)]
    table = sine_table()
    for command, (phase, _, sample) in zip(drive.commands, drive.labels, strict=True):
        if phase == MotionPhase.EXCITATION:
            assert command == tuple(table[sample])
    phases = [phase for phase, _, _ in drive.labels]
    assert phases == sorted(phases)
    assert phases.count(MotionPhase.LEAD_IN) == 300
    assert drive.motion.stopping.reason is None
    assert drive.motion.standstill.confirmed
    assert drive.motion.periods_completed == 2


def test_the_lead_in_is_the_end_of_the_period() -> None:
    drive = Drive(program())
    drive.until(MotionPhase.EXCITATION)
    lead_in = [c for c, label in zip(drive.commands, drive.labels, strict=True) if label[0] == MotionPhase.LEAD_IN]
    assert lead_in == [tuple(row) for row in sine_table()[-300:]]


def test_the_first_command_is_where_the_arm_is() -> None:
    drive = Drive(program(), HOME + 0.2)
    drive.tick()
    assert drive.commands[0] == pytest.approx(HOME + 0.2, abs=1e-12)


@pytest.mark.parametrize("stride", [1, 2, 4, 5])
def test_slower_commands_take_every_nth_row_and_keep_the_limits(stride: int) -> None:
    drive = Drive(program(command_period_s=0.001 * stride))
    drive.finish()
    drive.assert_inside_limits(0.001 * stride)
    table = sine_table()
    driven = [c for c, label in zip(drive.commands, drive.labels, strict=True) if label[0] == MotionPhase.EXCITATION]
    assert driven == [tuple(row) for row in np.vstack([table[::stride]] * 2)]


def test_with_a_receive_multiplier_the_labels_of_commands_leave_room_for_the_samples_between() -> None:
    motion = program(command_period_s=0.002, samples_per_command=2)
    drive = Drive(motion)
    drive.until(MotionPhase.EXCITATION)
    seen = []
    for _ in range(4):
        seen.append(motion.sample_in_period)
        drive.tick()
    assert seen == [0, 2, 4, 6]


@pytest.mark.parametrize(
    ("rows", "command_period_s", "words"),
    [
        (1999, 0.002, "no whole number of command periods of 2 ms"),
        (2000, 0.0015, "no whole multiple of the table's 1 ms grid"),
        (2000, 0.0005, "no whole multiple"),
    ],
)
def test_a_period_off_the_command_grid_is_refused_with_the_numbers(
    rows: int, command_period_s: float, words: str
) -> None:
    with pytest.raises(MotionError, match=words):
        command_stride(rows, 0.001, command_period_s)


def test_a_table_with_a_hole_is_refused_with_its_place() -> None:
    table = sine_table()
    table[1234, 4] = math.nan
    with pytest.raises(MotionError, match="nan at row 1234, joint 5"):
        program(table)
    with pytest.raises(MotionError, match="shape"):
        program(sine_table()[:, :6])


def test_a_start_that_no_ramp_reaches_raises_and_moves_nothing() -> None:
    motion = program()
    far = HOME.copy()
    far[3] = -2.2  # beyond joint 4's -2.0944 rad
    with pytest.raises(RampError, match="joint 4"):
        motion.begin(tuple(far))
    assert not motion.commanded


@settings(max_examples=60, deadline=None)
@given(
    tick=st.integers(1, 6000),
    amplitude=st.floats(0.01, 0.3),
    reason=st.sampled_from(["operator", "torque", "blocked"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_stop_at_any_tick_ends_at_rest_inside_every_limit(
    tick: int, amplitude: float, reason: str, seed: int
) -> None:
    start = HOME + np.random.default_rng(seed).uniform(-0.3, 0.3, 7)
    motion = program(sine_table(amplitude=amplitude), external_torque_limit=(20.0,) * 7)
    drive = Drive(motion, start)
    drive.tick(tick)
    stopping = motion.phase < MotionPhase.STOP_RAMP
    before = drive.commands[-1]
    if reason == "operator":
        motion.stop(OPERATOR)
        drive.tick()
    elif reason == "torque":
        drive.tick(external=(0.0,) * 6 + (-20.5,))
    else:
        drive.tick(measured=tuple(value + 0.11 for value in before))  # the arm does not follow
    drive.finish()
    drive.assert_inside_limits()
    assert drive.commands[-1] == drive.commands[-2]
    if stopping:
        expected = {
            "operator": (EventCode.OPERATOR_STOP, 0),
            "torque": (EventCode.EXTERNAL_TORQUE, 7),
            "blocked": (EventCode.GUARD, 1),
        }[reason]
        assert motion.stopping.reason is not None
        assert (motion.stopping.reason.code, motion.stopping.reason.joint) == expected
        assert motion.phase == MotionPhase.DONE
        # Not one sample after the stop carries a place in a period.
        assert all(label[1:] == (-1, -1) for label in drive.labels[tick:])


def test_a_command_that_the_guard_refuses_is_never_sent() -> None:
    table = sine_table()
    table[700, 2] += 0.05  # a jump of 50 rad/s
    drive = Drive(program(table))
    drive.finish()
    reason = drive.motion.stopping.reason
    assert reason is not None
    assert (reason.code, reason.joint) == (EventCode.GUARD, 3)
    assert "velocity" in reason.sentence
    assert tuple(table[700]) not in drive.commands
    drive.assert_inside_limits()
    assert drive.motion.periods_completed == 0


def test_the_first_reason_to_stop_is_the_one_that_is_told() -> None:
    drive = Drive(program())
    drive.tick(500)
    drive.motion.stop(OPERATOR)
    drive.motion.stop(StopReason(EventCode.DISK_FULL, "The disk is full."))
    drive.finish()
    assert drive.motion.stopping.reason == OPERATOR


def test_a_stop_before_the_motion_moves_nothing() -> None:
    motion = program()
    motion.prepare(tuple(HOME))
    motion.stop(OPERATOR)
    assert motion.phase == MotionPhase.DONE
    assert not motion.commanded
    with pytest.raises(ValueError, match="once"):
        motion.begin(tuple(HOME))


@pytest.mark.parametrize("at", [1, 900, 2500, 3700])
def test_after_a_drop_the_arm_is_brought_to_rest_and_no_phase_of_motion_returns(at: int) -> None:
    drive = Drive(program())
    drive.tick(at)
    motion = drive.motion
    motion.latch()
    for _ in range(1500):
        drive.commands.append(tuple(motion.tick(drive.commands[-1])))
        motion.observe(drive.commands[-1])
        assert motion.phase == MotionPhase.LATCHED
    drive.assert_inside_limits()
    assert drive.commands[-1] == drive.commands[-2]
    assert motion.standstill.confirmed
    motion.stop(OPERATOR)
    assert motion.phase == MotionPhase.LATCHED


def test_after_silence_the_last_command_is_held_because_the_arm_has_come_to_rest_there() -> None:
    drive = Drive(program())
    drive.tick(2500)
    drive.motion.latch(at_rest=True)
    assert tuple(drive.motion.tick(drive.commands[-1])) == drive.commands[-1]


def test_standstill_needs_a_whole_quiet_window_and_says_when_there_is_none() -> None:
    quiet, moving = Standstill(0.001), Standstill(0.001)
    for _ in range(199):
        quiet.observe((1.0,) * 7)
    assert not quiet.confirmed
    quiet.observe((1.0 + STANDSTILL_SPREAD_RAD / 2,) * 7)
    assert quiet.confirmed
    for k in range(5000):
        moving.observe((0.0,) * 6 + (1e-5 * k,))
    assert moving.gave_up
    assert not moving.confirmed
