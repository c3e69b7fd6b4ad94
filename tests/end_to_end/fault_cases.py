"""The table of injected faults: one row each, tried by test_faults_of_*.py (what a run goes on after: together in two
runs) and printed by benchmarks/faults.py.

Here: what robot and wire do; the rest is in `fault_cases_of_host`.
What a row says of the arm is measured at the robot's side. See `fault_case` for the columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from tests.end_to_end.fault_case import IN_MOTION, PACED, FaultCase, fault
from tests.end_to_end.fault_cases_of_host import HOST_CASES

__all__ = ["FAULT_CASES", "ROBOT_CASES", "SURVIVED", "TOGETHER"]

MESSAGES_A_PERIOD = 2000
PROMPT = {"lockstep_timeout_s": 0.3, "lockstep_shortest_s": 0.1}
"""The client leaves some messages unanswered, waits for fresh ones and then goes on: that answer must not come a cycle
late."""
PATIENT = {"lockstep_timeout_s": 20.0}
"""All that the robot sends is answered: a wait that ends before shifts the answer by a cycle that the arm stands."""


def _commanded(name: str, at_cycle: int, cycles: int = 1, **more: Any) -> dict[str, Any]:
    """One entry counted from COMMANDING_ACTIVE, whether or not the arm moves by then."""
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
        (r"set-point \(IPO\) of joint 3 moves at 0.005 rad/s",), request={"command_timeout_s": 8.0},
        faults=({"fault": "ipo_moves", "after_state": "COMMANDING_WAIT", "cycles": 10**6, "joint": 3, "value": 0.005},),
    )  # fmt: skip
    yield FaultCase("short-drive-list", "drive states of three joints only", "none", "not_started", 69,
                    ("drives of 3 joints instead of 7",), faults=(_commanded("short_drive_list", 0, 100_000),),
                    request={"command_timeout_s": 3.0})  # fmt: skip
    for kind, level, words in (
        ("operation_mode", 1, "operation mode changed from AUTOMATIC_MODE to TEST_MODE_2"),
        ("control_mode", 2, "control mode changed from POSITION to JOINT_IMPEDANCE"),
        ("command_mode", 3, "client command mode changed from POSITION to TORQUE"),
        ("send_period", 2, "period changed from 1 ms to 2 ms"),
    ):
        yield FaultCase(kind.replace("_", "-"), f"the {kind.replace('_', ' ')} changes", "ramp", "dropped", 1, (words,),
                        faults=(fault(kind, cycles=3000, level=level),))  # fmt: skip
    yield FaultCase("nan-position", "measured position of joint 3 is NaN, once", "finished", "completed", 0,
                    faults=(fault("nan_position", joint=3),))  # fmt: skip
    yield FaultCase(
        "nan-position-on",
        "measured position of joint 3 is NaN from now on",
        "held",
        "dropped",
        1,
        ("no usable message",),
        faults=(fault("nan_position", cycles=3000, joint=3),),
    )
    yield FaultCase("huge-position", "measured position of joint 3 is 1e308 rad, once", "finished", "completed", 0,
                    faults=(fault("huge_position", joint=3),))  # fmt: skip
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
                    faults=(fault("fewer_joints"),), gap=1)  # fmt: skip
    yield FaultCase(
        "fewer-joints-on",
        "positions of three joints only from now on",
        "held",
        "dropped",
        1,
        ("no usable message",),
        faults=(fault("fewer_joints", cycles=3000),),
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
        session=PATIENT,
    )
    yield FaultCase("lose-burst", "10 messages lost in a row", "finished", "completed", 0, gap=10,
                    faults=(fault("lose", cycles=10),), session=PATIENT)  # fmt: skip
    yield FaultCase("silence", "silent for 10 cycles, the counter stands", "finished", "completed", 0,
                    faults=(fault("silence", cycles=10),), session=PATIENT)  # fmt: skip
    yield FaultCase("silence-on", "silent for good", "held", "dropped", 1, ("no usable message came for",),
                    faults=(fault("silence", cycles=3000),))  # fmt: skip
    yield FaultCase("ignore-answers", "5 answers lost", "finished", "completed", 0,
                    faults=(fault("ignore_answers", cycles=5),), session=PATIENT)  # fmt: skip
    yield FaultCase(
        "ignore-answers-on",
        "all answers lost from now on",
        "held",
        "dropped",
        1,
        (),
        faults=(fault("ignore_answers", cycles=3000),),
        session={"lockstep_timeout_s": 2.0},
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
        session=PATIENT,
    )
    for kind, words in (("garbage", "random bytes"), ("truncate", "half a datagram"), ("wrong_version", "FRI 2.7")):
        yield FaultCase(
            kind.replace("_", "-"),
            f"3 times {words} instead of a message",
            "finished",
            "completed",
            0,
            faults=tuple(fault(kind, IN_MOTION + 5 * k) for k in range(3)),
            gap=3,
        )
    yield FaultCase("wrong-version-on", "FRI 2.7 from now on", "held", "dropped", 1, ("no usable message",),
                    faults=(fault("wrong_version", cycles=3000),))  # fmt: skip
    yield FaultCase("foreign", "500 messages from another port as well", "finished", "completed", 0,
                    faults=(fault("foreign_sender", cycles=500),))  # fmt: skip
    yield FaultCase("counter-jump", "counter jumps by 100 ahead of time", "ramp", "dropped", 1,
                    ("sequence counter restarted at",), faults=(fault("counter_jump", value=100),),
                    session=PROMPT, gap=100)  # fmt: skip
    yield FaultCase("counter-jump-far", "counter jumps by 100 000", "ramp", "dropped", 1,
                    ("sequence counter restarted at 1",), faults=(fault("counter_jump", value=100_000),),
                    session=PROMPT, gap=100_000)  # fmt: skip
    yield FaultCase("counter-restart", "controller restarts its counter", "ramp", "dropped", 1,
                    ("sequence counter restarted at",), faults=(fault("restart_counters"),),
                    session=PROMPT)  # fmt: skip
    yield FaultCase("stale", "a message of half a second ago comes again", "finished", "completed", 0,
                    faults=(fault("stale", value=500),))  # fmt: skip
    yield FaultCase("stray", "11 bytes from another port before the robot's first message", "finished", "completed", 0,
                    faults=({"fault": "stray", "at_cycle": 0},))  # fmt: skip
    yield FaultCase("time-stamp-jump", "the robot's time stamp jumps by an hour, robot by the clock", "finished",
                    "completed", 0, faults=(_commanded("time_stamp_jump", 300, value=3600.0),), **PACED)  # fmt: skip


ROBOT_CASES: tuple[FaultCase, ...] = (*_what_the_wire_does(), *_what_the_robot_says())
FAULT_CASES: tuple[FaultCase, ...] = (*ROBOT_CASES, *HOST_CASES)
SURVIVED: tuple[FaultCase, ...] = tuple(
    case for case in ROBOT_CASES if case.arm == "finished" and case.faults and not case.clock
)
"""The rows of faults that a run goes on after."""


def _in_one_run(name: str, cases: Sequence[FaultCase], session: dict[str, Any], periods: int) -> FaultCase:
    """The faults of several such rows one after the other, a tenth of a second apart: what each leaves is a sum."""
    faults: list[dict[str, Any]] = []
    begin = IN_MOTION
    for case in cases:
        shift = begin - IN_MOTION
        for each in case.faults:
            moves = "in_motion" in each
            faults.append({**each, "at_cycle": each["at_cycle"] + shift * moves})
            begin = max(begin, (faults[-1]["at_cycle"] + each.get("cycles", 1) + 100) * moves)
    assert begin < MESSAGES_A_PERIOD * periods, "a fault would come when the motion is over"
    request = {key: value for case in cases for key, value in case.request.items()}
    return FaultCase(
        name, "; ".join(case.what for case in cases), "finished", "completed", 0, faults=tuple(faults),
        session=session, request={**request, "periods": periods}, gap=sum(case.gap for case in cases),
    )  # fmt: skip


TOGETHER: tuple[FaultCase, ...] = (
    _in_one_run("survived-patient", [case for case in SURVIVED if case.session is PATIENT], PATIENT, 1),
    _in_one_run("survived", [case for case in SURVIVED if case.session is not PATIENT], {}, 2),
)
"""The same in two runs, for the tests; `benchmarks.faults` plays each row alone."""
