"""10 000 random stops, their distance from every limit, and what planning one costs within a tick.

Reproduce: `OPENBLAS_NUM_THREADS=1 python -m benchmarks.stops --seed 7`. Each case is a random (trajectory, tick,
reason) driven through the whole state machine; judged are finite differences of the commands
(tests/fri_client/stop_campaign.py). Printed are the kinds of stops by reason, the largest share of each limit, how long
stops take, and the time of planning a stop at random rows of the shipped excitation. Ends with 1 where a command left a
limit.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from identification.excitation import default_trajectory
from safety.limits import IIWA14_R820
from safety.path_stop import PathStops
from safety.ramps import plan_stop_ramp
from tests.fri_client.stop_campaign import REASONS, run_campaign


def main() -> int:
    """Parse, run both parts, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=10_000)
    arguments = parser.parse_args()
    begun = time.perf_counter()
    figures = run_campaign(arguments.cases, arguments.seed)
    print(f"{figures.total} stops in {time.perf_counter() - begun:.0f} s, seed {arguments.seed}")
    print(f"{'reason':22s} on the path  each joint")
    for reason in REASONS:
        print(f"{reason:22s} {figures.cases['path', reason]:11d} {figures.cases['joint_space', reason]:11d}")
    for kind, worst in figures.worst.items():
        share = ", ".join(
            f"{name} {100 * value:.2f} %"
            for name, value in zip(("velocity", "acceleration", "jerk"), worst, strict=True)
        )
        low, median, high = np.percentile(figures.durations[kind] or [0.0], [0, 50, 100])
        print(
            f"{kind}: largest share of the limits: {share}; duration {low:.2f} to {high:.2f} s, median {median:.2f} s"
        )
    print(f"outside a limit: {len(figures.violations)}", *figures.violations[:20], sep="\n")
    _planning(np.random.default_rng(arguments.seed))
    return int(bool(figures.violations))


def _planning(generator: np.random.Generator) -> None:
    table = default_trajectory("iiwa14").table(1000.0)
    stops = PathStops(table, 0.001, 1, IIWA14_R820)
    none = PathStops(table, 0.001, 1, replace(IIWA14_R820, acceleration=1e-3 * IIWA14_R820.acceleration))
    on_path, all_rungs, joints, durations = [], [], [], []
    for row in generator.integers(0, len(table), 2000).tolist():
        begun = time.perf_counter()
        stop = stops.plan(row)
        on_path.append(time.perf_counter() - begun)
        durations.append(np.nan if stop is None else stop.duration_s)
        begun = time.perf_counter()
        none.plan(row)
        all_rungs.append(time.perf_counter() - begun)
        before, here, after = table[row - 1], table[row], table[(row + 1) % len(table)]
        begun = time.perf_counter()
        plan_stop_ramp(here, (after - before) / 2e-3, (after - 2 * here + before) / 1e-6, IIWA14_R820)
        joints.append(time.perf_counter() - begun)
    print(
        f"shipped excitation: {np.mean(~np.isnan(durations)):.1%} of rows have a stop on the path, of at most ", end=""
    )
    print(f"{np.nanmax(durations):.2f} s")
    for name, times in (("on the path", on_path), ("on the path, every rung refused", all_rungs), ("joints", joints)):
        p50, p99, most = np.percentile(np.array(times) * 1e6, [50, 99, 100])
        print(f"planning, {name}: p50 {p50:.0f}, p99 {p99:.0f}, max {most:.0f} us")


if __name__ == "__main__":
    sys.exit(main())
