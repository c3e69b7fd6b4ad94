"""The examination of host, network and link: what is there, what is missing, and what to do next.

Here: checks with a verdict and a sentence each; they only read and listen, nothing is ever sent to a robot. Not here:
printing (the command line), the checks of the host itself (`host_checks`), its bare facts (`host`).
"""

from __future__ import annotations

import contextlib
import errno
import socket
import statistics
import time
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil

from daemon.fri_guess import VersionGuess, guess_version
from daemon.host import host_report
from daemon.host_checks import (
    DoctorCheck,
    check_disk,
    check_governor,
    check_kernel,
    check_load,
    check_memory_lock,
    check_realtime_limit,
)
from fri_client.messages import ConnectionQuality, SessionState

__all__ = ["DoctorCheck", "DoctorReport", "LinkObservation", "examine", "grade_link"]

MAXIMUM_DATAGRAMS = 200_000
STALE_S = 0.5
"""No send period is longer than 0.1 s; a last message older than this means that the sender stopped."""


@dataclass(frozen=True, slots=True)
class DoctorReport:
    """All checks in the order in which to mend them. passed: none failed."""

    checks: tuple[DoctorCheck, ...]

    @property
    def passed(self) -> bool:
        """True when nothing failed; warnings are allowed."""
        return all(check.status != "failed" for check in self.checks)

    @property
    def next_step(self) -> str:
        """The one thing to do next."""
        for status in ("failed", "warning"):
            for check in self.checks:
                if check.status == status and check.remedy:
                    return f"Next: {check.remedy}"
        return "Next: `iiwa-ident check`, then `iiwa-ident run --periods 1 --amplitude 0.1`."

    def to_json(self) -> dict[str, Any]:
        """The report with plain values."""
        return {
            "passed": self.passed,
            "next_step": self.next_step,
            "checks": [asdict(check) for check in self.checks],
            "host": host_report(),
        }


@dataclass(frozen=True, slots=True)
class LinkObservation:
    """What was heard during duration_s: (arrival in s since the start, sender, datagram) in order."""

    datagrams: tuple[tuple[float, tuple[str, int], bytes], ...]
    duration_s: float


def examine(
    *, bind_host: str = "127.0.0.1", bind_port: int = 30200, listen_s: float = 3.0, folder: Path | None = None
) -> DoctorReport:
    """Examine this host and listen on the address for listen_s. Never raises for what it finds; sends nothing.

    folder: where runs will be written; default the current one.
    """
    checks = [check_address(bind_host)]
    observation, port_check = _listen(bind_host, bind_port, listen_s)
    checks.append(port_check)
    if observation is not None:
        checks += check_link(observation, bind_host, bind_port)
    checks += [
        check_packet_filter(bind_port),
        check_disk(folder or Path.cwd()),
        check_realtime_limit(),
        check_memory_lock(),
        check_kernel(),
        check_governor(),
        check_load(),
    ]
    return DoctorReport(tuple(checks))


# ---- network


def check_address(host: str) -> DoctorCheck:
    """Whether the address belongs to this machine, on which interface, and whether that is up."""
    name = "address"
    if host == "0.0.0.0":
        return DoctorCheck(name, "warning", "Listening on every interface.", "bind the address of the robot's network.")
    for interface, addresses in psutil.net_if_addrs().items():
        if any(each.family == socket.AF_INET and each.address == host for each in addresses):
            stats = psutil.net_if_stats().get(interface)
            if stats is not None and not stats.isup:
                return DoctorCheck(
                    name, "failed", f"{host} is on {interface}, which is down.", f"plug in and start {interface}."
                )
            if host.startswith("127."):
                return DoctorCheck(name, "ok", f"{host} is this machine itself: only a simulated robot reaches it.")
            speed = f", {stats.speed} Mbit/s" if stats is not None and stats.speed else ""
            return DoctorCheck(name, "ok", f"{host} is on {interface}{speed}.")
    if host.startswith("127."):
        return DoctorCheck(name, "ok", f"{host} is this machine itself: only a simulated robot reaches it.")
    return DoctorCheck(
        name,
        "failed",
        f"No interface of this machine has the address {host}.",
        f"give the interface on the robot's network the address {host}, or choose another with --bind.",
    )


def _listen(host: str, port: int, seconds: float) -> tuple[LinkObservation | None, DoctorCheck]:
    """Bind and listen without answering; a port in use is told with its holder where the system tells."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        try:
            channel.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                holder = port_holder(port)
                return None, DoctorCheck(
                    "port",
                    "failed",
                    f"UDP port {port} on {host} is in use{f' by {holder}' if holder else ''}.",
                    f"stop {holder or 'the program that holds it'} or choose another port.",
                )
            return None, DoctorCheck(
                "port",
                "failed",
                f"UDP {host}:{port} cannot be bound: {error.strerror}.",
                "choose an address of this machine.",
            )
        free = DoctorCheck("port", "ok", f"UDP port {port} on {host} is free.")
        heard: list[tuple[float, tuple[str, int], bytes]] = []
        start = time.monotonic()
        end = start + seconds
        while (left := end - time.monotonic()) > 0 and len(heard) < MAXIMUM_DATAGRAMS:
            channel.settimeout(left)
            try:
                data, sender = channel.recvfrom(2048)
            except TimeoutError:
                break
            heard.append((time.monotonic() - start, (str(sender[0]), int(sender[1])), data))
        return LinkObservation(tuple(heard), time.monotonic() - start), free


def port_holder(port: int) -> str | None:
    """Name and pid of the program that holds a UDP port, None where the system does not tell."""
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections(kind="udp4"):
            if connection.laddr and connection.laddr.port == port and connection.pid:
                return f"{psutil.Process(connection.pid).name()} (pid {connection.pid})"
    return None


def check_packet_filter(port: int) -> DoctorCheck:
    """Whether a packet filter is loaded; its rules can only be read by root, so it is only named."""
    tables = Path("/proc/net/ip_tables_names")
    active = ""
    with contextlib.suppress(OSError):
        active = tables.read_text(encoding="utf-8").strip()
    if active or Path("/sys/module/nf_tables").exists():
        return DoctorCheck(
            "firewall",
            "ok",
            f"A packet filter is loaded; if no message arrives, allow UDP port {port} from the robot in it.",
        )
    return DoctorCheck("firewall", "ok", "No packet filter is loaded.")


# ---- link


def check_link(observation: LinkObservation, host: str, port: int) -> list[DoctorCheck]:
    """Who sends what: source, FRI version, state, age of the last message, regularity and loss, with a grade."""
    if not observation.datagrams:
        return [
            DoctorCheck(
                "robot",
                "failed",
                f"No message arrived on {host}:{port} within {observation.duration_s:.1f} s.",
                f"start the FRI application on the robot and let it send to {host}:{port} "
                "(without a robot: `iiwa-ident fake-robot`).",
            )
        ]
    senders = sorted({sender[0] for _, sender, _ in observation.datagrams})
    count = len(observation.datagrams)
    last, _, datagram = observation.datagrams[-1]
    guess = guess_version(datagram)
    if not guess.candidates:
        return [
            DoctorCheck(
                "robot",
                "failed",
                f"{count} datagrams arrived from {', '.join(senders)}, but they are no FRI monitoring messages.",
                "find out which program sends to this port.",
            )
        ]
    age = observation.duration_s - last
    remedy = "let only one robot send to this port." if len(senders) > 1 else ""
    if age > STALE_S:
        remedy = "find out why the robot stopped sending: its application may have ended."
    checks = [
        DoctorCheck(
            "robot",
            "warning" if remedy else "ok",
            f"{count} messages in {observation.duration_s:.1f} s from {', '.join(senders)}, the last {age:.2f} s ago.",
            remedy,
        ),
        DoctorCheck(
            "FRI version",
            "ok" if len(guess.candidates) == 1 else "warning",
            guess.sentence(),
            "" if len(guess.candidates) == 1 else "look the version up in the robot's Sunrise project.",
        ),
        _state_check(guess),
    ]
    return [*checks, grade_link(observation, guess)]


def _state_check(guess: VersionGuess) -> DoctorCheck:
    connection = None if guess.message is None else guess.message.connection_info
    if connection is None:
        return DoctorCheck("session", "warning", "The messages carry no session state.", "open the session again.")
    state = _name(SessionState, connection.session_state)
    quality = _name(ConnectionQuality, connection.quality)
    period = f"{connection.send_period} ms" if connection.send_period else "unknown"
    sentence = f"Session state {state}, quality {quality}, send period {period} (nobody answers while we listen)."
    if connection.send_period and connection.send_period > 5:
        return DoctorCheck("session", "warning", sentence, "set the send period to 1 ms on the robot.")
    return DoctorCheck("session", "ok", sentence)


def grade_link(observation: LinkObservation, guess: VersionGuess) -> DoctorCheck:
    """Grade of the link from loss and regularity of arrival; both against the send period the robot states.

    excellent: nothing lost, 99 % of the arrivals within a quarter period of their time; good: half a period and at most
    0.1 % lost; fair: one period and 1 %; poor: else.
    """
    assert guess.candidates
    arrivals, counters, periods = [], [], []
    for arrival, _, datagram in observation.datagrams:
        message = guess_version(datagram).message
        if message is None:
            continue
        arrivals.append(arrival)
        counters.append(message.header.sequence_counter)
        if message.connection_info is not None and message.connection_info.send_period:
            periods.append(message.connection_info.send_period * 1e-3)
    if len(arrivals) < 10:
        return DoctorCheck(
            "link", "warning", f"Only {len(arrivals)} messages: too few to grade the link.", "listen for longer."
        )
    intervals = [after - before for before, after in pairwise(arrivals)]
    steps = [(after - before) % 2**32 for before, after in pairwise(counters)]
    period = statistics.median(periods) if periods else statistics.median(intervals)
    lost = sum(step - 1 for step in steps if 1 < step < 2**31)
    share = lost / (len(arrivals) + lost)
    deviations = sorted(
        abs(interval - period * max(step, 1)) for interval, step in zip(intervals, steps, strict=True) if step < 2**31
    )
    p99 = deviations[min(len(deviations) - 1, int(0.99 * len(deviations)))]
    if not lost and p99 <= 0.25 * period:
        grade: str = "excellent"
    elif share <= 0.001 and p99 <= 0.5 * period:
        grade = "good"
    elif share <= 0.01 and p99 <= period:
        grade = "fair"
    else:
        grade = "poor"
    sentence = (
        f"Link {grade}: {len(arrivals)} messages, {lost} lost, 99 % within {p99 * 1e3:.2f} ms of their time, "
        f"longest pause {max(intervals) * 1e3:.1f} ms."
    )
    if grade in ("excellent", "good"):
        return DoctorCheck("link", "ok", sentence)
    remedy = (
        "use a direct cable, a network card of this machine and a real-time kernel; close other programs."
        if grade == "poor"
        else "close other programs and set real-time limits, then look again."
    )
    return DoctorCheck("link", "failed" if grade == "poor" else "warning", sentence, remedy)


def _name(kind: type[SessionState] | type[ConnectionQuality], value: int) -> str:
    try:
        return kind(value).name
    except ValueError:
        return str(value)
