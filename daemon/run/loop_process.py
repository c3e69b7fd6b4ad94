"""The process around the 1 kHz loop: `python -m daemon.run.loop_process --request FILE --ring-fd N`.

Here: reading the request, binding the port, real-time settings, signals, and the report at the end. The loop itself
is `fri_client.loop.loop`. The supervisor starts this process with the ring's descriptor inherited; it needs nobody
afterwards: with the supervisor and the recorder dead it stops the arm by ramp and writes its report.

SIGTERM, SIGINT and SIGHUP (unless it was ignored before) ask for the stop ramp. Whatever happens, the ring is marked
as finished, so the recorder ends.
Exit codes (contract): 0 completed; 1 stopped or dropped, the recording is kept; 65 or 78 a request that cannot be
run; 66 its files are missing; 69 port in use, no robot or no command from it; 70 internal; 74 report not written;
76 version.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.api import (
    EXIT_CODES,
    LAST_SAMPLES_NAME,
    REPORT_NAME,
    Histogram,
    LoopOutcome,
    LoopReport,
    PhaseSpan,
    RunRequest,
)
from daemon.circles import look_for_none_at_the_end
from daemon.errors import ConfigurationError, DaemonError, LogIOError, MissingInputError, PortInUseError
from daemon.json_files import read_json
from daemon.run.spare_folder import write_run_file
from daemon.run.supervision import Supervision
from daemon.signals import handled
from fri_client.errors import FriError
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import HandoverRing
from fri_client.loop.channel import UdpChannel
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopResult, LoopSettings
from fri_client.messages import FriVersion
from fri_client.motion.program import MotionProgram
from fri_client.realtime import RealtimeReport, RealtimeSettings, realtime
from safety.errors import SafetyError
from safety.limits import JointLimits, limits_for

STANDING = np.zeros((16, 7))
"""In place of a motion where none is driven, rad: a row for each command period, whatever that is."""
_OF_THE_RESULT = tuple(each.name for each in fields(LoopResult) if each.name not in ("last_samples", "phases"))
_OF_THE_SESSION = ("received", "answered", "missing", "duplicates", "stale", "refused")
"""What a report takes as it is."""
_OF_THE_REQUEST = (
    "receive_timeout_s", "start_timeout_s", "command_timeout_s", "supervisor_timeout_s", "robot_host", "monitor_only",
    "test_mode_only", "too_fast_for_t1",
)  # fmt: skip
"""What the loop's settings take as it is."""
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the process; returns its exit code. One sentence on stderr where something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m daemon.run.loop_process", description=__doc__.split("\n\n")[0])
    parser.add_argument("--request", required=True, help="run request (JSON)")
    parser.add_argument("--ring-fd", required=True, type=int, help="inherited descriptor of the hand-over ring")
    parser.add_argument("--supervisor", type=int, default=os.getppid(), help="process number of who started this")
    options = parser.parse_args(arguments)
    try:
        ring = HandoverRing.attach(options.ring_fd)
    except FriError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    supervision = Supervision(ring, options.supervisor)
    request = report = None
    code = DaemonError.exit_code
    try:
        request = read_json(options.request, RunRequest)
        report, code = run_loop(request, ring)
        write_run_file(request, REPORT_NAME, report)
    except (DaemonError, FriError) as error:
        print(error, file=sys.stderr)
        return error.exit_code
    finally:
        ring.finish()
        if request is not None and supervision.has_ended():
            # Imported here: what it needs has no place in the process while it answers a robot.
            from daemon.run.rescue import close_books_alone

            close_books_alone(request, ring, report, code)
    if code:
        with contextlib.suppress(OSError):  # the log may lie on the disk that is full
            print(report.sentence, file=sys.stderr)
    return code


def _end(code: int) -> None:
    """Leave with this code also where the disk refuses the last words; the interpreter would make 120 of it."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        os._exit(code)
    sys.exit(code)


def run_loop(request: RunRequest, ring: HandoverRing) -> tuple[LoopReport, int]:
    """Run one acquisition's loop in this process; its report and the exit code. Never raises for a request that is
    wrong.
    """
    with UdpChannel() as channel:
        try:
            loop = _make_loop(request, channel, ring)
        except (DaemonError, FriError, SafetyError) as error:
            return _not_run("refused", error), error.exit_code
        settings = RealtimeSettings(
            priority=request.realtime_priority or None, cpus=None if request.loop_cpu is None else (request.loop_cpu,)
        )
        try:
            with handled(STOP_SIGNALS, loop.stop_from_signal), realtime(settings) as obtained:
                # Last of all: what comes before the loop listens would be answered late, and count against the link.
                bind(channel, request.bind_host, request.bind_port)
                result = loop.run()
        except PortInUseError as error:
            return _not_run("port_in_use", error), error.exit_code
        except ConfigurationError as error:
            return _not_run("refused", error), error.exit_code
    if result.last_samples:
        with contextlib.suppress(LogIOError):  # a full disk costs no more than them
            write_run_file(request, LAST_SAMPLES_NAME, result.last_samples)
    code = loop.refusal_exit_code or EXIT_CODES[result.outcome]
    return _report(loop, result, obtained, ring), code


def load_table(path: str) -> NDArray[np.float64]:
    """The table of one period, (N, 7) rad. Raises MissingInputError, ConfigurationError; its values are judged
    later.
    """
    try:
        table = np.load(path, allow_pickle=False)
    except FileNotFoundError as error:
        raise MissingInputError(path, "table of the motion") from error
    except (OSError, ValueError, EOFError) as error:
        raise ConfigurationError(f"is no table of numbers: {error}.", file=path, field="table_file") from error
    if not isinstance(table, np.ndarray) or table.dtype.kind != "f":
        raise ConfigurationError("is no array of floating-point numbers.", file=path, field="table_file")
    return table.astype(np.float64)


def bind(channel: UdpChannel, host: str, port: int) -> None:
    """Bind the loop's socket. Raises PortInUseError, ConfigurationError for an address that is not this machine's."""
    try:
        channel.bind(host, port)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PortInUseError(host, port) from error
        raise ConfigurationError(
            f"UDP {host}:{port} cannot be bound: {error.strerror}; choose an address of this machine.",
            field="bind_host",
        ) from error


def motion_of(
    request: RunRequest,
    table: NDArray[np.float64],
    limits: JointLimits,
    command_period_s: float,
    samples_per_command: int,
) -> MotionProgram:
    """The motion of a request for the robot's command period; the check of the start drives the very same one."""
    return MotionProgram(
        table,
        limits,
        command_period_s=command_period_s,
        samples_per_command=samples_per_command,
        periods=request.periods,
        lead_in_s=0.0 if request.monitor_only else request.lead_in_s,
        table_period_s=command_period_s if request.monitor_only else request.table_period_s,
        maximum_distance_to_measured=request.maximum_distance_to_measured,
        external_torque_limit=request.external_torque_limit,
    )


def _make_loop(request: RunRequest, channel: UdpChannel, ring: HandoverRing) -> FriLoop:
    version, limits = FriVersion.parse(request.fri_version), limits_for(request.robot)
    table = STANDING if request.monitor_only else load_table(request.table_file)
    settings = LoopSettings(
        **{name: getattr(request, name) for name in _OF_THE_REQUEST},
        expected_period_s=request.table_period_s,
        maximum_ipo_distance_rad=request.maximum_distance_to_measured,
        fake_robot_only=request.simulation,
    )
    return FriLoop(channel, version, partial(motion_of, request, table, limits), ring, settings)


def _not_run(outcome: LoopOutcome, error: DaemonError | FriError | SafetyError) -> LoopReport:
    return LoopReport(outcome=outcome, reason=type(error).__name__, sentence=str(error))


def _report(loop: FriLoop, result: LoopResult, obtained: RealtimeReport, ring: HandoverRing) -> LoopReport:
    counts = loop.session.counts
    link = loop.statistics.summary()
    return LoopReport(
        **{name: getattr(result, name) for name in _OF_THE_RESULT},
        **{name: getattr(counts, name) for name in _OF_THE_SESSION},
        last_samples=0 if result.last_samples is None else len(result.last_samples),
        lost_in_handover=ring.lost,
        send_period_ms=loop.session.send_period_ms,
        turn_around=_histogram(link["turn_around"]),
        jitter=_histogram(link["jitter"]),
        phases=tuple(PhaseSpan(**(asdict(span) | {"phase": MotionPhase(span.phase).name})) for span in result.phases),
        periods_completed=loop.motion.periods_completed,
        realtime=obtained.to_json(),
        link=link,
    )


def _histogram(summary: dict[str, Any]) -> Histogram:
    return Histogram(edges_us=tuple(summary["edges_us"]), counts=tuple(summary["counts"]))


if __name__ == "__main__":
    look_for_none_at_the_end()
    _end(main())
