"""Estimators against the Cramér–Rao bound, and whether 95 % intervals hold, by Monte Carlo on coloured noise.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.estimators [--draws 500] [--seed 1] [--cases default,outliers]
Data: the shipped excitation, 16 periods of 10 s at 100 Hz, Table 2's parameters, torque noise of Table 4's size that is
first-order autoregressive with another correlation time in each joint; then the same with 2 % of the samples fifteen
times as large. The regressor is fixed, so a draw costs noise, averaging, weights and a 57 × 57 system: the functions
are those of the fit. Without periods: 40 s of the same motion as one stretch. Per parameter: standard deviation of
the estimate over the draws, divided by the bound. The worst of 57 such ratios lies 2.3 of their Monte Carlo errors
above the truth; so the columns "paired" divide by the standard deviation, over the same draws without outliers, of the
estimator that knows the noise's spectrum. That estimator reaches the bound, and scatter common to both cancels.

Two bounds: of the lines that the fit may look at (up to 40 Hz at this rate), and of all lines up to 50 Hz. Lines on
which no torque stands above its noise are left out of a draw, and what that costs is in the table.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from identification.base_parameters import BaseRegressor
from identification.excitation import default_trajectory
from identification.fitting.blocks import Block, build_block
from identification.fitting.estimate import estimate_parameters
from identification.recordings import ImportReport, Recording, RecordingSource
from identification.robots import load_robot
from identification.signals.periodic import process_periodic, to_lines
from identification.signals.processed import ProcessedSignals, unchanged

FloatArray = npt.NDArray[np.float64]

PERIODS, SAMPLES, PERIOD_S = 16, 1000, 10.0
STRETCH_PERIODS = 4
CORRELATION_S = np.array([0.02, 0.05, 0.1, 0.2, 0.1, 0.05, 0.02])
OUTLIER_SHARE, OUTLIER_SIZE = 0.02, 15.0
DATA = Path(__file__).resolve().parents[1] / "tests" / "identification" / "data"
QUANTILE_95 = 1.959964


class Experiment:
    """The fixed parts: motion, regressor, true torque, noise; and from a draw of noise to an estimate."""

    def __init__(self) -> None:
        self.robot = load_robot("iiwa14")
        self.base = BaseRegressor(self.robot)
        self.truth = _numbers("table2_base_parameters.csv")
        self.deviation = _numbers("table4_rms_nm.csv")[:7]
        self.correlation = np.exp(-PERIOD_S / SAMPLES / CORRELATION_S)
        clock = np.arange(SAMPLES) * PERIOD_S / SAMPLES
        self.motion = default_trajectory().evaluate(clock)
        self.columns = self.base.matrix(*self.motion)
        self.clean = self.columns @ self.truth
        first = self.recording(np.tile(self.clean, (PERIODS, 1)))
        block = build_block(process_periodic(first), self.base, None, 0.0, PERIODS * PERIOD_S)
        assert block is not None
        self.block = block
        self.lines = (len(block.torque) - 1) // 2

    def noise(self, generator: np.random.Generator) -> FloatArray:
        """(16 · M, 7) Nm, stationary from the first sample on."""
        white = generator.normal(size=(PERIODS * SAMPLES, 7))
        columns = [
            lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white[:, j], zi=[phi * generator.normal()])[0]
            for j, phi in enumerate(self.correlation)
        ]
        return np.asarray(self.deviation * np.column_stack(columns), dtype=np.float64)

    def bound(self, lines: int) -> FloatArray:
        """(p,) standard deviations of the Cramér–Rao bound from lines 0 … lines with the noise known."""
        information, _ = self._information(lines)
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))

    def informed(self) -> FloatArray:
        """(p, R, 7) the estimator that knows the noise, as a factor of the rows of the lines that the fit looks at."""
        information, weighted = self._information(self.lines)
        return np.asarray(np.einsum("pq,rjq->prj", np.linalg.inv(information), weighted))

    def _information(self, lines: int) -> tuple[FloatArray, FloatArray]:
        """Information matrix (p, p), and the rows' columns (R, 7, p) over the true variance of each row."""
        rows = to_lines(self.columns, lines)
        angle = 2.0 * np.pi * np.arange(lines + 1) / SAMPLES
        power = (1.0 - self.correlation**2) / (
            1.0 - 2.0 * self.correlation * np.cos(angle)[:, None] + self.correlation**2
        )
        variance = np.concatenate([power[:1], np.repeat(power[1:], 2, axis=0)]) * self.deviation**2 / PERIODS
        weighted = rows / variance[..., None]
        return np.einsum("rjp,rjq->pq", rows, weighted, optimize=True), weighted

    def periodic_block(self, noise: FloatArray, *, bound_outliers: bool = False) -> Block:
        """The block of one draw: the columns stay as far as its band goes, torque and noise are the draw's."""
        recording = self.recording(np.tile(self.clean, (PERIODS, 1)) + noise)
        signals = process_periodic(recording, bound_outliers=bound_outliers)
        rows = len(signals.used)
        return replace(
            self.block,
            signals=signals,
            torque=signals.project(signals.torque),
            columns=self.block.columns[:rows],
            fitted=self.block.fitted[:rows],
            held_out=self.block.held_out[:rows],
            scale=self.block.scale[:rows],
        )

    def plain_block(self, noise: FloatArray) -> Block:
        """The block of one draw without periods: 40 s as one stretch of rows over time."""
        if not hasattr(self, "_long"):
            self._long = self._without_periods()
        return replace(self._long, torque=self._long.signals.torque + noise[: STRETCH_PERIODS * SAMPLES])

    def _without_periods(self) -> Block:
        position, velocity, acceleration = (np.tile(value, (STRETCH_PERIODS, 1)) for value in self.motion)
        clock = np.arange(STRETCH_PERIODS * SAMPLES) * PERIOD_S / SAMPLES
        every = np.ones(position.shape, dtype=np.bool_)
        signals = ProcessedSignals(
            pipeline="aperiodic",
            time=clock,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            torque=np.tile(self.clean, (STRETCH_PERIODS, 1)),
            project=unchanged,
            used=every,
            row_time=clock,
            row_noise=None,
            evaluate=unchanged,
            evaluated=every,
            evaluation_time=clock,
            noise_floor_nm=np.full(7, np.nan),
        )
        block = build_block(signals, self.base, None, 0.0, PERIODS * PERIOD_S)
        assert block is not None
        return block

    def recording(self, torque: FloatArray) -> Recording:
        """16 periods of the motion with this torque (16 · M, 7) Nm."""
        rows = PERIODS * SAMPLES
        return Recording(
            time=np.arange(rows) * PERIOD_S / SAMPLES,
            position=np.tile(self.motion[0], (PERIODS, 1)),
            torque=torque,
            sampling_period_s=PERIOD_S / SAMPLES,
            source=RecordingSource("simulated", "", "log"),
            report=ImportReport(rows, rows),
            robot="iiwa14",
            period_index=np.arange(rows) // SAMPLES,
            sample_in_period=np.arange(rows) % SAMPLES,
            period_s=PERIOD_S,
            samples_per_period=SAMPLES,
        )


def campaign(
    experiment: Experiment, cases: dict[str, Any], draws: int, seed: int
) -> tuple[dict[str, dict[str, FloatArray]], FloatArray]:
    """Errors, stated σ and σ of eq. (15), each (draws, p), of every case on the same noise; last the errors of the
    estimator that knows the noise.
    """
    generator = np.random.default_rng(seed)
    informed = experiment.informed()
    reference = []
    kept: dict[str, dict[str, list[FloatArray]]] = {name: {"error": [], "std": [], "paper": []} for name in cases}
    for _ in range(draws):
        noise = experiment.noise(generator)
        wild = np.where(generator.random(noise.shape) < OUTLIER_SHARE, OUTLIER_SIZE * noise, noise)
        mean = noise.reshape(PERIODS, SAMPLES, 7).mean(axis=0)
        reference.append(np.einsum("prj,rj->p", informed, to_lines(mean, experiment.lines)))
        for name, (outliers, estimator) in cases.items():
            drawn = wild if outliers else noise
            if name.startswith("no periods"):
                block = experiment.plain_block(drawn)
            else:
                block = experiment.periodic_block(drawn, bound_outliers=estimator == "huber")
            weights = "maximum_likelihood" if estimator == "huber" else estimator
            result = estimate_parameters([block], experiment.base.names, weights)
            kept[name]["error"].append(result.least_squares.values - experiment.truth)
            kept[name]["std"].append(result.least_squares.std)
            kept[name]["paper"].append(result.ordinary.std)
    found = {name: {key: np.array(values) for key, values in case.items()} for name, case in kept.items()}
    return found, np.array(reference)


def main() -> int:
    """Print the table; exit status 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--cases", default="", help="only those with one of these texts in their name: default,outliers"
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    experiment = Experiment()
    in_band, everything = experiment.bound(experiment.lines), experiment.bound(SAMPLES // 2 - 1)
    cases = {
        "maximum_likelihood (default)": (False, "maximum_likelihood"),
        "weighted": (False, "weighted"),
        "ols (paper)": (False, "ols"),
        "huber": (False, "huber"),
        "outliers: maximum_likelihood": (True, "maximum_likelihood"),
        "outliers: huber": (True, "huber"),
        "no periods: weighted": (False, "weighted"),
        "no periods: ols": (False, "ols"),
    }
    wanted = arguments.cases.split(",")
    cases = {name: case for name, case in cases.items() if any(text in name for text in wanted)}
    start = time.perf_counter()
    results, reference = campaign(experiment, cases, arguments.draws, arguments.seed)
    took = time.perf_counter() - start
    print(f"{arguments.draws} draws, seed {arguments.seed}, {took:.0f} s; 57 parameters, 16 periods")
    print(f"OPENBLAS_NUM_THREADS=1 python -m benchmarks.estimators --draws {arguments.draws} --seed {arguments.seed}\n")
    print(
        f"{'':<32s}{'sd / bound of the lines used':^26s}{'paired':^24s}{'sd / bound of all':^18s}"
        f"{'95 % intervals cover, %':^34s}"
    )
    print(
        f"{'estimator':<32s}{'median':>8s}{'worst':>8s}{'(name)':>10s}{'median':>8s}{'worst':>8s}{'±':>8s}{'median':>9s}{'worst':>9s}"
        f"{'all':>9s}{'least':>8s}{'most':>8s}{'eq. (15)':>9s}"
    )
    summary: dict[str, dict[str, float]] = {}
    for name, case in results.items():
        spread = np.sqrt(np.mean(case["error"] ** 2, axis=0))
        longer = np.sqrt(PERIODS / STRETCH_PERIODS) if name.startswith("no periods") else 1.0
        ratio, of_all = spread / in_band / longer, spread / everything / longer
        own = np.sqrt(np.mean(reference**2, axis=0))
        paired = spread / own / longer
        alike = np.mean(case["error"] * reference, axis=0) / (spread * own)
        scatter = float(np.max(paired * np.sqrt((1.0 - alike**2) / arguments.draws)))
        inside = 100.0 * np.mean(np.abs(case["error"]) < QUANTILE_95 * case["std"], axis=0)
        paper = 100.0 * np.mean(np.abs(case["error"]) < QUANTILE_95 * case["paper"])
        worst = int(np.argmax(ratio))
        summary[name] = {
            "median": float(np.median(ratio)),
            "worst": float(ratio[worst]),
            "median_paired": float(np.median(paired)),
            "worst_paired": float(paired.max()),
            "median_all": float(np.median(of_all)),
            "worst_all": float(of_all.max()),
            "coverage": float(inside.mean()),
            "least": float(inside.min()),
            "most": float(inside.max()),
            "equation_15": float(paper),
        }
        print(
            f"{name:<32s}{np.median(ratio):8.3f}{ratio[worst]:8.3f}{experiment.base.names[worst]:>10s}"
            f"{np.median(paired):8.3f}{paired.max():8.3f}{scatter:8.3f}{np.median(of_all):9.3f}{of_all.max():9.3f}{inside.mean():9.1f}{inside.min():8.1f}{inside.max():8.1f}"
            f"{paper:9.1f}"
        )
    error = 1.0 / np.sqrt(2.0 * arguments.draws)
    cover = 100.0 * np.sqrt(0.05 * 0.95 / arguments.draws)
    print(
        f"\nMonte Carlo error of one ratio ±{error:.3f}, of one parameter's coverage ±{cover:.1f} % (1 σ): the worst "
        f"of 57 is expected {2.3 * error:.3f} above and the least {2.3 * cover:.1f} % below what more draws would give."
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(summary, indent=1) + "\n")
    met = [
        case["median"] <= median
        and case["worst"] <= 1.10
        and case["worst_paired"] <= worst
        and 93.0 <= case["coverage"] <= 97.0
        for name, median, worst in (("maximum_likelihood (default)", 1.03, 1.10), ("outliers: huber", 1.08, 1.08))
        for case in [summary.get(name)]
        if case is not None
    ]
    return int(not all(met))


def _numbers(name: str) -> FloatArray:
    """Second column of a table of the paper."""
    with (DATA / name).open(newline="") as file:
        return np.array([float(row[1]) for row in list(csv.reader(file))[1:]])


if __name__ == "__main__":
    sys.exit(main())
