"""What a robot is told after a pause it cannot bridge, judged at its side, cycle by cycle, with its own holding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.messages import FriVersion
from fri_client.motion.program import MotionProgram, StopReason
from fri_client.motion.re_entry import re_entry_steps
from safety.limits import IIWA14_R820
from tests.fri_client.test_answer_ahead import PERIOD_NS, Bench
from tests.fri_client.test_motion import OPERATOR, Drive, program, sine_table

LIMITS = IIWA14_R820


def shares(path: np.ndarray, period_s: float = 0.001) -> np.ndarray:
    """Largest share of the limits of velocity, acceleration and jerk."""
    bounds = (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk)
    return np.array(
        [np.max(np.abs(np.diff(path, k + 1, axis=0)) / period_s ** (k + 1) / b) for k, b in enumerate(bounds)]
    )


def from_rest(drive: Drive, begins: list[int]) -> list[np.ndarray]:
    """The commands cut before each of these, every stretch with three commands at rest before its first."""
    stretches = [stretch for stretch in np.split(np.array(drive.commands), begins) if len(stretch)]
    before = [drive.ipo, *(stretch[-1] for stretch in stretches)]
    return [np.vstack([[rest] * 3, stretch]) for rest, stretch in zip(before, stretches, strict=False)]


@given(st.floats(0.0, 5000.0), st.integers(4, 500).map(lambda half: 2 * half))
def test_a_re_entry_begins_at_rest_ends_at_full_pace_on_a_whole_step_and_never_goes_faster(
    start: float, ticks: int
) -> None:
    steps = np.concatenate(([start], re_entry_steps(start, ticks)))
    pace = np.diff(steps)
    assert steps[-1] == np.ceil(start) + ticks // 2
    assert 0.0 < pace[0] < 20.0 / ticks
    assert pace.min() > 0.0
    assert pace.max() <= 1.0 + 0.1 / ticks
    assert 1.0 - pace[-1] < 12.0 / ticks**2


@given(st.integers(5, 4800), st.lists(st.integers(1, 700), max_size=3))
@example(2500, [50, 30])
@example(150, [100, 1, 149])
@example(4738, [471, 276])  # the last pause falls into the stop at the end, and ends it
@settings(max_examples=10, deadline=None)
def test_after_each_pause_the_robot_sees_a_motion_inside_every_limit_that_drives_the_rest_of_the_path(
    first: int, later: list[int]
) -> None:
    drive = Drive(program())
    drive.tick(first)
    pauses = []
    for ticks in (*later, 60_000):
        pauses.append(len(drive.commands))
        drive.motion.resume_from_rest()
        drive.tick(ticks)
    assert drive.motion.phase == MotionPhase.DONE
    assert drive.motion.stopping.reason is None
    for stretch in from_rest(drive, pauses):
        assert np.all(shares(stretch) <= (1.0001, 1.002, 1.02))
    # Every sample that has a label is the row of that label, and the ones after the last re-entry are all there.
    table = sine_table()
    for command, (phase, _, sample) in zip(drive.commands, drive.labels, strict=True):
        if sample >= 0:
            assert phase == MotionPhase.EXCITATION
            assert command == tuple(table[sample])


def test_re_entries_that_break_off_again_and_again_end_where_the_path_does() -> None:
    """None of them was ever finished, so the end of the path was never seen, and the arm was driven on and on."""
    drive = Drive(program())
    drive.tick(4700)
    for _ in range(200):
        drive.motion.resume_from_rest()
        drive.tick(60)
    drive.tick(60_000)
    assert drive.motion.phase == MotionPhase.DONE
    assert drive.motion.stopping.reason is None
    assert drive.motion.periods_completed == 2
    end = np.array(sine_table()[-1])
    assert np.abs(np.array(drive.commands[-1]) - end).max() < 0.05


@pytest.mark.parametrize("into", [0, 1, 40, 140])
def test_a_stop_or_a_drop_after_a_pause_begins_where_the_arm_stands(into: int) -> None:
    ends: tuple[Callable[[MotionProgram], None], ...] = (lambda m: m.stop(OPERATOR), lambda m: m.latch())
    for end in ends:
        drive = Drive(program())
        drive.tick(2500)
        drive.motion.resume_from_rest()
        begin = len(drive.commands)
        drive.tick(into)
        end(drive.motion)
        for _ in range(1500):
            drive.commands.append(tuple(drive.motion.tick(drive.commands[-1])))
        path = np.array([drive.commands[begin - 1]] * 3 + drive.commands[begin:])
        assert np.all(shares(path) <= (1.0001, 1.002, 1.02))
        assert drive.commands[-1] == drive.commands[-2]
        if not into:
            assert set(drive.commands[begin:]) == {drive.commands[begin - 1]}


@given(st.integers(30, 4800), st.integers(1, 156), st.booleans())
@example(150, 100, False)  # the re-entry begins on the start ramp
@example(2500, 150, False)  # the last command of the re-entry
@example(2500, 152, True)  # two rows behind it
@settings(max_examples=15, deadline=None)
def test_a_stop_in_a_re_entry_stays_on_the_path(first: int, into: int, drops: bool) -> None:
    """Each joint used to stop on its own there: such a stop leaves the path, and nobody had looked where to."""
    drive = Drive(program())
    drive.tick(first)
    drive.motion.resume_from_rest()
    resumed = len(drive.commands)
    drive.tick(into)
    begin = len(drive.commands)
    if drive.motion.phase >= MotionPhase.STOP_RAMP or drive.motion.phase == MotionPhase.START_RAMP:
        assume(drive.motion._course._re_entry is not None)
    on_path = drive.motion._course._path.positions_at
    here = drive.motion._course._on_ramp + drive.motion._course._on_table
    path = on_path(np.arange(here - 400.0, here + 700.0, 0.1).clip(0.0))
    drive.motion.latch() if drops else drive.motion.stop(OPERATOR)
    for _ in range(1500):
        drive.commands.append(tuple(drive.motion.tick(drive.commands[-1])))
    assert drive.motion.stopping.kind == "path"
    driven = np.array([drive.commands[resumed - 1]] * 3 + drive.commands[resumed:])
    assert np.all(shares(driven) <= (1.0001, 1.002, 1.02))
    assert drive.commands[-1] == drive.commands[-2]
    away = [np.abs(path - position).max(axis=1).min() for position in drive.commands[begin : begin + 1000 : 30]]
    assert max(away) < 2e-4  # the fine path has 1e-4 rad from point to point


def test_a_pause_in_a_stop_is_its_end() -> None:
    drive = Drive(program())
    drive.tick(2500)
    drive.motion.stop(OPERATOR)
    drive.tick(20)
    drive.motion.resume_from_rest()
    last = drive.commands[-1]
    drive.finish()
    assert set(drive.commands[2520:]) == {last}
    assert drive.motion.standstill.confirmed


def test_a_path_without_room_for_a_re_entry_is_given_up_where_the_arm_stands() -> None:
    table = sine_table(800, 0.1)
    drive = Drive(program(table, lead_in_s=0.1))
    drive.tick(2600)
    drive.motion._course._stops.fits = lambda _: False  # type: ignore[method-assign, assignment]
    drive.motion.resume_from_rest()
    last = drive.commands[-1]
    drive.finish()
    reason = drive.motion.stopping.reason
    assert isinstance(reason, StopReason)
    assert reason.code == EventCode.RAMP_ERROR
    assert "cycles were lost" in reason.sentence
    assert set(drive.commands[2600:]) == {last}


@pytest.mark.parametrize("missing", [3, 9, 11, 24, 60])
@pytest.mark.parametrize("how", ["gap", "stall", "stalled and stopped", "stalled and lost"])
def test_at_the_robots_side_a_long_pause_is_left_without_a_jump(missing: int, how: str) -> None:
    bench = Bench(FriVersion.V1_15)
    bench.start()
    bench.drive(700)
    # What the robot's set-point does: a command is taken at once, a cycle without one stays on the last.
    before = bench.position
    bench.clock.now += missing * PERIOD_NS
    held = [before] * missing
    if how == "gap":
        bench.counter += missing
    else:
        waiting = [bench.next_datagram() for _ in range(missing)]
        if how == "stalled and stopped":
            bench.both(lambda loop: loop._ring.request_stop())
        if how == "stalled and lost":
            bench.quality = 1
        # They come all at once, in one cycle; then one more.
        bench.deliver(*waiting, bench.next_datagram())
        held.append(bench.position)
    for _ in range(400):
        bench.deliver(bench.next_datagram())
        held.append(bench.position)
    bench.close()
    if missing > 10:
        assert np.all(shares(np.array(held)) <= (1.0001, 1.002, 1.02))
    # Never a step larger than the path's own, 0.0628 mrad, or than its stop's.
    assert np.abs(np.diff(np.array(held), axis=0)).max() <= 0.0629e-3 * 1.01


def test_commands_of_a_re_entry_carry_no_label() -> None:
    motion = program(command_period_s=0.002, samples_per_command=2)
    drive = Drive(motion)
    drive.tick(1500)
    assert motion.phase == MotionPhase.EXCITATION
    motion.resume_from_rest()
    for _ in range(70):
        drive.tick()
        assert (motion.period, motion.sample_in_period) == (-1, -1)
