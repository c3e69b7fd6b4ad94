"""Random (trajectory, tick, reason): no stop of either kind leaves a limit; benchmarks/stops.py runs 10 000."""

from __future__ import annotations

from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode
from fri_client.motion.program import StopReason
from fri_client.motion.stop_reason import too_much_torque
from safety.guard import GuardVerdict
from tests.fri_client.stop_campaign import REASONS, run_campaign
from tests.fri_client.test_motion import Drive, program, sine_table


def test_no_stop_of_either_kind_leaves_a_limit() -> None:
    figures = run_campaign(600, seed=20)
    assert figures.violations == []
    assert figures.total == 600
    for reason in REASONS:
        kinds = {kind for kind, name in figures.cases if name == reason}
        # A table under suspicion and an internal error never keep to the path; every other reason may, where it fits.
        assert ("path" in kinds) == (reason not in ("table refused", "FAULT")), reason
        assert "joint_space" in kinds, reason


def test_a_stop_on_the_start_ramp_is_one_of_each_joint() -> None:
    drive = Drive(program())
    drive.tick(100)
    drive.motion.stop(StopReason(EventCode.OPERATOR_STOP, ""))
    drive.finish()
    assert drive.motion.stopping.kind == "joint_space"


def test_a_stop_on_the_table_passes_the_rows_that_would_have_come() -> None:
    table = sine_table()
    drive = Drive(program(table))
    drive.until(MotionPhase.EXCITATION)
    drive.tick(499)
    drive.motion.stop(StopReason(EventCode.OPERATOR_STOP, ""))
    before = len(drive.commands)
    drive.finish()
    assert drive.motion.stopping.kind == "path"
    # Every joint has the same period here, so one joint tells the row and all others have to be at the same one.
    stop = [command for command, label in zip(drive.commands, drive.labels, strict=True) if label[0] == 4]
    assert len(stop) == round(drive.motion.stopping.duration_s * 1000)
    place = 499.0
    for command in stop:
        ahead = range(int(place), int(place) + 3)
        best = min(ahead, key=lambda row: abs(table[row] - command).max())
        assert abs(table[best] - command).max() <= abs(table[best] - table[best - 1]).max()
        place = best
    assert before < len(drive.commands)
    assert drive.motion.stopping.rows > len(stop) / 3


def test_the_planned_end_keeps_to_the_path_too() -> None:
    drive = Drive(program())
    drive.finish()
    assert drive.motion.stopping.reason is None
    assert drive.motion.stopping.kind == "path"
    drive.assert_inside_limits()


def test_a_verdict_on_the_table_leaves_the_path_and_one_on_the_arm_does_not() -> None:
    assert not StopReason.from_verdict(GuardVerdict("velocity", 3, 9.0, 1.7, "rad/s")).path_is_good
    reason = StopReason.from_verdict(GuardVerdict("distance_to_measured", 3, 0.2, 0.1, "rad"))
    assert reason.path_is_good
    assert (reason.criterion, reason.joint) == ("distance_to_measured", 3)


def test_an_error_while_a_path_stop_is_planned_costs_one_tick_and_not_the_stop() -> None:
    drive = Drive(program())
    drive.until(MotionPhase.EXCITATION)
    drive.tick(300)

    class Broken:
        def plan(self, row: int) -> None:
            raise ZeroDivisionError(row)

    drive.motion._course._stops = Broken()  # type: ignore[assignment]
    drive.motion.stop(StopReason(EventCode.OPERATOR_STOP, ""))
    try:
        drive.tick()
    except ZeroDivisionError:
        drive.finish()
    else:
        raise AssertionError("the error should have come through to the loop, which counts it")
    drive.assert_inside_limits()
    assert drive.motion.stopping.kind == "joint_space"


def test_a_torque_of_flipped_bits_is_said_in_few_digits() -> None:
    assert "is 31.4 Nm" in too_much_torque(4, 31.41, 30.0).sentence
    assert "is -6.5e+304 Nm" in too_much_torque(1, -6.5e304, 60.0).sentence
