"""The examination of host, network and link: what is there, what is missing, and what to do next.

Here: the order of the checks, and those of addresses and port. Not here: printing (the command line), the checks of
the host itself (`host_checks`), of the packet filter (`firewall`) and of what the robot sends (`link_checks`). Nothing
is sent to a robot unless answering was asked for, and then only what a client answers that wants no motion.
"""

from __future__ import annotations

import contextlib
import errno
import socket
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import psutil

from daemon.doctor import host_checks
from daemon.doctor.firewall import check_packet_filter
from daemon.doctor.host_checks import DoctorCheck
from daemon.doctor.link_checks import check_link
from daemon.doctor.link_observation import LinkObservation, Mirror, observe_link
from daemon.doctor.wake_ups import measured_wake_ups
from daemon.host import host_report
from daemon.runtime_folder import port_holders

ELSEWHERE_S = 1.0
"""How long every other address is listened to where the one asked for stayed silent."""


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
                    return f"Next ({check.name}): {check.remedy}"
        return "Next: `iiwa-ident check`, then `iiwa-ident run --periods 1 --amplitude 0.1`."

    def to_json(self) -> dict[str, Any]:
        """The report with plain values."""
        return {
            "passed": self.passed,
            "next_step": self.next_step,
            "checks": [asdict(check) for check in self.checks],
            "host": host_report(),
        }


def examine(
    *,
    bind_host: str = "127.0.0.1",
    bind_port: int = 30200,
    listen_s: float = 3.0,
    folder: Path | None = None,
    mirror: Mirror | None = None,
) -> DoctorReport:
    """Examine this host and listen on the address for listen_s. Never raises for what it finds.

    folder: where runs will be written; default the current one. mirror: answers monitoring states; None sends nothing.
    """
    checks = [check_interfaces(), check_address(bind_host)]
    observation: LinkObservation | None = None
    with measured_wake_ups(listen_s) as woken:
        try:
            observation = observe_link(bind_host, bind_port, listen_s, mirror)
            checks.append(_port_bound(bind_host, bind_port))
        except OSError as error:
            checks.append(_port_refused(bind_host, bind_port, error))
        held_up = host_checks.check_wake_ups(woken(), at_robot=not bind_host.startswith("127."))
    heard = observation is not None and bool(observation.datagrams)
    if observation is not None:
        checks += check_link(observation, bind_host, bind_port)
        if not heard and bind_port:
            checks += _elsewhere(bind_host, bind_port, min(listen_s, ELSEWHERE_S))
    checks += [
        check_packet_filter(bind_port, heard=heard),
        host_checks.check_disk(folder or Path.cwd()),
        host_checks.check_realtime_limit(),
        host_checks.check_memory_lock(),
        host_checks.check_kernel(),
        host_checks.check_governor(),
        host_checks.check_load(),
        held_up,
        host_checks.check_clock(
            None if observation is None else observation.clock_step_s,
            0.0 if observation is None else observation.duration_s,
        ),
    ]
    return DoctorReport(tuple(checks))


# ---- network


def check_interfaces() -> DoctorCheck:
    """The addresses of this machine, so that the robot's application can be told where to send."""
    found = []
    stats = psutil.net_if_stats()
    for interface, addresses in sorted(psutil.net_if_addrs().items()):
        own = [each.address for each in addresses if each.family == socket.AF_INET]
        state = stats.get(interface)
        if own:
            down = "" if state is None or state.isup else " (down)"
            found.append(f"{interface} {', '.join(own)}{down}")
    return DoctorCheck("interfaces", "ok", f"Addresses of this machine: {'; '.join(found) or 'none'}.")


def check_address(host: str) -> DoctorCheck:
    """Whether the address belongs to this machine, on which interface, and whether that suits a robot."""
    name = "address"
    if host == "0.0.0.0":
        return DoctorCheck(name, "warning", "Listening on every interface.", "bind the address of the robot's network.")
    for interface, addresses in psutil.net_if_addrs().items():
        if any(each.family == socket.AF_INET and each.address == host for each in addresses):
            return _interface_check(interface, host)
    if host.startswith("127."):
        return _interface_check("lo", host)
    remedy = f"give the interface on the robot's network the address {host}, or choose another with --bind."
    return DoctorCheck(name, "failed", f"No interface of this machine has the address {host}.", remedy)


def _interface_check(interface: str, host: str) -> DoctorCheck:
    name = "address"
    if host.startswith("127."):
        return DoctorCheck(name, "ok", f"{host} is this machine itself: only a simulated robot reaches it.")
    stats = psutil.net_if_stats().get(interface)
    if stats is not None and not stats.isup:
        return DoctorCheck(
            name, "failed", f"{host} is on {interface}, which is down.", f"plug in and start {interface}."
        )
    sentence = f"{host} is on {interface}{f', {stats.speed} Mbit/s' if stats is not None and stats.speed else ''}."
    if host.startswith("172.31."):
        sentence += " 172.31.x.x is KUKA's line interface (KLI, X66), too irregular for send periods below 5 ms."
        remedy = (
            "connect to the robot's KONI port (by default it is 192.170.10.2) and give this machine an address there."
        )
        return DoctorCheck(name, "warning", sentence, remedy)
    if "/usb" in str(Path(f"/sys/class/net/{interface}/device").resolve()):
        sentence += f" {interface} is a USB adapter, which delays messages irregularly."
        return DoctorCheck(name, "warning", sentence, "use a network card of this machine.")
    return DoctorCheck(name, "ok", sentence)


def _port_bound(host: str, port: int) -> DoctorCheck:
    if (own := port_holders().get(port)) is None:
        return DoctorCheck("port", "ok", f"UDP port {port} on {host} is free.")
    # Between two jobs a service has no socket, and its lock refuses every other run.
    sentence = f"UDP port {port} on {host} is kept by another iiwa-ident (process {own}), which does not listen now."
    remedy = "queue the run there (`iiwa-ident submit`), or end that process: no other run starts at this port."
    return DoctorCheck("port", "warning", sentence, remedy)


def _port_refused(host: str, port: int, error: OSError) -> DoctorCheck:
    if error.errno == errno.EADDRINUSE:
        if (own := port_holders().get(port)) is not None:
            # Its socket is that of the loop, whose end leaves a moving arm without answers.
            sentence = f"UDP port {port} on {host} is in use by another iiwa-ident (process {own})."
            remedy = f"wait for its end; `iiwa-ident stop --port {port}` brings its arm to rest."
            return DoctorCheck("port", "failed", sentence, remedy)
        holder = port_holder(port)
        sentence = f"UDP port {port} on {host} is in use by {holder or 'a program of another user'}."
        remedy = f"stop {holder or 'the program that holds it'} or choose another port."
        return DoctorCheck("port", "failed", sentence, remedy)
    return DoctorCheck(
        "port", "failed", f"UDP {host}:{port} cannot be bound: {error.strerror}.", "choose an address of this machine."
    )


def _elsewhere(host: str, port: int, seconds: float) -> list[DoctorCheck]:
    """A robot that sends to another address of this machine is the most common reason for silence."""
    try:
        observation = observe_link("0.0.0.0", port, seconds)
    except OSError:
        return []
    if not observation.datagrams:
        return []
    senders = ", ".join(sorted({sender[0] for _, sender, _ in observation.datagrams}))
    return [
        DoctorCheck(
            "other address",
            "failed",
            f"Messages for UDP port {port} arrive from {senders}, but not at {host}: the robot sends to another "
            "address of this machine.",
            "give that address with --bind, or let the robot's application send to the one you gave.",
        )
    ]


def port_holder(port: int) -> str | None:
    """Name and pid of the program that holds a UDP port, None where the system does not tell."""
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections(kind="udp4"):
            if connection.laddr and connection.laddr.port == port and connection.pid:
                return f"{psutil.Process(connection.pid).name()} (pid {connection.pid})"
    return None
