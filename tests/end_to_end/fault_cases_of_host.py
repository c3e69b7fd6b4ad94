"""Faults of operator, processes, disk and port: rows of the table in `fault_cases`."""

from __future__ import annotations

from collections.abc import Iterator
from signal import SIGCONT, SIGINT, SIGKILL, SIGSTOP, SIGTERM, Signals
from typing import Any

from tests.end_to_end.fault_case import PACED, FaultCase, Step

__all__ = ["HOST_CASES"]

SLOW: dict[str, Any] = {"robot": ("--send-period-ms", "5"), "session": {"lockstep_cycle_s": 0.01}}
"""In simulated time, at half the pace of a real robot: a short phase lasts until the operator has read of it."""
EXCITATION = "Motion: excitation."


def _on_the_ramp(targets: tuple[str, ...], number: Signals) -> Step:
    """The ramp is announced before its first command: on a busy machine a signal on that word came before it moved."""
    return Step("", targets, number, at_travel_rad=1e-3)


def _excited(targets: tuple[str, ...], number: Signals) -> Step:
    return Step(EXCITATION, targets, number)


def _who_stops() -> Iterator[FaultCase]:
    """The operator, and processes that are killed or paused."""
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
                    steps=(_on_the_ramp(supervisor, SIGINT),), **slow)  # fmt: skip
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
                    steps=(_on_the_ramp(supervisor, SIGTERM),), **slow)  # fmt: skip
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
    for where, step, more in (
        ("start ramp", _on_the_ramp, slow), ("excitation", _excited, {}),
    ):  # fmt: skip
        yield FaultCase(f"kill-recorder-{where.replace(' ', '-')}", f"kill -9 of the recorder in the {where}", "ramp",
                        "stopped", 1, ("recorder was lost", "another recorder took over"),
                        steps=(step(("recorder",), SIGKILL),), **more)  # fmt: skip
    yield FaultCase("kill-recorder-hold", "kill -9 of the recorder while rest is confirmed", "finished", "completed", 1,
                    ("recorder",), steps=(Step("Motion: hold.", ("recorder",), SIGKILL),), request={"periods": 1},
                    **SLOW)  # fmt: skip
    for where, step, more in (("start ramp", _on_the_ramp, slow), ("excitation", _excited, {})):
        yield FaultCase(
            f"kill-supervisor-{where.replace(' ', '-')}",
            f"kill -9 of the supervisor in the {where}",
            "ramp",
            "stopped",
            -9,
            steps=(step(supervisor, SIGKILL),),
            **more,
        )
    for where, step, more in (("start ramp", _on_the_ramp, slow), ("excitation", _excited, {})):
        yield FaultCase(f"kill-loop-{where.replace(' ', '-')}", f"kill -9 of the loop in the {where}", "held", "fault",
                        70, ("killed by signal 9", "brakes by itself"), unsaved=1,
                        steps=(step(("loop",), SIGKILL),), **more)  # fmt: skip
    yield FaultCase(
        "kill-recorder-supervisor",
        "kill -9 of recorder and supervisor together",
        "ramp",
        "stopped",
        -9,
        steps=(Step(EXCITATION, ("recorder", "supervisor"), SIGKILL),),
    )
    yield FaultCase("kill-loop-recorder", "kill -9 of loop and recorder together", "held", "fault", 70,
                    ("killed by signal 9",), unsaved=1,
                    steps=(Step(EXCITATION, ("loop", "recorder"), SIGKILL),))  # fmt: skip
    yield FaultCase(
        "kill-all",
        "kill -9 of all three at once",
        "held",
        None,
        -9,
        unsaved=500,
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
    yield FaultCase("pause-loop-long", "the loop is paused until the robot has given it up", "held",
                    "dropped", 1, ("Session dropped",),
                    steps=(Step(EXCITATION, ("loop",), SIGSTOP, resume_after_robot=True),))  # fmt: skip
    yield FaultCase("pause-supervisor", "the supervisor is paused for 3 s", "ramp", "stopped", 1,
                    ("gave no sign of life",), request={"supervisor_timeout_s": 1.0},
                    steps=(Step(EXCITATION, supervisor, SIGSTOP, 3.0),))  # fmt: skip


def _what_is_around() -> Iterator[FaultCase]:
    """Disk, port, robot."""
    yield FaultCase("disk-full", "the disk (12 MB) fills up", "ramp", "stopped", 1, ("No space left",), disk="12m")
    yield FaultCase("disk-small", "the disk (4 MB) has no room for a reserve", "none", "refused", 74,
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


HOST_CASES: tuple[FaultCase, ...] = (*_who_stops(), *_what_is_around())
