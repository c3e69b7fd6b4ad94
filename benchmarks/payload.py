"""How well `payload` weighs what the fake robot carries: drawn loads of 0.2 to 10 kg, each against what was put on.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.payload --seed S [--loads 20] [--motion shipped|FILE.json]
     [--seconds 20] [--json FILE]
Truth: the load that the fake robot's plant is told of, a point on its flange; friction, noise, resolution and motor are
the plant's own. Each load has a recording without it of its own, so that errors are drawn anew. Bounds of the issue:
mass within 1 %, each coordinate of the centre within 2 mm, and 95 % of the intervals hold (of 80: 70 to 80 with odds of
99 : 1).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fixtures.fake_robot.plant import Plant
from fixtures.physics.settings import PhysicsSettings
from identification.audit.payload import Body, weigh
from identification.excitation import Trajectory, default_trajectory, load_trajectory
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot

FloatArray = npt.NDArray[np.float64]

ROBOT = "iiwa14"
MASS_KG = (0.2, 10.0)
ASIDE_M, OUT_M = 0.08, (0.0, 0.2)
"""Where the centre of a tool is: aside of the flange's axis, and along it."""
LEAD_IN = 1000
MASS_SHARE, CENTER_M = 0.01, 0.002


def record(file: Path, trajectory: Trajectory, seconds: float, load_kg_m: tuple[float, ...], seed: int) -> Recording:
    """A run of the fake robot's plant with a load on its flange, at its 1 kHz; written to `file` as .npz."""
    samples = round(1e3 * seconds)
    time_s = 1e-3 * np.arange(-LEAD_IN, samples)
    path = trajectory.evaluate(time_s)[0]
    settings = replace(PhysicsSettings(), initial_position_rad=tuple(path[0].tolist()), load_kg_m=load_kg_m)
    plant = Plant(settings, seed=seed)
    seen = [(sample.measured_position, sample.measured_torque) for sample in map(plant.step, path)][LEAD_IN:]
    position, torque = (np.array(values) for values in zip(*seen, strict=True))
    np.savez(file, t=time_s[LEAD_IN:], q=position, tau=torque, robot=ROBOT, period_s=trajectory.period_s)
    return read_recording(file)


def drawn_load(generator: np.random.Generator) -> tuple[float, ...]:
    """Mass in kg, then its place in m from the flange."""
    mass = float(np.exp(generator.uniform(*np.log(MASS_KG))))
    return (mass, *generator.uniform(-ASIDE_M, ASIDE_M, 2).tolist(), float(generator.uniform(*OUT_M)))


def figures(body: Body, load_kg_m: tuple[float, ...]) -> dict[str, Any]:
    """What was found of a load, how far it is off, and which of its four intervals hold."""
    numbers = (body.mass, *body.center)
    return {
        "load": list(load_kg_m),
        "found": [item.value for item in numbers],
        "std": [item.std for item in numbers],
        "mass_error": body.mass.value / load_kg_m[0] - 1.0,
        "center_error_mm": [1e3 * (item.value - true) for item, true in zip(body.center, load_kg_m[1:], strict=True)],
        "held": [item.interval[0] <= true <= item.interval[1] for item, true in zip(numbers, load_kg_m, strict=True)],
    }


def main() -> int:
    """Weigh drawn loads and print how far off each is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--loads", type=int, default=20)
    parser.add_argument("--motion", default="shipped")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--folder", type=Path, default=Path("."))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    robot: RobotModel = load_robot(ROBOT)
    motion = default_trajectory(ROBOT) if arguments.motion == "shipped" else load_trajectory(arguments.motion)
    generator = np.random.default_rng([arguments.seed, 13])
    rows, began = [], time.process_time()
    for _ in range(arguments.loads):
        load = drawn_load(generator)
        seeds = generator.integers(2**31, size=2).tolist()
        bare, loaded = (
            record(arguments.folder / f"{name}.npz", motion, arguments.seconds, each, seed)
            for name, each, seed in (("bare", (0.0,) * 4, seeds[0]), ("tool", load, seeds[1]))
        )
        row = figures(weigh(robot, [bare], [loaded]), load)
        rows.append(row)
        center = ", ".join(f"{value:+.2f}" for value in row["center_error_mm"])
        error, number = 100 * row["mass_error"], sum(row["held"])
        print(f"{load[0]:6.2f} kg  mass {error:+6.2f} %  centre {center} mm  held {number}/4")
    mass = np.abs([row["mass_error"] for row in rows])
    off = np.abs([row["center_error_mm"] for row in rows])
    held = np.array([row["held"] for row in rows])
    result = {
        "seed": arguments.seed, "motion": arguments.motion, "seconds": arguments.seconds, "loads": rows,
        "mass_within_bound": float((mass <= MASS_SHARE).mean()), "worst_mass_error": float(mass.max()),
        "centers_within_bound": float((off.max(axis=1) <= 1e3 * CENTER_M).mean()), "worst_center_mm": float(off.max()),
        "coverage": float(held.mean()), "cpu_s": time.process_time() - began,
    }  # fmt: skip
    print(
        f"{len(rows)} loads: mass within 1 % {result['mass_within_bound']:.0%} "
        f"(worst {result['worst_mass_error']:.2%}), "
        f"centre within 2 mm {result['centers_within_bound']:.0%} (worst {result['worst_center_mm']:.1f} mm), "
        f"intervals that hold {result['coverage']:.1%} of {held.size}"
    )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
