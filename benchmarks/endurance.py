"""A long acquisition in real time: is anything lost, does anything grow, how long does the loop hold an answer back.

Reproduce: `python -m benchmarks.endurance` (30 minutes; `--minutes 3` for a short one) on a machine that does nothing
else. `iiwa-ident run` records from the fake robot at 1 kHz on loopback, by the clock. Prints a table; exit status 1
where a sample was lost between loop and file, or where loop or recorder grew by more than 5 MB after the first minute.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from tests.ports import free_udp_port

MODULES = {"loop": "daemon.run.loop_process", "recorder": "daemon.run.recorder", "supervisor": "run"}
SAMPLE_S = 5.0
ALLOWED_GROWTH_MB = 5.0
RUN = [sys.executable, "-c", "from daemon.cli import main; main()", "run"]
TIMES_US = (50, 100, 200, 500, 1000)


def main() -> int:
    """Run, watch the memory, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--out", type=Path, help="keep the run's folder here")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.out is not None and arguments.out.exists():
        parser.error(f"{arguments.out} is there already: the run would be refused, and its old figures shown.")
    with tempfile.TemporaryDirectory(prefix="iiwa-ident-endurance-", dir=os.environ.get("TMPDIR")) as scratch:
        folder = arguments.out or Path(scratch) / "run"
        figures = measure(arguments.minutes, folder, Path(scratch) / "robot.json")
    show(figures)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    grown = max(figures["growth_mb"].values())
    return int(figures["lost"] > 0 or grown > ALLOWED_GROWTH_MB or figures["outcome"] != "completed")


def measure(minutes: float, folder: Path, summary: Path) -> dict[str, Any]:
    """One run of about this length into `folder`; every figure of the table."""
    port = free_udp_port()
    period_s = 10.0
    periods = max(1, round((minutes * 60.0 - 5.0) / period_s))
    options = ["--client", f"127.0.0.1:{port}", "--json", str(summary), "--quiet"]
    robot = subprocess.Popen([sys.executable, "-m", "fixtures.fake_robot", *options])
    try:
        # Ctrl-C is the operator's: it reaches the run, which brings the arm to rest.
        run = subprocess.Popen(
            [*RUN, "--periods", str(periods), "--bind", f"127.0.0.1:{port}", "--no-fit", "--out", str(folder)],
            stdout=subprocess.DEVNULL,
        )
        memory = watch_memory(run)
        run.wait()
    finally:
        robot.terminate()
        robot.wait(30)
    outcome, cabinet = json.loads((folder / "run.json").read_text()), json.loads(summary.read_text())
    loop, file = outcome["loop"], next(each for each in outcome["files"] if each["name"] == "recording.mcap")
    growth = {role: _growth(readings, minutes) for role, readings in memory.items()}
    return {
        "outcome": outcome["outcome"], "sentence": outcome["sentences"][0], "minutes": minutes,
        "received": loop["received"], "answered": loop["answered"], "late": loop["late"], "missing": loop["missing"],
        "samples": outcome["samples"], "lost": loop["received"] - outcome["samples"] + outcome["handover_gaps"],
        "bytes_per_sample": file["bytes"] / max(1, outcome["samples"]),
        "memory_mb": memory, "growth_mb": growth, "turn_around": loop["link"]["turn_around"],
        "robot": {name: cabinet["counts"][name] for name in ("sent", "answered", "late", "missed", "own_overruns")},
        "robot_rejections": len(cabinet["rejections"]), "realtime": loop["realtime"],
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs, Linux {platform.release()}, "
                   f"Python {platform.python_version()}",
    }  # fmt: skip


def watch_memory(run: subprocess.Popen[bytes]) -> dict[str, list[tuple[float, float]]]:
    """(seconds since the start, resident MB) of each process of the run, until it ends."""
    started = time.monotonic()
    readings: dict[str, list[tuple[float, float]]] = {role: [] for role in MODULES}
    while run.poll() is None:
        with contextlib.suppress(psutil.Error):
            parent = psutil.Process(run.pid)
            for each in [parent, *parent.children()]:
                words = each.cmdline()
                for role, module in MODULES.items():
                    if module in words:
                        at = time.monotonic() - started
                        readings[role].append((at, each.memory_info().rss / 2**20))
        with contextlib.suppress(subprocess.TimeoutExpired):
            run.wait(SAMPLE_S)
    return readings


def _growth(readings: list[tuple[float, float]], minutes: float) -> float:
    """MB from the end of the first minute (of the first third, in a short run) to the last reading."""
    settled = [megabytes for at, megabytes in readings if at >= min(60.0, 20.0 * minutes)]
    return settled[-1] - settled[0] if settled else 0.0


def show(figures: dict[str, Any]) -> None:
    """The table as Markdown."""
    print(f"{figures['minutes']:g} minutes at 1 kHz on loopback ({figures['machine']}): {figures['sentence']}\n")
    print("| what | figure |\n|---|---|")
    robot, turn = figures["robot"], figures["turn_around"]
    rows = {
        "received": figures["received"], "answered": figures["answered"], "late": figures["late"],
        "missing": figures["missing"], "in the file": figures["samples"],
        "lost between loop and file": figures["lost"], "bytes per sample": f"{figures['bytes_per_sample']:.0f}",
        "robot: sent, answered in time, late, missed": " · ".join(
            str(robot[name]) for name in ("sent", "answered", "late", "missed")
        ),
        "robot: held up itself, commands refused": f"{robot['own_overruns']} · {figures['robot_rejections']}",
        "turn-around p50 · p99 · p99.9 · largest, µs": " · ".join(
            f"{turn[name]:.0f}" for name in ("p50_us", "p99_us", "p999_us", "max_us")
        ),
    }  # fmt: skip
    edges, counts = turn["edges_us"], turn["counts"]
    for below, above in zip((0, *TIMES_US), (*TIMES_US, float("inf")), strict=True):
        number = sum(count for edge, count in zip(edges, counts, strict=False) if below <= edge < above)
        rows[f"turn-around {below} to {above:g} µs"] = f"{number} ({100 * number / max(1, sum(counts)):.4f} %)"
    for role, readings in figures["memory_mb"].items():
        if readings:
            rows[f"memory of {role}: end, growth after the first minute"] = (
                f"{readings[-1][1]:.1f} MB, {figures['growth_mb'][role]:+.2f} MB"
            )
    for name, value in rows.items():
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    sys.exit(main())
