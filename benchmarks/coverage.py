"""Whether 95 % intervals hold where the fit itself chose the model: offsets, and the width of friction's corner.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.coverage [--draws 200] [--seed 1] [--cases offset,corner]
Data: the shipped excitation, 16 periods of 10 s at 100 Hz, Table 2's parameters, torque noise of Table 4's size that
is first-order autoregressive with another correlation time in each joint. Each draw goes the way of a fit with default
settings: pipeline, choice of the nominal model, estimator. Drawn anew each time: noise, and what there is to choose.
Coverage is over Table 2's 57 parameters and all draws; its error is that of the draws, as parameters hang together.

- plain: nothing to choose. - offset: a constant torque on each joint, N(0, 0.3 Nm).
- faint offset: N(0, 0.01 Nm), so that the choice falls either way.
- corner: Coulomb friction turns over as tanh(q̇/v), v = 20 mrad/s. - faint corner: v = 1 mrad/s.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.estimators import PERIODS, QUANTILE_95, Experiment
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.fitting.nominal_model import choose_nominal_model, estimate_nominal
from identification.fitting.processing import process_whole_periods
from identification.fitting.settings import FitSettings

FloatArray = npt.NDArray[np.float64]

CORNERS = {"corner": 0.02, "faint corner": 0.001}
OFFSETS = {"offset": 0.3, "faint offset": 0.01}
"""Standard deviation of the offsets that are drawn, Nm."""
CASES = ("plain", *OFFSETS, *CORNERS)
LEAST, MOST = 0.93, 0.97


def covered(experiment: Experiment, case: str, draws: int, seed: int) -> tuple[FloatArray, float]:
    """(draws, 57) whether each interval holds the truth, and in which share of draws the fit chose a larger model."""
    generator = np.random.default_rng([seed, CASES.index(case)])
    columns = experiment.columns
    if case in CORNERS:
        width = RegressorOptions(coulomb_velocity=CORNERS[case])
        columns = BaseRegressor(experiment.robot, width).matrix(*experiment.motion)
    clean = np.tile(columns @ experiment.truth, (PERIODS, 1))
    inside, larger = [], 0
    for _ in range(draws):
        offset = OFFSETS.get(case, 0.0) * generator.normal(size=7)
        recording = experiment.recording(clean + offset + experiment.noise(generator))
        settings = FitSettings()
        processed = process_whole_periods(recording, settings)
        assert processed is not None
        model = choose_nominal_model([processed], experiment.robot, settings)
        regressor = model.regressor
        larger += regressor.options.offset or regressor.options.turns_gently
        estimate = estimate_nominal(model, [processed], settings)[1].least_squares
        own = [regressor.names.index(name) for name in experiment.base.names]
        error = np.abs(estimate.values[own] - experiment.truth)
        inside.append(error < QUANTILE_95 * estimate.std[own])
    return np.array(inside), larger / draws


def main() -> int:
    """Print the table; exit status 1 where a coverage is not between 93 and 97 %."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    experiment, start, found = Experiment(), time.perf_counter(), {}
    print(f"{'case':<14s}{'covered %':>11s}{'±':>6s}{'least %':>9s}{'(name)':>10s}{'larger model %':>16s}")
    for case in arguments.cases.split(","):
        inside, larger = covered(experiment, case, arguments.draws, arguments.seed)
        of_draw, of_parameter = inside.mean(axis=1), inside.mean(axis=0)
        error = float(of_draw.std() / np.sqrt(max(1, len(of_draw) - 1)))
        worst = int(np.argmin(of_parameter))
        found[case] = {"covered": float(inside.mean()), "error": error, "larger_model": larger}
        print(
            f"{case:<14s}{100 * inside.mean():11.1f}{100 * error:6.1f}{100 * of_parameter[worst]:9.1f}"
            f"{experiment.base.names[worst]:>10s}{100 * larger:16.0f}",
            flush=True,
        )
    print(f"{arguments.draws} draws each, seed {arguments.seed}; {time.perf_counter() - start:.0f} s")
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    return int(not all(LEAST <= item["covered"] <= MOST for item in found.values()))


if __name__ == "__main__":
    sys.exit(main())
