"""What the host is and allows: kernel, processor, real-time limits, memory; read once, attached to every log.

Only reads; judging it is the business of `doctor`.
"""

from __future__ import annotations

import contextlib
import os
import platform
import resource
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("iiwa-ident", "numpy", "scipy", "pin", "ruckig", "mcap", "msgspec", "pyzmq", "zstandard", "clarabel")


def software_versions() -> dict[str, str]:
    """Versions of the interpreter and of the packages that shape a result."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


def own_version() -> str:
    """Version of this package, or "unknown" where it is not installed."""
    return software_versions().get("iiwa-ident", "unknown")


def host_report() -> dict[str, Any]:
    """Kernel, processor, limits and load of this machine, as JSON-ready values; what cannot be read is None."""
    return {
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "usable_processors": sorted(os.sched_getaffinity(0)),
        "realtime_kernel": _read("/sys/kernel/realtime") == "1",
        "virtual_machine": "hypervisor" in (_read("/proc/cpuinfo") or "").partition("\n\n")[0].split(),
        "kernel_version": platform.version(),
        "governors": sorted({text for text in map(_read, _governor_files()) if text}),
        "clock_source": _read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "realtime_throttling_us": _read("/proc/sys/kernel/sched_rt_runtime_us"),
        "rtprio_limit": resource.getrlimit(resource.RLIMIT_RTPRIO)[0],
        "memlock_limit": resource.getrlimit(resource.RLIMIT_MEMLOCK)[0],
        "load": os.getloadavg(),
        "software": software_versions(),
        "executable": sys.executable,
    }


def _governor_files() -> list[str]:
    return [str(path) for path in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")]


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return None
