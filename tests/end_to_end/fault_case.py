"""What one injected fault is and what is expected of everybody: value objects only. The table is in `fault_cases`."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["IN_MOTION", "PACED", "FaultCase", "Step", "fault"]

IN_MOTION = 1200
"""Messages after the first command that moves the arm: about half way through the period."""
PACED: dict[str, Any] = {
    "session": {
        "quality_window_s": 1.0,
        "quality_fair": 0.3,
        "quality_good": 0.4,
        "quality_excellent": 0.9,
        "missed_commands_tolerated": 100,
    },
    "clock": True,
}
"""By the clock: a lenient robot, for the machine that the tests share holds all processes up now and then."""


@dataclass(frozen=True, slots=True)
class Step:
    """Once the operator has read `when` (a regular expression), `number` is sent to each of `targets`, and SIGCONT
    `resume_after_s` later, or when the robot has closed its session.

    targets: supervisor, recorder, loop, worker. Instead of `when`, as the recorder tells it: at_message, once so many
    messages were received; at_travel_rad, once commands have led a joint so far from where it stood.
    """

    when: str
    targets: tuple[str, ...]
    number: signal.Signals
    resume_after_s: float | None = None
    at_message: int | None = None
    at_travel_rad: float | None = None
    resume_after_robot: bool = False


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One row of the table.

    Injected: faults and session rules of the fake robot, steps (signals), request (fields of RunRequest), robot
    (options of the fake robot; None: there is none), clock (the robot keeps real time, 5 ms a message; any other is in
    lockstep), start_rad (distance of each joint from the start of the motion, hence the length of the start ramp), disk
    (size of the file system that holds the run's folder, or "ro"), port_held (by another program), wire (a trouble of
    `wire_proxy` and its share of the datagrams).

    Expected: arm, as the robot saw it: "finished" (at rest after the whole motion), "ramp" (at rest after commands that
    stopped gently), "held" (commands ended, the robot held the last one), "dropped" (the robot ended commanding and
    braked by itself), "none" (nothing moved); outcome and exit code (None: the outcome of a run whose loop could not
    report; the exit code -9 is that of a killed supervisor); says: regular expressions that the operator reads; gap:
    monitoring messages that are missing in the file; unsaved: how many of the newest samples may be missing in it;
    rejections: reasons for which the robot refused a command; file: whether there is one.
    """

    name: str
    what: str
    arm: str
    outcome: str | None
    exit_code: int
    says: tuple[str, ...] = ()
    faults: tuple[Mapping[str, Any], ...] = ()
    session: Mapping[str, Any] = field(default_factory=dict)
    steps: tuple[Step, ...] = ()
    request: Mapping[str, Any] = field(default_factory=dict)
    robot: tuple[str, ...] | None = ()
    clock: bool = False
    start_rad: float = 0.02
    disk: str = ""
    port_held: bool = False
    wire: tuple[str, float] | None = None
    gap: int = 0
    unsaved: int = 0
    rejections: tuple[str, ...] = ()
    file: bool = True


def fault(name: str, at_cycle: int = IN_MOTION, cycles: int = 1, **more: Any) -> dict[str, Any]:
    """One entry of the fake robot's `faults`, counted from the motion's begin, however long its start was planned."""
    return {"fault": name, "in_motion": True, "at_cycle": at_cycle, "cycles": cycles, **more}
