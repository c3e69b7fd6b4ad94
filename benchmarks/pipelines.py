"""Bias of the paper's filter chain and of the periodic pipeline on noise-free data, side by side, in σ of Table 2.

Run: python -m benchmarks.pipelines. The paper's Tables 2 and 3 come from the tests' data.
The data: Table 3 through Pinocchio's inverse dynamics plus friction at 1 kHz, on the shipped excitation and on a random
Fourier motion.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pinocchio

from identification.errors import IdentificationError
from identification.excitation import FourierTrajectory, default_trajectory
from identification.fitting.choices import Pipeline
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import ImportReport, Recording, RecordingSource
from identification.robots import load_robot

SEED = 7
PIPELINES: tuple[Pipeline, ...] = ("paper", "periodic")


def main() -> int:
    """Print median and worst bias of each pipeline."""
    folder = Path(__file__).resolve().parents[1] / "tests" / "identification" / "data"
    robot = load_robot("iiwa14")
    plant = _table_three(folder / "table3_physical_parameters.csv")
    sigma = _table_two(folder / "table2_base_parameters.csv")
    for motion, trajectory in _motions():
        recording = _recording(trajectory, plant)
        print(f"\n{motion}: |estimate - truth| in σ of Table 2, 57 parameters, no noise")
        print(f"  {'pipeline':<12s}{'median':>12s}{'worst':>12s}   worst at")
        for pipeline in PIPELINES:
            settings = FitSettings(pipeline=pipeline, physical=False)
            result = fit_recordings([recording], robot, settings)
            truth = result.regressor.base_from_physical(plant)
            bias = np.abs(result.values - truth) / np.array([sigma[name] for name in result.names])
            worst = int(np.argmax(bias))
            print(f"  {pipeline:<12s}{np.median(bias):12.3g}{bias[worst]:12.3g}   {result.names[worst]}")
    return 0


def _motions() -> list[tuple[str, FourierTrajectory]]:
    generator = np.random.default_rng(SEED)
    a, b = generator.normal(scale=0.3, size=(2, 7, 5))
    motions = [(f"random Fourier series (seed {SEED})", FourierTrajectory(0.1, a, b, np.zeros(7)))]
    try:
        shipped = default_trajectory()
    except IdentificationError as error:
        print(f"shipped excitation left out: {error}", file=sys.stderr)
    else:
        motions.insert(0, ("shipped excitation", shipped))
    return motions


def _recording(trajectory: FourierTrajectory, plant: PhysicalParameters) -> Recording:
    robot = load_robot("iiwa14")
    samples = round(1000 * trajectory.period_s)
    time = np.arange(samples, dtype=np.float64) * 1e-3
    position, velocity, acceleration = trajectory.evaluate(time)
    model = robot.pinocchio_model.copy()
    for link in range(7):
        model.inertias[link + 1] = pinocchio.Inertia(
            float(plant.mass[link]), plant.center_of_mass[link], plant.inertia[link]
        )
    data = model.createData()
    torque = np.array(
        [pinocchio.rnea(model, data, *state) for state in zip(position, velocity, acceleration, strict=True)]
    )
    torque += plant.viscous * velocity + plant.coulomb * np.sign(velocity)
    return Recording(
        time=time,
        position=position,
        torque=torque,
        sampling_period_s=1e-3,
        source=RecordingSource("noise-free", "", "log"),
        report=ImportReport(samples, samples),
        robot="iiwa14",
        period_index=np.zeros(samples, dtype=np.int64),
        sample_in_period=np.arange(samples),
        period_s=trajectory.period_s,
        samples_per_period=samples,
    )


def _table_two(path: Path) -> dict[str, float]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    # A value printed as 0.000 has half a last digit's σ base.
    return {
        row["parameter"]: max(abs(float(row["value"])), 5e-4) * float(row["relative_std_percent"]) / 100.0
        for row in rows
    }


def _table_three(path: Path) -> PhysicalParameters:
    with path.open(newline="") as file:
        rows = {
            row["parameter"]: np.array([float(row[f"link{link}"]) for link in range(1, 8)])
            for row in csv.DictReader(file)
        }
    inertia = np.zeros((7, 3, 3))
    for i, first in enumerate("xyz"):
        for j, second in enumerate("xyz"):
            inertia[:, i, j] = rows[f"I{first}{second}" if i <= j else f"I{second}{first}"]
    center = np.column_stack([rows["lCx"], rows["lCy"], rows["lCz"]])
    return PhysicalParameters(rows["m"], center, inertia, rows["Fv"], rows["Fs"])


if __name__ == "__main__":
    sys.exit(main())
