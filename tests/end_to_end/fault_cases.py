"""The table of injected faults: one row each, tried by test_faults_of_*.py and printed by benchmarks/faults.py.

What a row says of the arm is measured at the robot's side. See `fault_case` for the columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from signal import SIGCONT, SIGINT, SIGKILL, SIGSTOP, SIGTERM
from typing import Any

from tests.end_to_end.fault_case import FaultCase, Step

__all__ = ["FAULT_CASES", "HOST_CASES", "ROBOT_CASES"]

IN_MOTION = 1500
"""Messages after COMMANDING_ACTIVE: about half way through the period."""
QUICK = {"lockstep_timeout_s": 0.3}
"""Where messages or answers are lost on purpose, a lockstep robot waits for nothing: let it wait shortly."""
PROMPT = QUICK | {"lockstep_shortest_s": 0.1}
"""The client leaves some messages unanswered and then goes on: that answer must not come a cycle late."""
LONG_SILENCE = {"receive_timeout_s": 10.0}
"""A lockstep robot's wait for an answer that does not come is no silence."""
PACED: dict[str, Any] = {
    "robot": ("--send-period-ms", "5"),
    "session": {
        "lockstep_cycle_s": 0.005,
        "announces_lockstep": False,
        "lockstep_timeout_s": 0.3,
        "quality_window_s": 1.0,
        "quality_fair": 0.3,
        "quality_good": 0.4,
        "quality_excellent": 0.9,
        "missed_commands_tolerated": 100,
    },
    "clock": True,
}
"""By the clock, as the client sees it; but such a robot waits on a busy machine."""
SLOW: dict[str, Any] = {"robot": ("--send-period-ms", "5"), "session": {"lockstep_cycle_s": 0.01}}
"""In simulated time, at half the pace of a real robot: a short phase lasts until the operator has read of it."""
EXCITATION = "Motion: excitation."


def fault(name: str, at_cycle: int = IN_MOTION, cycles: int = 1, **more: Any) -> dict[str, Any]:
    """One entry of the fake robot's `faults`, counted from COMMANDING_ACTIVE."""
    return {"fault": name, "after_state": "COMMANDING_ACTIVE", "at_cycle": at_cycle, "cycles": cycles, **more}


def _what_the_robot_says() -> Iterator[FaultCase]:
    """Messages whose content is the trouble."""
    for level, name in ((1, "SAFETY_STOP_LEVEL_0"), (2, "SAFETY_STOP_LEVEL_1"), (3, "SAFETY_STOP_LEVEL_2")):
        yield FaultCase(
            f"safety-stop-{level - 1}", f"safety stop, level {level - 1}", "dropped", "dropped", 1, (name,),
            faults=(fault("safety_stop", cycles=2000, level=level),),
        )  # fmt: skip
    yield FaultCase("drives-off", "all drives off", "dropped", "dropped", 1, ("drive of joint 1 became OFF",),
                    faults=(fault("drive_off", cycles=2000),))  # fmt: skip
    yield FaultCase("quality-drop", "connection quality falls to POOR", "dropped", "dropped", 1, ("quality",),
                    faults=(fault("poor_quality"),))  # fmt: skip
    yield FaultCase("idle", "the application closes the session", "dropped", "dropped", 1, ("closed the session",),
                    faults=(fault("go_idle"),), session={"closing_idle_messages": 400})  # fmt: skip
    yield FaultCase("overlay-ends", "the application ends the overlay", "dropped", "dropped", 1,
                    ("left COMMANDING_ACTIVE",), session={"overlay_duration_s": 1.5})  # fmt: skip
    yield FaultCase(
        "overlay-again",
        "the overlay ends and starts again: nothing resumes",
        "dropped",
        "dropped",
        1,
        ("left COMMANDING_ACTIVE",),
        session={"overlay_duration_s": 1.5, "after_drop": "restart"},
    )
    yield FaultCase(
        "overlay-monitored",
        "the overlay ends, the session stays open",
        "dropped",
        "dropped",
        1,
        ("left COMMANDING_ACTIVE",),
        session={"overlay_duration_s": 1.5, "after_drop": "monitor"},
    )
    for state, name, words in (
        (1, "MONITORING_WAIT", "left COMMANDING_ACTIVE for MONITORING_WAIT"),
        (9, "a session state that there is not", "closed the session"),
    ):
        yield FaultCase(f"session-state-{state}", f"one message that claims {name}", "ramp", "dropped", 1, (words,),
                        faults=(fault("session_state", value=state),), session=PROMPT)  # fmt: skip
    yield FaultCase(
        "ipo-moves", "the robot's own set-point of joint 3 moves", "none", "not_started", 69,
        (r"set-point \(IPO\) of joint 3 moves at 0.005 rad/s",), request={"command_timeout_s": 3.0},
        faults=({"fault": "ipo_moves", "after_state": "COMMANDING_WAIT", "cycles": 10**6, "joint": 3, "value": 0.005},),
    )  # fmt: skip
    yield FaultCase("short-drive-list", "drive states of three joints only", "none", "not_started", 69,
                    ("drives of 3 joints instead of 7",), faults=(fault("short_drive_list", 0, 100_000),),
                    request={"command_timeout_s": 3.0})  # fmt: skip
    for kind, level, words in (
        ("operation_mode", 1, "operation mode changed from AUTOMATIC_MODE to TEST_MODE_2"),
        ("control_mode", 2, "control mode changed from POSITION to JOINT_IMPEDANCE"),
        ("command_mode", 3, "client command mode changed from POSITION to TORQUE"),
        ("send_period", 2, "command period changed from 1 ms to 2 ms"),
    ):
        yield FaultCase(kind.replace("_", "-"), f"the {kind.replace('_', ' ')} changes", "ramp", "dropped", 1, (words,),
                        faults=(fault(kind, cycles=3000, level=level),))  # fmt: skip
    yield FaultCase("nan-position", "measured position of joint 3 is NaN, once", "finished", "completed", 0,
                    faults=(fault("nan_position", joint=3),), session=QUICK)  # fmt: skip
    yield FaultCase(
        "nan-position-on",
        "measured position of joint 3 is NaN from now on",
        "held",
        "dropped",
        1,
        ("no usable message",),
        faults=(fault("nan_position", cycles=3000, joint=3),),
        session=QUICK,
    )
    yield FaultCase("huge-position", "measured position of joint 3 is 1e308 rad, once", "finished", "completed", 0,
                    faults=(fault("huge_position", joint=3),), session=QUICK)  # fmt: skip
    yield FaultCase("nan-torque", "measured torque of joint 2 is NaN, once", "finished", "completed", 0,
                    faults=(fault("nan_torque", joint=2),))  # fmt: skip
    yield FaultCase("nan-torque-on", "measured torque of joint 2 is NaN for 200 messages", "finished", "completed", 0,
                    faults=(fault("nan_torque", cycles=200, joint=2),))  # fmt: skip
    yield FaultCase("external-torque", "60 Nm push on joint 4, limit 30 Nm", "ramp", "stopped", 1,
                    ("external torque of joint 4 is .* beyond the limit of 30.0 Nm",),
                    faults=(fault("external_torque", cycles=500, joint=4, value=60.0),),
                    request={"external_torque_limit": (30.0,) * 7})  # fmt: skip
    yield FaultCase("external-torque-small", "20 Nm push on joint 4, limit 30 Nm", "finished", "completed", 0,
                    faults=(fault("external_torque", cycles=500, joint=4, value=20.0),),
                    request={"external_torque_limit": (30.0,) * 7})  # fmt: skip
    yield FaultCase(
        "position-jump",
        "measured position of joint 5 jumps by 0.5 rad",
        "ramp",
        "stopped",
        1,
        ("[Jj]oint 5",),
        faults=(fault("position_jump", cycles=20, joint=5, value=0.5),),
    )
    yield FaultCase("fewer-joints", "positions of three joints only, once", "finished", "completed", 0,
                    faults=(fault("fewer_joints"),), session=QUICK, gap=1)  # fmt: skip
    yield FaultCase(
        "fewer-joints-on",
        "positions of three joints only from now on",
        "held",
        "dropped",
        1,
        ("no usable message",),
        faults=(fault("fewer_joints", cycles=3000),),
        session=QUICK,
    )


def _what_the_wire_does() -> Iterator[FaultCase]:
    """Counters, order and bytes."""
    yield FaultCase("none", "nothing", "finished", "completed", 0)
    yield FaultCase(
        "lose",
        "3 messages lost, one by one",
        "finished",
        "completed",
        0,
        gap=3,
        faults=tuple(fault("lose", IN_MOTION + 5 * k) for k in range(3)),
        session=QUICK,
    )
    yield FaultCase("lose-burst", "10 messages lost in a row", "finished", "completed", 0, gap=10,
                    faults=(fault("lose", cycles=10),), session=QUICK, request=LONG_SILENCE)  # fmt: skip
    yield FaultCase("silence", "silent for 10 cycles, the counter stands", "finished", "completed", 0,
                    faults=(fault("silence", cycles=10),), session=QUICK, request=LONG_SILENCE)  # fmt: skip
    yield FaultCase("silence-on", "silent for good", "held", "dropped", 1, ("no usable message came for",),
                    faults=(fault("silence", cycles=3000),), session=QUICK)  # fmt: skip
    yield FaultCase("ignore-answers", "5 answers lost", "finished", "completed", 0,
                    faults=(fault("ignore_answers", cycles=5),), session=QUICK)  # fmt: skip
    yield FaultCase(
        "ignore-answers-on",
        "all answers lost from now on",
        "held",
        "dropped",
        1,
        (),
        faults=(fault("ignore_answers", cycles=3000),),
        session={"lockstep_timeout_s": 0.05},
    )
    yield FaultCase("duplicate", "100 messages doubled", "finished", "completed", 0,
                    faults=(fault("duplicate", cycles=100),))  # fmt: skip
    yield FaultCase(
        "reorder",
        "3 messages swapped with the next",
        "finished",
        "completed",
        0,
        faults=tuple(fault("reorder", IN_MOTION + 5 * k) for k in range(3)),
        session=QUICK,
    )
    for kind, words in (("garbage", "random bytes"), ("truncate", "half a datagram"), ("wrong_version", "FRI 2.7")):
        yield FaultCase(
            kind.replace("_", "-"),
            f"3 times {words} instead of a message",
            "finished",
            "completed",
            0,
            faults=tuple(fault(kind, IN_MOTION + 5 * k) for k in range(3)),
            session=QUICK,
            gap=3,
        )
    yield FaultCase("wrong-version-on", "FRI 2.7 from now on", "held", "dropped", 1, ("no usable message",),
                    faults=(fault("wrong_version", cycles=3000),), session=QUICK)  # fmt: skip
    yield FaultCase("foreign", "500 messages from another port as well", "finished", "completed", 0,
                    faults=(fault("foreign_sender", cycles=500),))  # fmt: skip
    yield FaultCase("counter-jump", "counter jumps by 100 ahead of time", "ramp", "dropped", 1,
                    ("sequence counter restarted at",), faults=(fault("counter_jump", value=100),),
                    session=PROMPT, request=LONG_SILENCE, gap=100)  # fmt: skip
    yield FaultCase("counter-jump-far", "counter jumps by 100 000", "ramp", "dropped", 1,
                    ("sequence counter restarted at 1",), faults=(fault("counter_jump", value=100_000),),
                    session=PROMPT, request=LONG_SILENCE, gap=100_000)  # fmt: skip
    yield FaultCase("counter-restart", "controller restarts its counter", "ramp", "dropped", 1,
                    ("sequence counter restarted at",), faults=(fault("restart_counters"),),
                    session=PROMPT, request=LONG_SILENCE)  # fmt: skip
    yield FaultCase("stale", "a message of half a second ago comes again", "finished", "completed", 0,
                    faults=(fault("stale", value=500),))  # fmt: skip
    yield FaultCase("stray", "11 bytes from another port before the robot's first message", "finished", "completed", 0,
                    faults=({"fault": "stray", "at_cycle": 0},))  # fmt: skip
    yield FaultCase("time-stamp-jump", "the robot's time stamp jumps by an hour, robot by the clock", "finished",
                    "completed", 0, faults=(fault("time_stamp_jump", 300, value=3600.0),), **PACED)  # fmt: skip


def _who_stops() -> Iterator[FaultCase]:
    """The operator, and processes that are killed or paused."""
    ramp_up = "Motion: start ramp."
    lead_in = "Motion: lead in."
    slow: dict[str, Any] = {"start_rad": 0.6}
    operator, signal_15 = ("The operator asked for a stop",), ("told to end",)
    supervisor = ("supervisor",)
    yield FaultCase(
        "int-waiting",
        "Ctrl-C while the robot is silent",
        "none",
        "stopped",
        130,
        ("Nothing had moved",),
        robot=None,
        steps=(Step("Waiting for the robot", supervisor, SIGINT),),
        file=True,
    )
    yield FaultCase("int-start-ramp", "Ctrl-C in the start ramp", "ramp", "stopped", 130, operator,
                    steps=(Step(ramp_up, supervisor, SIGINT),), **slow)  # fmt: skip
    yield FaultCase(
        "int-lead-in",
        "Ctrl-C in the lead-in",
        "ramp",
        "stopped",
        130,
        operator,
        steps=(Step(lead_in, supervisor, SIGINT),),
        request={"lead_in_s": 2.0},
    )
    yield FaultCase("int-excitation", "Ctrl-C in the excitation", "ramp", "stopped", 130, operator,
                    steps=(Step(EXCITATION, supervisor, SIGINT),))  # fmt: skip
    yield FaultCase("int-stop-ramp", "Ctrl-C in the stop ramp", "finished", "completed", 0, ("stopped by ramp",),
                    steps=(Step("Motion: stop ramp.", supervisor, SIGINT),), request={"periods": 1},
                    **SLOW)  # fmt: skip
    yield FaultCase("int-hold", "Ctrl-C while rest is being confirmed", "finished", "completed", 0,
                    ("stopped by ramp",), steps=(Step("Motion: hold.", supervisor, SIGINT),), request={"periods": 1},
                    **SLOW)  # fmt: skip
    yield FaultCase("term-start-ramp", "SIGTERM in the start ramp", "ramp", "stopped", 130, signal_15,
                    steps=(Step(ramp_up, supervisor, SIGTERM),), **slow)  # fmt: skip
    yield FaultCase("term-excitation", "SIGTERM in the excitation", "ramp", "stopped", 130, signal_15,
                    steps=(Step(EXCITATION, supervisor, SIGTERM),))  # fmt: skip
    yield FaultCase("term-loop", "SIGTERM to the loop alone", "ramp", "stopped", 1, ("SIGTERM asked for a stop",),
                    steps=(Step(EXCITATION, ("loop",), SIGTERM),))  # fmt: skip
    yield FaultCase(
        "int-impatient",
        "Ctrl-C three times",
        "ramp",
        "stopped",
        130,
        operator,
        steps=(Step(EXCITATION, supervisor, SIGINT), *(Step(r"\[", supervisor, SIGINT),) * 2),
    )
    for where, when, more in (
        ("start ramp", ramp_up, slow), ("excitation", EXCITATION, {}),
    ):  # fmt: skip
        yield FaultCase(f"kill-recorder-{where.replace(' ', '-')}", f"kill -9 of the recorder in the {where}", "ramp",
                        "stopped", 1, ("recorder was lost", "another recorder took over"),
                        steps=(Step(when, ("recorder",), SIGKILL),), **more)  # fmt: skip
    yield FaultCase("kill-recorder-hold", "kill -9 of the recorder while rest is confirmed", "finished", "completed", 1,
                    ("recorder",), steps=(Step("Motion: hold.", ("recorder",), SIGKILL),), request={"periods": 1},
                    **SLOW)  # fmt: skip
    for where, when, more in (("start ramp", ramp_up, slow), ("excitation", EXCITATION, {})):
        yield FaultCase(
            f"kill-supervisor-{where.replace(' ', '-')}",
            f"kill -9 of the supervisor in the {where}",
            "ramp",
            "stopped",
            -9,
            steps=(Step(when, supervisor, SIGKILL),),
            **more,
        )
    for where, when, more in (("start ramp", ramp_up, slow), ("excitation", EXCITATION, {})):
        yield FaultCase(f"kill-loop-{where.replace(' ', '-')}", f"kill -9 of the loop in the {where}", "held", "fault",
                        70, ("killed by signal 9", "brakes by itself"), unsaved=1, session=QUICK,
                        steps=(Step(when, ("loop",), SIGKILL),), **more)  # fmt: skip
    yield FaultCase(
        "kill-recorder-supervisor",
        "kill -9 of recorder and supervisor together",
        "ramp",
        "stopped",
        -9,
        steps=(Step(EXCITATION, ("recorder", "supervisor"), SIGKILL),),
    )
    yield FaultCase("kill-loop-recorder", "kill -9 of loop and recorder together", "held", "fault", 70,
                    ("killed by signal 9",), steps=(Step(EXCITATION, ("loop", "recorder"), SIGKILL),), unsaved=1,
                    session=QUICK)  # fmt: skip
    yield FaultCase(
        "kill-all",
        "kill -9 of all three at once",
        "held",
        None,
        -9,
        unsaved=500,
        session=QUICK,
        steps=(Step(EXCITATION, ("loop", "recorder", "supervisor"), SIGKILL),),
    )
    yield FaultCase("kill-worker", "kill -9 of the fit", "finished", "completed", 0,
                    request={"periods": 2, "fit": True},
                    steps=(Step(r"\[worker\]", ("worker",), SIGKILL),))  # fmt: skip
    yield FaultCase(
        "pause-recorder",
        "the recorder is paused for 0.5 s",
        "finished",
        "completed",
        0,
        request={"periods": 3},
        steps=(Step(EXCITATION, ("recorder",), SIGSTOP, 0.5),),
    )
    yield FaultCase("pause-recorder-long", "the recorder is paused until the ring fills", "ramp", "stopped", 1,
                    ("recorder is .* records behind",), request={"ring_slots": 8192},
                    steps=(Step(EXCITATION, ("recorder",), SIGSTOP),
                           Step("Motion: (stop ramp|hold|done)", ("recorder",), SIGCONT)))  # fmt: skip
    yield FaultCase("pause-loop", "the loop is paused for 12 ms, robot by the clock", "finished", "completed", 0,
                    request={"periods": 1}, **PACED,
                    steps=(Step(EXCITATION, ("loop",), SIGSTOP, 0.012),))  # fmt: skip
    yield FaultCase("pause-loop-long", "the loop is paused until the robot has given it up, robot by the clock", "held",
                    "dropped", 1, ("Session dropped",), **PACED,
                    steps=(Step(EXCITATION, ("loop",), SIGSTOP, resume_after_robot=True),))  # fmt: skip
    yield FaultCase("pause-supervisor", "the supervisor is paused for 3 s", "ramp", "stopped", 1,
                    ("gave no sign of life",), request={"supervisor_timeout_s": 1.0},
                    steps=(Step(EXCITATION, supervisor, SIGSTOP, 3.0),))  # fmt: skip


def _what_is_around() -> Iterator[FaultCase]:
    """Disk, port, robot."""
    yield FaultCase("disk-full", "the disk (12 MB) fills up", "ramp", "stopped", 1, ("No space left",), disk="12m")
    yield FaultCase("disk-small", "the disk (4 MB) has no room for a reserve", "none", None, 74,
                    ("No space left",), disk="4m", file=False)  # fmt: skip
    yield FaultCase("disk-none", "the disk (64 kB) is full from the start", "none", None, 74, ("No space left",),
                    disk="64k", file=False)  # fmt: skip
    yield FaultCase("read-only", "the folder is read-only", "none", None, 74, ("[Rr]ead-only",), disk="ro",
                    file=False)  # fmt: skip
    yield FaultCase("port-in-use", "the port is held by another program", "none", None, 69, ("in use",), robot=None,
                    port_held=True, file=False)  # fmt: skip
    yield FaultCase("no-robot", "no robot sends", "none", "no_robot", 69, ("No FRI message arrived within 1 s",),
                    robot=None, request={"start_timeout_s": 1.0})  # fmt: skip
    yield FaultCase("other-host", "only a host that is not the robot's sends", "none", "no_robot", 69,
                    ("No FRI message arrived", "came from elsewhere.*only 127.0.0.9 is listened to"),
                    request={"start_timeout_s": 2.0, "robot_host": "127.0.0.9"})  # fmt: skip
    for robot, told in (("2.7", "1.15"), ("1.15", "2.7"), ("2.5", "2.7")):
        yield FaultCase(
            f"version-{robot}-for-{told}",
            f"the robot speaks FRI {robot}, the run was told {told}",
            "none",
            "version_mismatch",
            76,
            (f"robot speaks FRI {robot}.*choose --fri-version {robot}",),
            robot=("--fri-version", robot),
            request={"start_timeout_s": 2.0, "fri_version": told},
        )
    yield FaultCase("never-ready", "the connection never becomes good enough", "none", "not_started", 69,
                    ("MONITORING_WAIT",), session={"quality_rise_s": 1000.0},
                    request={"command_timeout_s": 2.0})  # fmt: skip
    yield FaultCase(
        "no-overlay",
        "the application starts no overlay",
        "none",
        "not_started",
        69,
        ("MONITORING_READY",),
        session={"overlay_application": False},
        request={"command_timeout_s": 2.0},
    )
    yield FaultCase("torque-mode", "the application asks for torque commands", "none", "not_started", 69,
                    ("command mode is TORQUE, not POSITION",), session={"client_command_mode": 3},
                    request={"command_timeout_s": 2.0})  # fmt: skip
    yield FaultCase("send-period-odd", "a send period that the motion's grid does not fit", "none", "refused", 65,
                    ("7 ms",), robot=("--send-period-ms", "7"))  # fmt: skip
    yield FaultCase(
        "rejects",
        "the robot refuses commands above a tenth of its speed",
        "dropped",
        "dropped",
        1,
        ("left COMMANDING_ACTIVE",),
        session={"velocity_factor": 0.1},
        rejections=("velocity",),
    )


ROBOT_CASES: tuple[FaultCase, ...] = (*_what_the_wire_does(), *_what_the_robot_says())
HOST_CASES: tuple[FaultCase, ...] = (*_who_stops(), *_what_is_around())
FAULT_CASES: tuple[FaultCase, ...] = (*ROBOT_CASES, *HOST_CASES)
