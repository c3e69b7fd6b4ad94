"""Real-time settings of the loop process: asked for one by one, refused one by one, given back at the end.

Here: scheduling class, memory locking, CPU affinity, garbage collector, interpreter switch interval. Not here: what
the loop does with them, and the advice `doctor` gives. The loop process enters `realtime(settings)` once; nothing in it
raises for lack of a right, so the same code runs as root, as an ordinary user and in a container: the report says what
was obtained and why the rest was not.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

HIGHEST_PRIORITY = 90
"""Above it live the kernel's own interrupt and watchdog threads, without which no datagram arrives."""

_MCL_CURRENT = 1
_MCL_FUTURE = 2
_CAP_IPC_LOCK = 14

Undo = Callable[[], None]


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """What the loop wishes for; None or False leaves an item alone.

    priority: of SCHED_FIFO, 1 to 90. cpus: CPU numbers the process may run on. switch_interval_s: after how long
    another thread of this process has to hand the interpreter back.
    """

    priority: int | None = 80
    cpus: tuple[int, ...] | None = None
    lock_memory: bool = True
    stop_garbage_collector: bool = True
    switch_interval_s: float | None = 0.0005


@dataclass(frozen=True, slots=True)
class RealtimeItem:
    """One setting: its name, whether it was asked for, whether it holds, and a sentence with what holds or why not."""

    name: str
    wanted: bool
    obtained: bool
    detail: str


@dataclass(frozen=True, slots=True)
class RealtimeReport:
    """What was asked for and what came of it, in the order in which it was tried."""

    items: tuple[RealtimeItem, ...]

    def item(self, name: str) -> RealtimeItem:
        """The item of that name: scheduler, memory, affinity, garbage_collector or switch_interval."""
        return next(item for item in self.items if item.name == name)

    def to_json(self) -> dict[str, Any]:
        """Name to wanted, obtained and detail."""
        return {
            item.name: {"wanted": item.wanted, "obtained": item.obtained, "detail": item.detail} for item in self.items
        }


@contextmanager
def realtime(settings: RealtimeSettings) -> Iterator[RealtimeReport]:
    """Apply `settings` to the calling thread and process as far as allowed; give back on exit what can be given back.

    Memory is locked before the priority is raised, so that page faults of the set-up do not hold a CPU. On exit the
    steps are undone in reverse; a step that the system refuses to undo is left as it is, since the process is about to
    end anyway.
    """
    steps = (
        ("garbage_collector", settings.stop_garbage_collector, _stop_garbage_collector),
        ("switch_interval", settings.switch_interval_s is not None, lambda: _set_switch_interval(settings)),
        ("memory", settings.lock_memory, _lock_memory),
        ("affinity", settings.cpus is not None, lambda: _set_affinity(settings)),
        ("scheduler", settings.priority is not None, lambda: _set_scheduler(settings)),
    )
    items: list[RealtimeItem] = []
    undo: list[Undo] = []
    try:
        for name, wanted, apply in steps:
            if not wanted:
                items.append(RealtimeItem(name, wanted=False, obtained=False, detail="not asked for"))
                continue
            try:
                detail, give_back = apply()
            except (OSError, ValueError, AttributeError) as error:
                # AttributeError: the platform has no such call (os.sched_setscheduler exists on Linux only).
                items.append(RealtimeItem(name, wanted=True, obtained=False, detail=_reason(name, error)))
            else:
                undo.append(give_back)
                items.append(RealtimeItem(name, wanted=True, obtained=True, detail=detail))
        yield RealtimeReport(tuple(items))
    finally:
        for give_back in reversed(undo):
            try:
                give_back()
            except OSError:
                continue


def _stop_garbage_collector() -> tuple[str, Undo]:
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()

    def give_back() -> None:
        gc.unfreeze()
        if was_enabled:
            gc.enable()

    return "collected once, frozen and switched off", give_back


def _set_switch_interval(settings: RealtimeSettings) -> tuple[str, Undo]:
    assert settings.switch_interval_s is not None
    before = sys.getswitchinterval()
    sys.setswitchinterval(settings.switch_interval_s)
    return f"{settings.switch_interval_s * 1000:g} ms", lambda: sys.setswitchinterval(before)


def _lock_memory() -> tuple[str, Undo]:
    library = ctypes.CDLL(None, use_errno=True)
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        # An ordinary user may raise the soft limit up to the hard one.
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    # With MCL_FUTURE every later allocation counts against the limit and fails beyond it, which would be worse than a
    # page fault; so it is used only where there is no limit, or none that binds.
    unlimited = hard == resource.RLIM_INFINITY or _has_capability(_CAP_IPC_LOCK)
    attempts = [(_MCL_CURRENT | _MCL_FUTURE, "all memory, present and future")] if unlimited else []
    attempts.append((_MCL_CURRENT, "the memory present at set-up; later allocations may fault"))
    code = 0
    for flags, detail in attempts:
        if library.mlockall(flags) == 0:
            return detail, lambda: _unlock_memory(library)
        code = ctypes.get_errno()
    raise OSError(code, os.strerror(code))


def _has_capability(bit: int) -> bool:
    """Whether the process holds a Linux capability; root in a container often lacks it."""
    try:
        with open("/proc/self/status", "rb") as status:
            effective = next((line.split()[1] for line in status if line.startswith(b"CapEff:")), b"0")
    except OSError:
        return False
    return bool(int(effective, 16) >> bit & 1)


def _unlock_memory(library: ctypes.CDLL) -> None:
    if library.munlockall() != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def _set_affinity(settings: RealtimeSettings) -> tuple[str, Undo]:
    assert settings.cpus is not None
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, settings.cpus)
    names = ", ".join(str(cpu) for cpu in sorted(os.sched_getaffinity(0)))
    return f"CPU {names}", lambda: os.sched_setaffinity(0, before)


def _set_scheduler(settings: RealtimeSettings) -> tuple[str, Undo]:
    assert settings.priority is not None
    policy_before = os.sched_getscheduler(0)
    parameter_before = os.sched_getparam(0)
    wanted = max(1, min(settings.priority, HIGHEST_PRIORITY, os.sched_get_priority_max(os.SCHED_FIFO)))
    permitted = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    # Children (the worker, a shell) must not inherit a real-time class.
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(wanted))
        obtained = wanted
    except PermissionError:
        if not 0 < permitted < wanted:
            raise
        os.sched_setscheduler(0, policy, os.sched_param(permitted))
        obtained = permitted
    detail = f"SCHED_FIFO {obtained}"
    if obtained != settings.priority:
        detail += f" instead of {settings.priority}"
    return detail, lambda: os.sched_setscheduler(0, policy_before, parameter_before)


_ADVICE = {
    "scheduler": "allow it with 'rtprio 90' in /etc/security/limits.conf or AmbientCapabilities=CAP_SYS_NICE",
    "memory": "allow it with 'memlock unlimited' in /etc/security/limits.conf or LimitMEMLOCK=infinity",
    "affinity": "the CPUs must exist and belong to this process's cpuset",
}


def _reason(name: str, error: Exception) -> str:
    if isinstance(error, AttributeError):
        return "this platform has no such call"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    advice = _ADVICE.get(name)
    return f"{reason}; {advice}" if advice else reason
