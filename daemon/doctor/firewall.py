"""What a packet filter does to the robot's datagrams, as far as its rules can be read.

Here: reading the rules (nft or iptables, which takes root) and a careful judgement of their text. Not here: what else
may be wrong with the network (`doctor`). The judgement is one-sided on purpose: "may drop" is said whenever something
drops and no rule was found that accepts the port.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Literal

from daemon.doctor.host_checks import DoctorCheck

Judgement = Literal["nothing dropped", "accepted", "may drop"]

_READERS = (("nft", ("nft", "list", "ruleset")), ("iptables", ("iptables-save",)))
_DROPS = re.compile(r"policy drop|\bdrop\b|\breject\b|^:INPUT DROP|-j (?:DROP|REJECT)", re.MULTILINE)
_PORTS = re.compile(r"--dports? (\S+)|dport (?:\{([^}]*)\}|(\S+))")


def check_packet_filter(port: int, *, heard: bool) -> DoctorCheck:
    """Whether a packet filter may be in the way. heard: messages arrive on this port, which answers the question."""
    name = "firewall"
    if heard:
        return DoctorCheck(name, "ok", "Messages arrive, so no packet filter is in the way.")
    for tool, command in _READERS:
        rules = _read(command)
        if rules is None:
            continue
        judgement = judge_rules(rules, port)
        if judgement == "may drop":
            return DoctorCheck(
                name,
                "warning",
                f"The packet filter ({tool}) drops datagrams, and no rule that accepts UDP port {port} was found.",
                f"let the robot in: `ufw allow proto udp from ROBOT to any port {port}`, or with nft "
                f"`nft add rule inet filter input udp dport {port} accept`.",
            )
        if judgement == "accepted":
            return DoctorCheck(name, "ok", f"The packet filter ({tool}) accepts UDP port {port}.")
        if rules.strip():
            return DoctorCheck(name, "ok", f"No rule of the packet filter ({tool}) drops datagrams.")
    if _loaded():
        return DoctorCheck(
            name,
            "warning",
            "A packet filter is loaded, whose rules only root may read.",
            f"run `sudo iiwa-ident doctor`, or look whether `sudo nft list ruleset` lets UDP port {port} in.",
        )
    return DoctorCheck(name, "ok", "No packet filter is loaded.")


def judge_rules(rules: str, port: int) -> Judgement:
    """What the text of `nft list ruleset` or `iptables-save` does to UDP datagrams for a port on this machine."""
    lines = [line.strip() for line in rules.splitlines() if not line.lstrip().startswith("#")]
    if not any(_DROPS.search(line) for line in lines if "hook forward" not in line and "hook output" not in line):
        return "nothing dropped"
    return "accepted" if any(accepts_port(line, port) for line in lines) else "may drop"


def accepts_port(rule: str, port: int) -> bool:
    """Whether one rule accepts UDP datagrams for a port: alone, in a set, or in a range."""
    if not re.search(r"\baccept\b|-j ACCEPT", rule) or "udp" not in rule:
        return False
    found = _PORTS.search(rule)
    if found is None:
        return False
    for part in re.split(r"[,\s]+", next(group for group in found.groups() if group is not None).strip()):
        first, _, last = part.replace(":", "-").partition("-")
        if first.isdigit() and (not last or last.isdigit()) and int(first) <= port <= int(last or first):
            return True
    return False


def _read(command: tuple[str, ...]) -> str | None:
    """The rules; None where the tool is missing or refuses."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def _loaded() -> bool:
    try:
        if Path("/proc/net/ip_tables_names").read_text(encoding="utf-8").strip():
            return True
    except OSError:
        pass
    return Path("/sys/module/nf_tables").exists()
