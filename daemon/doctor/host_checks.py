"""The doctor's checks of the host: disk, limits, kernel, processor. Each reads one thing and says it in a sentence."""

from __future__ import annotations

import ctypes
import os
import resource
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from daemon.doctor.wake_ups import WakeUps
from daemon.host import host_report
from fri_client.motion.re_entry import BRIDGED_S

Status = Literal["ok", "warning", "failed"]

BYTES_PER_SAMPLE = 500
"""Measured size of one sample in the log, compressed, rounded up."""
ROOM_FAILED = 100 * 1024 * 1024
ROOM_WARNING = 1024 * 1024 * 1024
SAMPLE_BYTES_PER_S = 1000 * BYTES_PER_SAMPLE
DISK_BLOCK = 64 * 1024
DISK_BLOCKS = 64
SLOW_WRITE_S = 0.5
"""The ring between loop and recorder holds many times that, but a disk that needs it once will need more."""
CLOCK_STEP_S = 0.01
LATE_WAKE_UP_S = 0.001
"""One command period: the answer comes a cycle late."""
NEEDED_MEMLOCK = 256 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class DoctorCheck:
    """One thing examined: its name, the verdict, and a sentence; `remedy` says what to do where something is amiss."""

    name: str
    status: Status
    sentence: str
    remedy: str = ""


def check_disk(folder: Path) -> DoctorCheck:
    """Room where the runs go, in minutes of recording at 1 kHz, and how fast it takes what is written for good."""
    # The folder of a run is made when the run begins, so what counts is the place where it will be made.
    folder = next((place for place in (folder.absolute(), *folder.absolute().parents) if place.exists()), folder)
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
    try:
        speed, slowest_s = measure_disk(folder)
    except OSError as error:
        return DoctorCheck("disk", "failed", f"{folder} cannot be written: {error.strerror}.", "choose another folder.")
    sentence += (
        f" It takes {speed / 1e6:.0f} MB/s ({SAMPLE_BYTES_PER_S / 1e6:.1f} are needed), the slowest write took "
        f"{slowest_s * 1e3:.0f} ms."
    )
    if speed < 4.0 * SAMPLE_BYTES_PER_S or slowest_s > SLOW_WRITE_S:
        return DoctorCheck("disk", "warning", sentence, "record on a local disk, not a network or a busy one.")
    if free < ROOM_WARNING:
        return DoctorCheck("disk", "warning", sentence, "make room on the disk.")
    return DoctorCheck("disk", "ok", sentence)


def measure_disk(folder: Path) -> tuple[float, float]:
    """Bytes per second that reach the disk for good, and the slowest of the writes in s. Raises OSError.

    Written as the recorder writes: blocks, each followed by fsync, in a file that has no name.
    """
    block = os.urandom(DISK_BLOCK)
    slowest = 0.0
    with tempfile.TemporaryFile(dir=folder) as file:
        start = before = time.monotonic()
        for _ in range(DISK_BLOCKS):
            file.write(block)
            file.flush()
            os.fsync(file.fileno())
            now = time.monotonic()
            slowest, before = max(slowest, now - before), now
    return DISK_BLOCK * DISK_BLOCKS / max(before - start, 1e-9), slowest


def check_clock(step_s: float | None, seconds: float) -> DoctorCheck:
    """Whether the clock of the logs' times jumped while it was watched, and whether somebody keeps it right.

    step_s: CLOCK_REALTIME against CLOCK_MONOTONIC over `seconds`, None where nothing was watched.
    """
    if step_s is not None and abs(step_s) > CLOCK_STEP_S:
        jump = f"The clock jumped by {step_s * 1e3:.0f} ms within {seconds:.1f} s; times in a log count from its start."
        remedy = "let the clock settle (chrony or systemd-timesyncd), or stop the program that sets it."
        return DoctorCheck("clock", "warning", jump, remedy)
    steady = "" if step_s is None else f"The clock moved by {abs(step_s) * 1e3:.2f} ms within {seconds:.1f} s. "
    if _clock_is_kept():
        return DoctorCheck("clock", "ok", f"{steady}It is synchronised.")
    sentence = f"{steady}Nobody synchronises it: dates in logs are those of this machine alone."
    remedy = "let chrony or systemd-timesyncd keep the clock; a motion does not depend on it."
    return DoctorCheck("clock", "warning", sentence, remedy)


def _clock_is_kept() -> bool:
    """The kernel's own word (adjtimex with nothing to change): 5 stands for a clock that nobody keeps."""
    try:
        return int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512))) not in (-1, 5)
    except (OSError, AttributeError):
        return False


def check_realtime_limit() -> DoctorCheck:
    """Whether this user may ask for SCHED_FIFO."""
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if os.geteuid() == 0 or limit == resource.RLIM_INFINITY or limit >= 80:
        return DoctorCheck("rtprio limit", "ok", "Real-time priority is allowed.")
    sentence = f"Real-time priority is allowed up to {limit}; the loop asks for 80 and goes on without."
    remedy = (
        "add '@realtime - rtprio 98' and '@realtime - memlock unlimited' to /etc/security/limits.conf, "
        "join that group and log in again."
    )
    return DoctorCheck("rtprio limit", "warning", sentence, remedy)


def check_memory_lock() -> DoctorCheck:
    """Whether the loop may lock its memory."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if os.geteuid() == 0 or limit == resource.RLIM_INFINITY or limit >= NEEDED_MEMLOCK:
        return DoctorCheck("memlock limit", "ok", "Memory may be locked.")
    sentence = f"Only {limit // 1024} KiB of memory may be locked; page faults can delay an answer."
    remedy = "add '@realtime - memlock unlimited' to /etc/security/limits.conf and log in again."
    return DoctorCheck("memlock limit", "warning", sentence, remedy)


def check_kernel() -> DoctorCheck:
    """Whether the kernel is a real-time one, and whether it has the machine for itself."""
    report = host_report()
    if report["virtual_machine"]:
        sentence = f"{report['platform']} runs in a virtual machine: a real robot may never grade the connection GOOD."
        return DoctorCheck("kernel", "warning", sentence, "use a computer of its own for work on a real robot.")
    if report["realtime_kernel"]:
        return DoctorCheck("kernel", "ok", f"Real-time kernel: {report['platform']}.")
    sentence = f"{report['platform']} is no real-time kernel: single answers can be late at 1 ms."
    return DoctorCheck("kernel", "warning", sentence, "install a PREEMPT_RT kernel for work on a real robot.")


def check_wake_ups(found: WakeUps | None, *, at_robot: bool) -> DoctorCheck:
    """Whether this machine lets the loop run when a message comes.

    at_robot: a command that leaves later than the robot bridges is a step for the arm, so no arm is driven from such a
    machine; a fake robot may be.
    """
    name = "held up"
    if found is None or not found.count:
        return DoctorCheck(name, "warning", "How late this machine wakes a process could not be measured.")
    kind = "real-time process" if found.real_time else "process without real-time priority"
    sentence = (
        f"A {kind} was woken at most {found.latest_s * 1e3:.2f} ms late, in {found.count} wake-ups "
        "(a longer look finds rarer ones: --listen 60)."
    )
    remedy = (
        "close other programs, and use a computer of its own with a real-time kernel, a core that nothing else uses "
        "(loop_cpu) and real-time priority."
    )
    if found.latest_s > BRIDGED_S and at_robot:
        return DoctorCheck(name, "failed", f"{sentence} A robot bridges {BRIDGED_S * 1e3:.0f} ms.", remedy)
    return DoctorCheck(name, "warning" if found.latest_s > LATE_WAKE_UP_S else "ok", sentence, remedy)


def check_governor() -> DoctorCheck:
    """Whether the processor's clock is held up."""
    governors = host_report()["governors"]
    if not governors:
        return DoctorCheck("processor clock", "ok", "The system controls the processor's clock itself.")
    if governors == ["performance"]:
        return DoctorCheck("processor clock", "ok", "The governor is 'performance'.")
    sentence = f"The governor is {', '.join(governors)}; the processor may be slow when a message arrives."
    return DoctorCheck("processor clock", "warning", sentence, "run `cpupower frequency-set -g performance`.")


def check_load() -> DoctorCheck:
    """Whether other programs leave room."""
    load, processors = os.getloadavg()[0], len(os.sched_getaffinity(0))
    sentence = f"Load {load:.1f} on {processors} processors."
    if load > processors:
        return DoctorCheck("load", "warning", sentence, "close other programs before a run.")
    return DoctorCheck("load", "ok", sentence)
