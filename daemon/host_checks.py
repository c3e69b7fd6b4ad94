"""The doctor's checks of the host: disk, limits, kernel, processor. Each reads one thing and says it in a sentence."""

from __future__ import annotations

import os
import resource
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from daemon.host import host_report

__all__ = [
    "DoctorCheck",
    "check_disk",
    "check_governor",
    "check_kernel",
    "check_load",
    "check_memory_lock",
    "check_realtime_limit",
]

Status = Literal["ok", "warning", "failed"]

BYTES_PER_SAMPLE = 500
"""Measured size of one sample in the log, compressed, rounded up."""
ROOM_FAILED = 100 * 1024 * 1024
ROOM_WARNING = 1024 * 1024 * 1024
NEEDED_MEMLOCK = 256 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class DoctorCheck:
    """One thing examined: its name, the verdict, and a sentence; `remedy` says what to do where something is amiss."""

    name: str
    status: Status
    sentence: str
    remedy: str = ""


def check_disk(folder: Path) -> DoctorCheck:
    """Room where the runs go, in minutes of recording at 1 kHz."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return DoctorCheck("disk", "failed", f"{folder}: {error.strerror}.", "choose a folder that exists.")
    minutes = free / (BYTES_PER_SAMPLE * 1000 * 60)
    sentence = f"{free / 2**30:.1f} GiB free in {folder}: {minutes:.0f} minutes of recording at 1 kHz."
    if not os.access(folder, os.W_OK):
        return DoctorCheck("disk", "failed", f"{folder} cannot be written.", "choose another folder with --out.")
    if free < ROOM_FAILED:
        return DoctorCheck("disk", "failed", sentence, "make room or choose another folder with --out.")
    return DoctorCheck("disk", "warning" if free < ROOM_WARNING else "ok", sentence, "make room on the disk.")


def check_realtime_limit() -> DoctorCheck:
    """Whether this user may ask for SCHED_FIFO."""
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if os.geteuid() == 0 or limit == resource.RLIM_INFINITY or limit >= 80:
        return DoctorCheck("rtprio limit", "ok", "Real-time priority is allowed.")
    return DoctorCheck(
        "rtprio limit",
        "warning",
        f"Real-time priority is allowed up to {limit}; the loop asks for 80 and goes on without.",
        "add '@realtime - rtprio 98' and '@realtime - memlock unlimited' to /etc/security/limits.conf, "
        "join that group and log in again.",
    )


def check_memory_lock() -> DoctorCheck:
    """Whether the loop may lock its memory."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if os.geteuid() == 0 or limit == resource.RLIM_INFINITY or limit >= NEEDED_MEMLOCK:
        return DoctorCheck("memlock limit", "ok", "Memory may be locked.")
    return DoctorCheck(
        "memlock limit",
        "warning",
        f"Only {limit // 1024} KiB of memory may be locked; page faults can delay an answer.",
        "add '@realtime - memlock unlimited' to /etc/security/limits.conf and log in again.",
    )


def check_kernel() -> DoctorCheck:
    """Whether the kernel is a real-time one."""
    report = host_report()
    if report["realtime_kernel"]:
        return DoctorCheck("kernel", "ok", f"Real-time kernel: {report['platform']}.")
    return DoctorCheck(
        "kernel",
        "warning",
        f"{report['platform']} is no real-time kernel: single answers can be late at 1 ms.",
        "install a PREEMPT_RT kernel for work on a real robot.",
    )


def check_governor() -> DoctorCheck:
    """Whether the processor's clock is held up."""
    governors = host_report()["governors"]
    if not governors:
        return DoctorCheck("processor clock", "ok", "The system controls the processor's clock itself.")
    if governors == ["performance"]:
        return DoctorCheck("processor clock", "ok", "The governor is 'performance'.")
    return DoctorCheck(
        "processor clock",
        "warning",
        f"The governor is {', '.join(governors)}; the processor may be slow when a message arrives.",
        "run `cpupower frequency-set -g performance`.",
    )


def check_load() -> DoctorCheck:
    """Whether other programs leave room."""
    load, processors = os.getloadavg()[0], len(os.sched_getaffinity(0))
    sentence = f"Load {load:.1f} on {processors} processors."
    if load > processors:
        return DoctorCheck("load", "warning", sentence, "close other programs before a run.")
    return DoctorCheck("load", "ok", sentence)
